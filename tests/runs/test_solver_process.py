"""The process that solves keyframes: when it is started, what it does ahead, and that it ends with its owner."""

from __future__ import annotations

import time
from collections.abc import Callable
from concurrent.futures import Future
from typing import Any, cast

import psutil
import pytest
from helpers.waiting import wait_for

from dvrk_cmaes import Camera, EstimateConfig, Keyframe, KeyframeProblem, ReadingSeries, Rig, Solution, prepare
from dvrk_cmaes.runs.solver_process import SolverProcess
from dvrk_cmaes.track.keyframe_problem import KeyframeTask


def started_since(before: set[int]) -> list[psutil.Process]:
    """Return the processes of Python that this one has started since; not the one that tracks resources."""
    children = [child for child in psutil.Process().children(recursive=True) if child.pid not in before]
    return [child for child in children if "resource_tracker" not in " ".join(child.cmdline())]


@pytest.mark.parametrize("background", [False, True])
def test_process_in_the_background_starts_before_the_first_problem(*, background: bool) -> None:
    before = {child.pid for child in psutil.Process().children(recursive=True)}
    with SolverProcess(prepare("lnd").instrument, background=background) as solver:
        if background:
            wait_for(lambda: started_since(before))
        else:
            time.sleep(1)
            assert not started_since(before)
        assert not solver.ready
    assert not started_since(before)


def test_process_that_is_not_needed_ends_at_once() -> None:
    before = {child.pid for child in psutil.Process().children(recursive=True)}
    with SolverProcess(prepare("lnd").instrument, background=True):
        pass
    assert not started_since(before)


class FakeProcess:
    """Notes what it is called with, and answers at once, unless ``busy``; the own result of a keyframe is a text."""

    def __init__(self) -> None:
        self.estimated: list[str] = []
        self.problems: list[dict[str, str]] = []
        self.busy: list[Future[Any]] | None = None

    def submit(self, function: Callable[..., Any], key: str, given: Any, threads: int) -> Future[Any]:
        future = Future[Any]()
        answer = self._answer(function, given)
        if self.busy is None:
            future.set_result(answer)
        else:
            self.busy.append(future)
        return future

    def _answer(self, function: Callable[..., Any], given: Any) -> Any:
        if function.__name__ == "_estimate":
            self.estimated.append(given.keyframe.name)
            return f"result of {given.keyframe.name}"
        self.problems.append(dict(given.alone))
        return Solution(None, "", len(given.keyframes), {one.name: f"solved {one.name}" for one in given.keyframes})

    def kill(self) -> None: ...


RIG, CONFIG = Rig.of(Camera(160, 120, 200.0, 200.0, 80.0, 60.0)), EstimateConfig()
TASKS = [KeyframeTask(Keyframe(0.1 * k, {}, {}, {}, {}), RIG, CONFIG) for k in range(40)]


def problem(*numbers: int) -> KeyframeProblem:
    keyframes = tuple(TASKS[k].keyframe for k in numbers)
    return KeyframeProblem(keyframes, ReadingSeries("s", {}, {}, {}, 0.1), RIG, "classic", CONFIG)


def test_keyframes_are_estimated_ahead_of_their_problem_each_once() -> None:
    process = FakeProcess()
    with SolverProcess(prepare("lnd").instrument) as solver:
        solver._process = cast(Any, process)
        for known in (1, 2, 2):
            solver.prepare(TASKS[:known])
        for count in (3, 4):  # of which the last ones were not estimated ahead
            solver.begin(problem(*range(count)))
            solver.prepare(TASKS[:count])
        first, second = solver.solution(), solver.solution()
    names = [task.keyframe.name for task in TASKS]
    assert process.estimated == names[:2]
    assert process.problems == [
        {name: f"result of {name}" for name in names[:2]},
        {name: f"solved {name}" for name in names[:3]},
    ]
    assert (first.keyframes, second.keyframes) == (3, 4)


def test_problem_does_not_wait_for_more_than_one_keyframe_that_is_estimated_ahead() -> None:
    process = FakeProcess()
    with SolverProcess(prepare("lnd").instrument) as solver:
        solver._process = cast(Any, process)
        process.busy = []
        solver.prepare(TASKS[:4])
        solver.begin(problem(2))
        assert not solver.ready
        process.busy.pop().set_result("result")
        process.busy = None
        solver.solution()
        for _ in range(4):
            solver.prepare(TASKS[:4])
    assert process.problems == [{}]
    assert process.estimated == [TASKS[k].keyframe.name for k in (0, 1, 3)]  # the problem has estimated the other one


def test_keyframes_that_others_replace_are_not_estimated_and_forgotten() -> None:
    process = FakeProcess()
    with SolverProcess(prepare("lnd").instrument) as solver:
        solver._process = cast(Any, process)
        process.busy = []
        for k in range(30):  # of three that are kept, the oldest one is replaced
            solver.prepare(TASKS[k : k + 3])
        assert process.estimated == [TASKS[0].keyframe.name]
        process.busy.pop().set_result("result")
        process.busy = None
        for _ in range(4):
            solver.prepare(TASKS[29:32])
        assert process.estimated[1:] == [task.keyframe.name for task in TASKS[29:32]]
        assert set(solver._alone) == {task.keyframe.name for task in TASKS[29:32]}
