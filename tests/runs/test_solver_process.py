"""The process that solves keyframes: when it is started, and that it ends with its owner."""

from __future__ import annotations

import time

import psutil
import pytest

from dvrk_cmaes.runs.solver_process import SolverProcess
from dvrk_cmaes.silhouette.prepare import prepare


def started_since(before: set[int]) -> list[psutil.Process]:
    """Return the processes of Python that this one has started since; not the one that tracks resources."""
    children = [child for child in psutil.Process().children(recursive=True) if child.pid not in before]
    return [child for child in children if "resource_tracker" not in " ".join(child.cmdline())]


@pytest.mark.parametrize("background", [False, True])
def test_process_in_the_background_starts_before_the_first_problem(*, background: bool) -> None:
    before = {child.pid for child in psutil.Process().children(recursive=True)}
    with SolverProcess(prepare("lnd").instrument, background=background) as solver:
        end = time.monotonic() + (30 if background else 1)
        while not started_since(before) and time.monotonic() < end:
            time.sleep(0.02)
        assert bool(started_since(before)) is background
        assert not solver.ready
    assert not started_since(before)


def test_process_that_is_not_needed_ends_at_once() -> None:
    before = {child.pid for child in psutil.Process().children(recursive=True)}
    with SolverProcess(prepare("lnd").instrument, background=True):
        pass
    assert not started_since(before)
