"""The figures of single frames: README and the page on accuracy have those of data/figures.json, which still hold."""

from __future__ import annotations

import json
from importlib import import_module
from pathlib import Path
from types import ModuleType

import pytest
from helpers.places import ROOT

from dvrk_cmaes.cli import main

DOCUMENT = json.loads((ROOT / "data" / "figures.json").read_text(encoding="utf-8"))


@pytest.fixture
def figures(scripts_on_path: None) -> ModuleType:
    """The script."""
    return import_module("figures")


@pytest.mark.parametrize("page", ["accuracy", "readme"])
def test_tables_are_those_of_the_file(figures: ModuleType, page: str) -> None:
    text = figures.PAGES[page].read_text(encoding="utf-8")
    assert figures.with_blocks(text, figures.blocks(DOCUMENT)[page]) == text, "run python scripts/figures.py write"


def test_every_set_states_when_where_and_of_which_commit_it_was_measured() -> None:
    assert set(DOCUMENT["frames"]) == {"bundled", "scanned"}
    for chosen in DOCUMENT["frames"].values():
        assert all(chosen[name] for name in ("date", "machine", "commit"))


def test_figures_copied_by_hand_are_in_their_documents() -> None:
    for figure in DOCUMENT["stated"]:
        assert figure["date"]
        assert figure["machine"]
        for document, words in figure["words"].items():
            assert words in (ROOT / document).read_text(encoding="utf-8"), f"{figure['name']} in {document}"


@pytest.mark.usefixtures("tasks_in_a_thread")
def test_program_still_has_the_figures_of_made_easy_frames(figures: ModuleType, tmp_path: Path) -> None:
    plan = ["--level", "easy", "--frames", "10", "--seed", "1", "--no-images"]  # all else is as with images
    assert main(["synth", str(tmp_path / "easy"), *plan]) == 0
    found = figures.measured_rows([str(tmp_path / "easy")], "lnd", workers=1)["easy"]
    stored = DOCUMENT["frames"]["bundled"]["rows"]["easy"]
    again = "measure them again: see CONTRIBUTING"
    assert (found["frames"], found["right_mode"]) == (stored["frames"], stored["right_mode"]), again
    assert found["tip_mm"] == pytest.approx(stored["tip_mm"], rel=0.1), again
    assert found["iou"] == pytest.approx(stored["iou"], abs=0.002), again
    assert abs(found["ok"] - stored["ok"]) <= 1, again


@pytest.mark.parametrize(("error", "text"), [(0.032, "0.03"), (0.994, "0.99"), (0.996, "1.0"), (2.754, "2.8")])
def test_errors_have_two_digits(figures: ModuleType, error: float, text: str) -> None:
    assert figures.number(error) == text


def test_page_without_marked_lines_is_refused(figures: ModuleType) -> None:
    with pytest.raises(ValueError, match="figures of frames"):
        figures.with_blocks("# Page\n", {"frames": "text"})


def test_sessions_are_named_by_folder_and_real_ones_by_both(figures: ModuleType) -> None:
    assert [figures.named(path) for path in ("made/easy", "shared/real/easy")] == ["easy", "real/easy"]
