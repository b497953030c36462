"""scripts/bench.py checkouts: estimates, commands and a folder compared with another checkout."""

from __future__ import annotations

import contextlib
import io
import os
import shutil
from collections.abc import Callable, Sequence
from pathlib import Path
from types import SimpleNamespace

import pytest
from helpers.batch_sessions import make_session
from helpers.commands import Ran
from helpers.places import ROOT

from dvrk_cmaes.cli import main
from dvrk_cmaes.io.bundled import bundled_path

IN_TURNS = ("estimate", "batch")
"""Commands that the comparison would start many processes for."""


@pytest.fixture
def commands_here(scripts_on_path: None, tasks_here: None, monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Run the commands `IN_TURNS` in this process, and give their names; all else starts processes of the checkouts.

    The seconds of this process count as theirs.
    """
    from measure.bench.checkouts import Checkout

    run_python, times, ran = Checkout.run_python, os.times, list[str]()

    def run(checkout: Checkout, arguments: Sequence[str], folder: Path, **variables: str) -> int:
        if arguments[0] != "-m" or arguments[2] not in IN_TURNS:
            return run_python(checkout, arguments, folder, **variables)
        ran.append(arguments[2])
        with contextlib.chdir(folder), contextlib.redirect_stdout(io.StringIO()):
            return main(list(arguments[2:]))

    def all_times() -> SimpleNamespace:
        now = times()
        return SimpleNamespace(children_user=now.user + now.children_user, children_system=now.children_system)

    monkeypatch.setattr(Checkout, "run_python", run)
    monkeypatch.setattr(os, "times", all_times)
    return ran


def two_frames(folder: Path) -> Path:
    """Write the first two of the bundled frames at a quarter of their size, with their truth, as a session."""
    make_session(folder, ["0000", "0001"])
    shutil.copy(bundled_path("demo", "golden.json"), folder)
    return folder


@pytest.mark.usefixtures("compiled_before")
def test_every_figure_is_compared(tmp_path: Path, run_here: Callable[..., Ran], commands_here: list[str]) -> None:
    session = two_frames(tmp_path / "session")
    options = ("--against", ROOT, "--quick", "--json")
    done = run_here("bench", "checkouts", "--instrument", "lnd", "--sessions", session, *options)
    assert done.code == 0, done.err
    assert commands_here == ["estimate"] * 4 + ["batch"] * 2
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
