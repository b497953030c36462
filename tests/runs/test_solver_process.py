"""The process that solves keyframes: when it is started, what it does ahead, and that it ends with its owner."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from typing import Any, cast

import psutil
import pytest
from helpers.waiting import wait_for

from dvrk_cmaes import Camera, EstimateConfig, Keyframe, KeyframeProblem, ReadingSeries, Rig, Solution, prepare
from dvrk_cmaes.runs.solver_process import SolverProcess


def started_since(before: set[int]) -> list[psutil.Process]:
    """Return the processes of Python that this one has started since; not the one that tracks resources."""
    children = [child for child in psutil.Process().children(recursive=True) if child.pid not in before]
    return [child for child in children if "resource_tracker" not in " ".join(child.cmdline())]


@pytest.mark.parametrize("background", [False, True])
def test_process_in_the_background_starts_before_the_first_problem(*, background: bool) -> None:
    before = {child.pid for child in psutil.Process().children(recursive=True)}
    with SolverProcess(prepare("lnd"), background=background):
        if background:
            wait_for(lambda: started_since(before))
        else:
            time.sleep(1)
            assert not started_since(before)
    assert not started_since(before)


class FakeProcess:
    """Notes what it is called with, and answers at once, unless ``busy``; the own result of a keyframe is a text."""

    def __init__(self) -> None:
        self.estimated: list[str] = []
        self.problems: list[dict[str, str]] = []
        self.busy = False
        self.waiting: list[Future[Any]] = []

    def submit(self, _: Any, body: bytes, method: Callable[..., Any], given: Any, threads: int) -> Future[Any]:
        future, answer = Future[Any](), self._answer(method, given)
        if self.busy:
            self.waiting.append(future)
        else:
            future.set_result(answer)
        return future

    def _answer(self, function: Callable[..., Any], given: Any) -> Any:
        if function.__name__ == "estimate":
            (keyframe,) = given.keyframes
            self.estimated.append(keyframe.name)
            return {keyframe.name: f"result of {keyframe.name}"}
        self.problems.append(dict(given.alone))
        return Solution(None, "", len(given.keyframes), {one.name: f"solved {one.name}" for one in given.keyframes})

    def kill(self) -> None: ...


RIG, CONFIG = Rig.of(Camera(160, 120, 200.0, 200.0, 80.0, 60.0)), EstimateConfig()
TASKS = [KeyframeProblem((Keyframe(0.1 * k, {}, {}, {}, {}),), None, RIG, "classic", CONFIG) for k in range(40)]
NAMES = [task.keyframes[0].name for task in TASKS]


def problem(*numbers: int) -> KeyframeProblem:
    keyframes = tuple(TASKS[k].keyframes[0] for k in numbers)
    return KeyframeProblem(keyframes, ReadingSeries("s", {}, {}, {}, 0.1), RIG, "classic", CONFIG)


@pytest.fixture
def solver() -> Iterator[tuple[SolverProcess, FakeProcess]]:
    process = FakeProcess()
    with SolverProcess(prepare("lnd")) as made:
        made._process = cast(Any, process)
        yield made, process


def prepared(solver: SolverProcess, tasks: list[KeyframeProblem]) -> None:
    """Ask for keyframes until nothing more is done for them."""
    for _ in range(len(tasks) + 1):
        wait_for(lambda: solver._last.done())
        solver.prepare(tasks)
    wait_for(lambda: solver._last.done())


def kept_busy(solver: SolverProcess, process: FakeProcess, tasks: list[KeyframeProblem]) -> Future[Any]:
    """Let the process be at the first of some keyframes until the future that is returned has its answer."""
    process.busy = True
    solver.prepare(tasks)
    wait_for(lambda: bool(process.waiting))
    return process.waiting.pop()


def test_keyframes_are_estimated_ahead_of_their_problem_each_once(solver: tuple[SolverProcess, FakeProcess]) -> None:
    made, process = solver
    for known in (1, 2, 2):
        prepared(made, TASKS[:known])
    found = [made.begin(problem(*range(count))) for count in (3, 4)]  # of which the last ones were not estimated ahead
    assert [one.result(10).keyframes for one in found] == [3, 4]
    assert process.estimated == NAMES[:2]
    assert process.problems == [
        {name: f"result of {name}" for name in NAMES[:2]},
        {name: f"solved {name}" for name in NAMES[:3]},
    ]


def test_problem_does_not_wait_for_more_than_one_keyframe_that_is_estimated_ahead(
    solver: tuple[SolverProcess, FakeProcess],
) -> None:
    made, process = solver
    answer = kept_busy(made, process, TASKS[:4])
    for _ in range(3):
        made.prepare(TASKS[:4])
    found = made.begin(problem(2))
    process.busy = False
    answer.set_result({NAMES[0]: "result"})
    assert found.result(10).keyframes == 1
    prepared(made, TASKS[:4])
    assert process.problems == [{}]
    assert process.estimated == [NAMES[k] for k in (0, 1, 3)]  # the problem has estimated the other one
