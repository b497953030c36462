"""scripts/bench.py checkouts: estimates, commands and a folder compared with another checkout."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import pytest
from helpers.batch_sessions import make_session
from helpers.commands import Ran
from helpers.places import ROOT

from dvrk_cmaes.io.bundled import bundled_path


def two_frames(folder: Path) -> Path:
    """Write the first two of the bundled frames at a quarter of their size, with their truth, as a session."""
    make_session(folder, ["0000", "0001"])
    shutil.copy(bundled_path("demo", "golden.json"), folder)
    return folder


@pytest.mark.usefixtures("compiled_before")
def test_every_figure_is_compared(tmp_path: Path, run_here: Callable[..., Ran]) -> None:
    session = two_frames(tmp_path / "session")
    options = ("--against", ROOT, "--quick", "--json")
    done = run_here("bench", "checkouts", "--instrument", "lnd", "--sessions", session, *options)
    assert done.code == 0, done.err
    report = done.result
    del report["machine"]
    assert [title.split(",")[0] for title in report] == [
        "estimate",
        "errors",
        "whole command",
        "--help",
        "inspect",
        "folder",
        "page",
    ]
    (errors,) = report.pop("errors")
    assert errors["frames"] == 1
    assert errors["right mode, this"] == errors["right mode, other"]
    assert (errors["ratio"], errors["moved"]) == (1, 0)  # it is the same checkout
    for this, other, ratio in report.values():
        assert (this["checkout"], other["checkout"], ratio["checkout"]) == ("this", "other", "ratio")
        assert ratio["wall, median"] == pytest.approx(this["wall, median"] / other["wall, median"])
        assert 0 < this["processor, median"] < 60


def test_folder_without_package_is_refused(tmp_path: Path, run_here: Callable[..., Ran]) -> None:
    session = make_session(tmp_path / "session", ["a"])
    done = run_here("bench", "checkouts", "--instrument", "lnd", "--sessions", session, "--against", tmp_path)
    assert done.code == 2
    assert done.err.count("\n") == 1
    assert "expected a checkout with the package dvrk_cmaes" in done.err
