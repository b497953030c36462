"""A process that solves the keyframes of a tracker beside its steps."""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Callable, Sequence
from concurrent.futures import Future
from concurrent.futures.process import BrokenProcessPool
from contextlib import ExitStack
from dataclasses import replace
from functools import partial
from typing import Any, TypeVar

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
    It is given one thing at a time to do, the next one with the next call of a method.

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
        self._threads, self._key = threads, instrument_digest(instrument)
        self._process = self.enter_context(Pool(partial(_prepare, instrument, background), 1))
        self.callback(self._process.kill)
        self._call: Future[Any] | None = None  # what the process does
        self._task: KeyframeTask | None = None  # that this estimates; None if it solves the first problem
        self._tries = 0  # of the first problem
        self._problems: deque[KeyframeProblem] = deque()  # not solved yet
        self._found: deque[Solution | Exception] = deque()  # not asked for yet
        self._tasks: dict[str, KeyframeTask] = {}  # the keyframes that no solution has estimated yet
        self._alone: dict[str, Result | None] = {}  # what was found of these, None where that failed
        self._solved: dict[str, Result] = {}  # the own results of the keyframes of the last solution
        if background:
            self._process.begin()

    def begin(self, problem: KeyframeProblem) -> None:
        """Begin with a problem, after those before it; returns at once."""
        self._problems.append(problem)
        self._go_on()

    def prepare(self, tasks: Sequence[KeyframeTask]) -> None:
        """Estimate keyframes by themselves, each once, while there is no problem; returns at once.

        ``tasks`` are all that no solution has estimated yet, in the order in which they are wanted. Others are
        forgotten.
        """
        self._tasks = {task.keyframe.name: task for task in tasks}
        self._alone = {name: result for name, result in self._alone.items() if name in self._tasks}
        self._go_on()

    @property
    def ready(self) -> bool:
        """Whether the next solution is there."""
        self._go_on()
        return bool(self._found)

    def solution(self) -> Solution:
        """Return the next solution, for which this waits.

        Raises
        ------
        DvrkCmaesError
            The process died twice on it.
        """
        while not self._found:
            self._go_on(wait=True)
        found = self._found.popleft()
        if isinstance(found, Exception):
            raise found
        return found

    def _go_on(self, *, wait: bool = False) -> None:
        """Take what the process has done, and give it the next problem, or else the next keyframe."""
        if self._call is not None:
            if not (wait or self._call.done()):
                return
            self._take(self._call)
        names = (name for name in self._tasks if name not in self._alone and name not in self._solved)
        if self._problems:
            self._task, self._call = None, self._submitted(_solve, self._with_known(self._problems[0]))
        elif (name := next(names, None)) is not None:
            self._task = self._tasks[name]
            self._call = self._submitted(_estimate, self._task)

    def _take(self, call: Future[Any]) -> None:
        """Take what a call has found; a problem on which the process died is tried once more."""
        found: Any = None
        error: Exception | None = None
        self._call, died = None, False
        try:
            found = call.result()
        except BrokenProcessPool:
            self._process.kill()
            error, died = DvrkCmaesError(f"keyframes: their process died {_TRIES} times: out of memory?"), True
        except Exception as raised:
            error = raised
        if self._task is not None:  # if that failed, it is tried again, and raised, with a problem
            self._alone[self._task.keyframe.name] = found
            return
        self._tries += 1
        if died and self._tries < _TRIES:
            return
        self._problems.popleft()
        self._tries = 0
        self._found.append(found if error is None else error)
        if error is None:
            self._solved = dict(found.alone)
            give_back_memory()

    def _with_known(self, problem: KeyframeProblem) -> KeyframeProblem:
        """Return a problem with what was found of its keyframes by themselves, so that none is estimated twice."""
        known, names = self._alone | {**self._solved}, {keyframe.name for keyframe in problem.keyframes}
        alone = {name: result for name, result in known.items() if name in names and result is not None}
        return replace(problem, alone={**alone, **problem.alone})

    def _submitted(self, function: Callable[[str, T, int], R], task: T) -> Future[R]:
        """Begin to call a function with the instrument in the process; one that has died is started again."""
        try:
            return self._process.submit(function, self._key, task, self._threads)
        except BrokenProcessPool:
            self._process.kill()
            return self._process.submit(function, self._key, task, self._threads)


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
