"""README, reference pages and the other documents: the files, fields, options, commands and figures they name exist."""

from __future__ import annotations

import re
import textwrap
import tomllib
from collections.abc import Iterator
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from cyclopts import App
from helpers.commands import main
from helpers.places import ROOT, TESTS
from helpers.printed_blocks import has_in_order, printed_parts, words

from dvrk_cmaes import EstimateConfig, Result, SessionCalibration
from dvrk_cmaes.cli.app import app
from dvrk_cmaes.cli.help import topic_pages
from dvrk_cmaes.export.table import FORMATS
from dvrk_cmaes.io.toml_file import leaves, updated
from dvrk_cmaes.pose.config_check import check_config
from dvrk_cmaes.results.result import Alternative, Quality, ViewCheck

PAGES = ROOT / "data" / "reference"
REFERENCE = {path.stem: path.read_text(encoding="utf-8") for path in sorted(PAGES.glob("*.md"))}
README = (ROOT / "README.md").read_text(encoding="utf-8")
MANUAL = "\n".join([README, *REFERENCE.values()])
DOCUMENTS = [
    *(ROOT / name for name in ("README.md", "CONTRIBUTING.md", "CHANGELOG.md", ".github/SECURITY.md")),
    *(PAGES / f"{name}.md" for name in REFERENCE),
]
MOST_LINES = 180


def section(text: str, title: str) -> str:
    """Text under a heading of the second level."""
    return text.split(f"\n## {title}\n")[1].split("\n## ")[0]


def quoted(text: str) -> set[str]:
    """Words in backticks."""
    return set(re.findall(r"`(\w+)`", text))


def options(parent: App) -> Iterator[str]:
    """All options of an app's commands."""
    for name in parent:
        if not name.startswith("-"):
            command = parent[name]
            if command.default_command is not None:
                yield from (word for each in command.assemble_argument_collection() for word in each.names)
            yield from options(command)


# the documents as a whole


def test_readme_is_short() -> None:
    assert len(README.splitlines()) <= MOST_LINES


def test_reference_pages_are_linked_and_help_topics() -> None:
    rows = re.findall(r"^\| (\[\w+\]\(data/reference/.*?\)) \|", README, flags=re.MULTILINE)
    linked = [pair for row in rows for pair in re.findall(r"\[(\w+)\]\(data/reference/(\w+)\.md\)", row)]
    assert all(text == page for text, page in linked)
    assert {page for _, page in linked} == set(REFERENCE) == set(topic_pages())


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda path: path.name)
def test_links_to_files_are_valid(document: Path) -> None:
    links = [link for link in re.findall(r"\]\(([^)]+)\)", document.read_text(encoding="utf-8")) if "://" not in link]
    for path, _, anchor in (link.partition("#") for link in links):
        target = document.parent / path if path else document
        assert target.is_file(), path
        headings = re.findall(r"^#+ (.+)$", target.read_text(encoding="utf-8"), re.MULTILINE) if anchor else []
        assert anchor in ["", *(re.sub(r"[^\w -]", "", one.lower()).replace(" ", "-") for one in headings)], anchor


def test_picture_is_linked() -> None:
    assert "](data/docs/overlay.jpg)" in README


def test_shown_commands_exist() -> None:
    shown = set(re.findall(r"^    (?:\$ |\.venv/bin/)?dvrk-cmaes (\w+)", MANUAL, flags=re.MULTILINE))
    assert {"estimate", "batch", "calibrate", "segment", "export", "golden", "consistency", "import"} <= shown
    assert shown <= set(app)


def of_today(text: str) -> str:
    """Leave out the lines that say by which command of which commit figures were measured."""
    return "\n".join(line for line in text.splitlines() if not line.startswith("Measured "))


def test_named_options_exist() -> None:
    named = set(re.findall(r"(?<![\w-])--[a-z][a-z0-9_-]*", of_today(MANUAL)))
    of_others = {"--local-dir", "--multimask_output", "--once"}  # of the makers of SAM 2 exports, and of ros2 topic
    scripts = [ROOT / "scripts" / "measure.py", *(ROOT / "scripts" / "measuring").rglob("*.py")]
    of_scripts = {name for path in scripts for name in re.findall(r'"(--[a-z-]+)"', path.read_text(encoding="utf-8"))}
    assert named - of_others <= {*options(app), *of_scripts, "--help"}


def test_named_scripts_exist() -> None:
    text = of_today(MANUAL + (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8"))
    named = set(re.findall(r"scripts/[\w/]+\.py", text))
    assert len(named) > 3
    assert all((ROOT / name).is_file() for name in named)


# what the pages explain


def test_fields_of_result_are_explained() -> None:
    explained = quoted(section(REFERENCE["results"], "A result"))
    empty = Result("", "failed", (), "", "", None, {}, {})
    inner = {field.name for kind in (Quality, Alternative, ViewCheck) for field in fields(kind)}
    assert {*empty.to_dict(), "views", "view_fits", *inner} <= explained


def test_fields_of_calibration_are_explained() -> None:
    explained = quoted(section(REFERENCE["results"], "session.json"))
    document = SessionCalibration("", np.eye(4), {}, (), np.eye(6), np.eye(6), {}).to_dict()
    inner = {name for key in ("std", "covariance") for name in document[key]}
    assert {*document, *inner} <= explained


def test_exports_are_explained_with_direction() -> None:
    rows = dict(re.findall(r"^\| `(\w[\w-]*)` \|.*\| (.*) \|$", REFERENCE["exports"], flags=re.MULTILINE))
    assert set(rows) == set(FORMATS)
    assert all(rows[name].split(",")[0].split(" ")[0] in FORMATS[name].direction for name in rows)


def test_example_settings_are_valid() -> None:
    text = REFERENCE["settings"]
    example = text[text.index("    seed = 3") : text.index("\nFlags win over the file")]
    config = updated(EstimateConfig(), tomllib.loads(textwrap.dedent(example)), where="settings.md")
    check_config(config)
    assert (config.seed, config.search.method, config.refine.derivatives) == (3, "direct-l", "differences")


def test_settings_are_explained_with_defaults() -> None:
    table, explained = "", dict[str, Any]()
    for line in REFERENCE["settings"].splitlines():
        heading = re.match(r"## (?:`\[([\w.]+)\]`)?", line)
        row = re.match(r"\| `(\w+)` \| (\S+) \| .+ \|$", line)
        if heading is not None:
            table = f"{heading[1]}." if heading[1] else ""
        elif row is not None:
            explained[f"{table}{row[1]}"] = tomllib.loads(f"x = {row[2]}")["x"]
    assert explained == dict(leaves(EstimateConfig()))


# the examples


def test_example_of_frame_prints_shown_lines(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    command = section(README, "One frame").split("\nprints\n")[0].replace("\\\n", " ").split()
    monkeypatch.chdir(ROOT)
    command[-1] = str(tmp_path)
    assert main(command[1:]) == 0
    shown = README.split("\nprints\n")[1].split("Standard deviations")[0]
    assert has_in_order(words(capsys.readouterr().out), printed_parts(shown))


def test_example_of_inspect_prints_shown_lines(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    example = re.search(r"    \$ dvrk-cmaes (inspect .*)\n((?:    .*\n)+)", REFERENCE["formats"])
    assert example is not None
    monkeypatch.chdir(ROOT)
    assert main(example[1].split()) == 0
    assert capsys.readouterr().out == textwrap.dedent(example[2])


def test_example_test_is_test_of_project() -> None:
    example = (TESTS / "test_testing_example.py").read_text(encoding="utf-8").split('"""\n\n', 1)[1]
    shown = textwrap.indent(example, "    ").rstrip()
    assert shown in REFERENCE["testing"]


# the other documents


def test_map_of_packages_is_complete() -> None:
    mapped = quoted(section((ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8"), "The packages"))
    assert {path.parent.name for path in (ROOT / "dvrk_cmaes").glob("*/__init__.py")} <= mapped


def test_citation_names_the_paper() -> None:
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    assert citation["cff-version"] == "1.2.0"
    assert (citation["type"], citation["title"]) == ("software", "dvrk-cmaes")
    (paper,) = citation["references"]
    assert paper["title"] == "Differentiable Rendering-based Pose Estimation for Surgical Robotic Instruments"
    assert paper["title"] in " ".join(README.split())
    assert [author["family-names"] for author in paper["authors"]] == ["Liang", "Chiu", "Richter", "Yip"]


def test_pre_commit_hooks_run_commands_of_make_lint() -> None:
    recipe = (ROOT / "Makefile").read_text(encoding="utf-8").split("\nlint:")[1].split("\n\n")[0]
    commands = [line.removeprefix("\t$(BIN)/") for line in recipe.splitlines()[1:]]
    config = yaml.safe_load((ROOT / ".pre-commit-config.yaml").read_text(encoding="utf-8"))
    hooks = [hook for repository in config["repos"] for hook in repository["hooks"]]
    assert {repository["repo"] for repository in config["repos"]} == {"local"}
    without_files = [re.sub(r" (\.|dvrk_cmaes/\S+)$", "", command) for command in commands]  # which pre-commit gives
    assert [hook["entry"] for hook in hooks] == [f".venv/bin/{command}" for command in without_files]


def test_github_forms_and_workflow_are_valid_yaml() -> None:
    paths = sorted((ROOT / ".github").rglob("*.yml"))
    assert {path.name for path in paths} >= {"ci.yml", "bug_report.yml", "feature_request.yml"}
    documents = {path.name: yaml.safe_load(path.read_text(encoding="utf-8")) for path in paths}
    steps = documents["ci.yml"]["jobs"]["checks"]["steps"]
    assert [step["run"] for step in steps if "run" in step] == [".ci/run"]
    asked = str(documents["bug_report.yml"]["body"])
    assert all(text in asked for text in ("dvrk-cmaes inspect", "dvrk-cmaes --version"))


def test_documents_are_in_source_distribution() -> None:
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    included = settings["tool"]["scikit-build"]["sdist"]["include"]
    needed = {path.relative_to(ROOT).parts[0] for path in DOCUMENTS} | {"CITATION.cff", ".pre-commit-config.yaml"}
    assert needed <= set(included)


def test_extras_are_installed_from_the_checkout() -> None:
    texts = [*(ROOT / "dvrk_cmaes").rglob("*.py"), *(ROOT / "scripts").rglob("*.py"), *PAGES.glob("*.md")]
    named = [path for path in texts if re.search(r"""["']dvrk-cmaes\[""", path.read_text(encoding="utf-8"))]
    assert named == []  # the package is not on the index


def test_release_publishes_what_was_tried_with_least_permissions() -> None:
    release = yaml.safe_load((ROOT / ".github/workflows/release.yml").read_text(encoding="utf-8"))
    jobs = release["jobs"]
    assert release["permissions"] == {}
    assert {name: job.get("permissions") for name, job in jobs.items()} == {
        "build": {"contents": "read"},
        "wheels": {"contents": "read"},
        "sanitize": {"contents": "read"},
        "try": None,
        "publish": {"id-token": "write"},
    }
    assert (jobs["publish"]["needs"], jobs["try"]["needs"]) == ("try", ["build", "wheels"])
    assert jobs["wheels"]["needs"] == ["build", "sanitize"]
    assert jobs["try"]["strategy"]["matrix"]["python"] == ["3.11", "3.12", "3.13"]
