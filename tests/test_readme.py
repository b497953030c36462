"""The README: what it shows and names is there."""

from __future__ import annotations

import re
import textwrap
import tomllib
from pathlib import Path

import pytest

from dvrk_cmaes.cli import main
from dvrk_cmaes.cli.app import app
from dvrk_cmaes.config import EstimateConfig
from dvrk_cmaes.io.toml_file import updated
from dvrk_cmaes.pose.config_check import check_config
from dvrk_cmaes.results.result import Result

ROOT = Path(__file__).resolve().parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")


def test_every_link_to_a_file_leads_to_one() -> None:
    links = [link for link in re.findall(r"\]\(([^)#][^)]*)\)", README) if "://" not in link]
    assert "data/docs/overlay.jpg" in links
    assert all((ROOT / link).is_file() for link in links)


def test_every_field_of_a_result_is_explained() -> None:
    section = README.split("## The result")[1].split("\n## ")[0]
    explained = set(re.findall(r"`(\w+)`", section))
    empty = Result("", "failed", (), "", "", None, {}, {})
    assert set(empty.to_dict()) <= explained


def test_its_settings_are_valid() -> None:
    text = README[README.index("seed = 3") : README.index("\nThe same input and the same seed")]
    settings = tomllib.loads("\n".join(line.strip() for line in text.splitlines()))
    config = updated(EstimateConfig(), settings, where="README")
    check_config(config)
    assert (config.seed, config.search.method, config.refine.method) == (3, "crs2", "bobyqa")


def test_its_example_runs_and_prints_the_lines_it_shows(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    command = README.split("## One frame")[1].split("\nprints\n")[0].replace("\\\n", " ").split()
    monkeypatch.chdir(ROOT)
    command[-1] = str(tmp_path)
    assert main(command[1:]) == 0
    shown = README.split("\nprints\n")[1].split("With `--json`")[0]

    def words(text: str) -> list[str]:
        """Lines without their numbers, which may change in the last digit from machine to machine."""
        lines = [re.sub(r"[-+]?\d+(\.\d+)?", "#", line).split() for line in text.splitlines() if line.strip()]
        return [" ".join(line) for line in lines if line[0] != "written:"]

    assert words(capsys.readouterr().out) == words(shown)


def test_its_example_of_a_test_is_one_that_runs() -> None:
    example = (ROOT / "tests" / "test_golden_example.py").read_text().split('"""\n\n', 1)[1]
    assert textwrap.indent(example, "    ").rstrip() in README


def test_every_command_that_it_shows_is_there() -> None:
    shown = set(re.findall(r"^    (?:\$ )?dvrk-cmaes (\w+)", README, flags=re.MULTILINE))
    assert {"estimate", "batch", "calibrate", "segment", "export", "golden", "consistency", "import"} <= shown
    assert shown <= set(app)
