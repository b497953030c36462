"""A process that solves the keyframes of a tracker beside its steps."""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import ExitStack, suppress
from dataclasses import replace
from functools import partial
from threading import Lock
from typing import TypeVar

from dvrk_cmaes.errors import DvrkCmaesError
from dvrk_cmaes.instrument import Instrument
from dvrk_cmaes.results.result import Result
from dvrk_cmaes.runs.live_session import give_back_memory
from dvrk_cmaes.runs.manifest import instrument_digest
from dvrk_cmaes.runs.pool import Pool
from dvrk_cmaes.track.keyframe_problem import KeyframeProblem, KeyframeTask, Solution

R = TypeVar("R")
T = TypeVar("T")

_TRIES = 2  # of a problem that its process dies on


class SolverProcess(ExitStack):
    """Solves keyframes in a process of its own; a context manager.

    The process is started with the first problem; one in the background is at once, so that no step is delayed by it.

    Parameters
    ----------
    instrument
        The instrument.
    threads
        Number of threads of the process.
    background
        Whether the process is given processor time only where others do not need it.
    """

    def __init__(self, instrument: Instrument, *, threads: int = 1, background: bool = False) -> None:
        super().__init__()
        self._threads = threads
        self._key = instrument_digest(instrument)
        self._driver = ThreadPoolExecutor(1)
        self._process, self._over = Pool(partial(_prepare, instrument, background), 1), False
        self._futures: deque[Future[Solution]] = deque()
        self._problems: deque[tuple[KeyframeProblem, Future[Solution]]] = deque()  # not begun
        self._tasks: dict[str, KeyframeTask] = {}  # the keyframes that no solution has estimated yet
        self._ahead: dict[str, Result | None] = {}  # what was found of these, None where that failed
        self._solved: Mapping[str, Result] = {}  # the own results of the keyframes of the last solution
        self._works = False  # whether the driver does
        self._lock = Lock()
        self.callback(self._end)
        if background:
            self._process.begin()

    def begin(self, problem: KeyframeProblem) -> None:
        """Begin with a problem, after those before it; returns at once."""
        future = Future[Solution]()
        self._futures.append(future)
        with self._lock:
            self._problems.append((problem, future))
            self._drive()

    def prepare(self, tasks: Sequence[KeyframeTask]) -> None:
        """Estimate keyframes by themselves, each once, while there is no problem; returns at once.

        ``tasks`` are all that no solution has estimated yet, in the order in which they are wanted. Those before that
        are not among them any more, as where others were kept instead, are not estimated, and forgotten.
        """
        with self._lock:
            self._tasks = {task.keyframe.name: task for task in tasks}
            self._ahead = {name: result for name, result in self._ahead.items() if name in self._tasks}
            if self._tasks:
                self._drive()

    def _drive(self) -> None:
        """Have the driver work, unless it does."""
        if not self._works:
            self._works = True
            self._driver.submit(self._work)

    @property
    def ready(self) -> bool:
        """Whether the next solution is there."""
        return bool(self._futures) and self._futures[0].done()

    def solution(self) -> Solution:
        """Return the next solution, for which this waits.

        Raises
        ------
        DvrkCmaesError
            The process died twice on it.
        """
        return self._futures.popleft().result()

    def _end(self) -> None:
        """End the process, whatever it is at."""
        self._over = True
        self._process.kill()
        self._driver.shutdown()
        self._process.close()

    def _work(self) -> None:
        """Solve all problems, one after the other; while there is none, estimate the first keyframe by itself."""
        while self._works:
            with self._lock:
                problem, future = self._problems.popleft() if self._problems else (None, None)
                names = (name for name in self._tasks if not {name} & (self._ahead.keys() | self._solved.keys()))
                name = next(names, None)
                task = None if name is None else self._tasks[name]
                self._works = problem is not None or task is not None
            if problem is not None and future is not None:
                try:
                    future.set_result(self._solution_of(problem))
                except Exception as error:
                    future.set_exception(error)
            elif name is not None and task is not None:
                found: Result | None = None
                with suppress(Exception):  # which is tried again, and raised, with a problem
                    found = self._call(_estimate, task)
                with self._lock:
                    self._ahead[name] = found

    def _solution_of(self, problem: KeyframeProblem) -> Solution:
        """Solve a problem in the process, and once more in a new one if that dies.

        No keyframe is solved by itself twice, where problems were given before the solutions of others were there.
        """
        with self._lock:
            known = self._ahead | {**self._solved}
        names = {keyframe.name for keyframe in problem.keyframes}
        alone = {name: result for name, result in known.items() if name in names and result is not None}
        problem = replace(problem, alone={**alone, **problem.alone})
        for _ in range(_TRIES):
            with suppress(BrokenProcessPool):
                solution = self._call(_solve, problem)
                give_back_memory()
                self._solved = solution.alone
                return solution
        raise DvrkCmaesError(f"keyframes: their process died {_TRIES} times: out of memory?")

    def _call(self, function: Callable[[str, T, int], R], task: T) -> R:
        """Call a function with the instrument in the process; one that dies on it is started again by the next call."""
        if self._over:
            raise BrokenProcessPool
        try:
            return self._process.submit(function, self._key, task, self._threads).result()
        except BrokenProcessPool:
            self._process.kill()
            raise


def _prepare(instrument: Instrument, background: bool) -> None:
    """Prepare the instrument in the process."""
    from dvrk_cmaes.runs.worker import prepare_instrument

    if background and hasattr(os, "nice"):
        os.nice(10)
    prepare_instrument(instrument)


def _estimate(key: str, task: KeyframeTask, threads: int) -> Result:
    """Estimate a keyframe by itself with the instrument whose digest is ``key``."""
    from dvrk_cmaes.runs.worker import prepared_body

    return task.estimate(prepared_body(key), threads)


def _solve(key: str, problem: KeyframeProblem, threads: int) -> Solution:
    """Solve a problem with the instrument whose digest is ``key``."""
    from dvrk_cmaes.runs.worker import prepared_body

    solution = problem.solve(prepared_body(key), threads)
    give_back_memory()
    return solution
