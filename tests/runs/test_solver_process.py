"""The process that solves keyframes: when it is started, what it does ahead, and that it ends with its owner."""

from __future__ import annotations

import threading
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
    """Notes what it is called with; the own result of a keyframe is a text."""

    def __init__(self) -> None:
        self.estimated: list[str] = []
        self.problems: list[dict[str, str]] = []

    def submit(self, function: Callable[..., Any], key: str, given: Any, threads: int) -> Future[Any]:
        future = Future[Any]()
        future.set_result(self._answer(function, given))
        return future

    def _answer(self, function: Callable[..., Any], given: Any) -> Any:
        if function.__name__ == "_estimate":
            self.estimated.append(given.keyframe.name)
            return f"result of {given.keyframe.name}"
        self.problems.append(dict(given.alone))
        return Solution(None, "", len(given.keyframes), {one.name: f"solved {one.name}" for one in given.keyframes})

    def kill(self) -> None: ...

    def close(self) -> None: ...


def keyframe(time: float) -> Keyframe:
    return Keyframe(time, {}, {}, {}, {})


def test_keyframes_are_estimated_ahead_of_their_problem_each_once() -> None:
    rig, config = Rig.of(Camera(160, 120, 200.0, 200.0, 80.0, 60.0)), EstimateConfig()
    keyframes = tuple(keyframe(0.1 * k) for k in range(4))
    tasks = [KeyframeTask(one, rig, config) for one in keyframes]
    process, no_readings = FakeProcess(), ReadingSeries("s", {}, {}, {}, 0.1)
    with SolverProcess(prepare("lnd").instrument) as solver:
        solver._process = cast(Any, process)
        for known in (1, 2, 2):
            solver.prepare(tasks[:known])
        solver._driver.submit(int).result(30)
        for count in (3, 4):  # of which the last ones were not estimated ahead
            solver.begin(KeyframeProblem(keyframes[:count], no_readings, rig, "classic", config))
            solver.prepare(tasks[:count])
        first, second = solver.solution(), solver.solution()
    names = [one.name for one in keyframes]
    assert process.estimated == names[:2]
    assert process.problems == [
        {name: f"result of {name}" for name in names[:2]},
        {name: f"solved {name}" for name in names[:3]},
    ]
    assert (first.keyframes, second.keyframes) == (3, 4)


def test_problem_does_not_wait_for_keyframes_that_are_estimated_ahead() -> None:
    rig, config = Rig.of(Camera(160, 120, 200.0, 200.0, 80.0, 60.0)), EstimateConfig()
    tasks = [KeyframeTask(keyframe(0.1 * k), rig, config) for k in range(4)]
    process, begin = FakeProcess(), threading.Event()
    with SolverProcess(prepare("lnd").instrument) as solver:
        solver._process = cast(Any, process)
        solver._driver.submit(begin.wait, 30)  # the process is at something else
        solver.prepare(tasks)
        solver.begin(KeyframeProblem((tasks[2].keyframe,), ReadingSeries("s", {}, {}, {}, 0.1), rig, "classic", config))
        begin.set()
        solver.solution()
        solver._driver.submit(int).result(30)
    assert process.problems == [{}]
    assert process.estimated == [tasks[k].keyframe.name for k in (0, 1, 3)]  # the problem has estimated the other one


def test_keyframes_that_others_replace_are_not_estimated_and_forgotten() -> None:
    rig, config = Rig.of(Camera(160, 120, 200.0, 200.0, 80.0, 60.0)), EstimateConfig()
    tasks = [KeyframeTask(keyframe(0.1 * k), rig, config) for k in range(40)]
    process, begin = FakeProcess(), threading.Event()
    with SolverProcess(prepare("lnd").instrument) as solver:
        solver._process = cast(Any, process)
        solver._driver.submit(begin.wait, 30)  # the process is at something else
        for k in range(30):  # of three that are kept, the oldest one is replaced
            solver.prepare(tasks[k : k + 3])
        assert solver._driver._work_queue.qsize() <= 3
        begin.set()
        solver._driver.submit(int).result(30)
        assert process.estimated == [task.keyframe.name for task in tasks[29:32]]
        for k in range(30, 38):
            solver.prepare(tasks[k : k + 3])
            solver._driver.submit(int).result(30)
        assert set(solver._ahead) == {task.keyframe.name for task in tasks[37:40]}
