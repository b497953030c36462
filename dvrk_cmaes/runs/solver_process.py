"""A process that solves the keyframes of a tracker while it follows images."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from concurrent.futures import CancelledError, Future, ThreadPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import ExitStack, suppress
from dataclasses import replace
from functools import partial
from typing import Any, TypeVar

from dvrk_cmaes.errors import DvrkCmaesError
from dvrk_cmaes.results.result import Result
from dvrk_cmaes.runs.live_session import give_back_memory
from dvrk_cmaes.runs.pool import Pool, packed, unpacked
from dvrk_cmaes.silhouette import Body
from dvrk_cmaes.track.keyframe_problem import KeyframeProblem, Solution

R = TypeVar("R")

_TRIES = 2  # of a problem that its process dies on


class SolverProcess(ExitStack):
    """Solves keyframes in a process of its own; a context manager.

    The process is started with the first problem; one in the background is at once, so that no step is delayed by it.
    It is given one thing at a time to do, by a thread that waits for it.

    Parameters
    ----------
    body
        The instrument.
    threads
        Number of threads of the process.
    background
        Whether the process is given processor time only where others do not need it.
    """

    def __init__(self, body: Body, *, threads: int = 1, background: bool = False) -> None:
        super().__init__()
        self._threads, self._body = threads, packed(body)
        self._process = self.enter_context(Pool(partial(os.nice, 10) if background and hasattr(os, "nice") else int, 1))
        self._asking = self.enter_context(ThreadPoolExecutor(1))
        self._ended = False
        self.callback(self._end)
        self._last: Future[Any] = Future()  # of what was asked for last
        self._last.set_result(None)
        self._alone: dict[str, Result | None] = {}  # what was found of single keyframes, None where that failed
        if background:
            self._process.begin()

    def begin(self, problem: KeyframeProblem) -> Future[Solution]:
        """Begin with a problem, after those before it; returns at once.

        The solution raises DvrkCmaesError if the process died twice on it.
        """
        self._last = future = self._asking.submit(self._solved, problem)
        return future

    def prepare(self, tasks: Sequence[KeyframeProblem]) -> None:
        """Estimate the next keyframe by itself, while there is nothing else to do; returns at once.

        ``tasks`` are all that no solution has estimated yet, in the order in which they are wanted. Others are
        forgotten.
        """
        if self._last.done():
            by_name = {task.keyframes[0].name: task for task in tasks}
            self._alone = {name: found for name, found in self._alone.items() if name in by_name}
            name = next((name for name in by_name if name not in self._alone), None)
            if name is not None:
                self._last = self._asking.submit(self._estimated, name, by_name[name])

    def _estimated(self, name: str, task: KeyframeProblem) -> None:
        """Estimate a keyframe; where that fails, it is tried again, and raised, with a problem."""
        self._alone[name] = None
        with suppress(Exception):
            self._alone |= self._called(KeyframeProblem.estimate, task)

    def _solved(self, problem: KeyframeProblem) -> Solution:
        """Solve a problem with what was found of its keyframes by themselves, so that none is estimated twice."""
        known = {one.name: result for one in problem.keyframes if (result := self._alone.get(one.name)) is not None}
        solution = self._called(KeyframeProblem.solve, replace(problem, alone={**known, **problem.alone}))
        self._alone |= solution.alone
        give_back_memory()
        return solution

    def _called(self, method: Callable[[KeyframeProblem, Body, int], R], problem: KeyframeProblem) -> R:
        """Call a method of a problem in the process; one that has died is started again, once."""
        for _ in range(_TRIES):
            try:
                found: Future[R] = self._process.submit(_apply, self._body, method, problem, self._threads)
                return found.result()
            except (BrokenProcessPool, CancelledError):
                self._process.kill()
                if self._ended:
                    break
        raise DvrkCmaesError(f"keyframes: their process died {_TRIES} times: out of memory?")

    def _end(self) -> None:
        """End what the process is at."""
        self._ended = True
        self._asking.shutdown(wait=False, cancel_futures=True)
        self._process.kill()


def _apply(body: bytes, method: Callable[[KeyframeProblem, Body, int], R], problem: KeyframeProblem, threads: int) -> R:
    """Call a method of a problem with the instrument, and return the memory that it needed."""
    found = method(problem, unpacked(body), threads)
    give_back_memory()
    return found
