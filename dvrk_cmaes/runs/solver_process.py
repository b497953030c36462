"""A process that solves the keyframes of a tracker beside its steps."""

from __future__ import annotations

import contextlib
import os
from concurrent.futures import Future, ThreadPoolExecutor
from types import TracebackType

from dvrk_cmaes.errors import DvrkCmaesError
from dvrk_cmaes.instrument import Instrument
from dvrk_cmaes.runs.digests import instrument_digest
from dvrk_cmaes.runs.worker_process import ProcessDiedError, WorkerProcess
from dvrk_cmaes.silhouette.prepare import body_by
from dvrk_cmaes.track.keyframe_store import KeyframeProblem, Solution

_TRIES = 2  # of a problem that its process dies on


class SolverProcess:
    """Solves keyframes in a process of its own, which is started with the first problem; a context manager.

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
        self._instrument, self._threads, self._background = instrument, threads, background
        self._key = instrument_digest(instrument)
        self._driver = ThreadPoolExecutor(1)
        self._process: WorkerProcess | None = None
        self._future: Future[Solution] | None = None
        self._closed = False

    def __enter__(self) -> SolverProcess:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def begin(self, problem: KeyframeProblem) -> None:
        """Begin with a problem; returns at once."""
        self._future = self._driver.submit(self._solved, problem)

    @property
    def ready(self) -> bool:
        """Whether the solution of the last problem is there."""
        return self._future is not None and self._future.done()

    def solution(self) -> Solution:
        """Return the solution of the last problem, for which this waits.

        Raises
        ------
        DvrkCmaesError
            The process died twice on it.
        """
        assert self._future is not None
        return self._future.result()

    def close(self) -> None:
        """End the process, whatever it is at."""
        self._closed = True
        process = self._process
        if process is not None:
            process.kill()
        self._driver.shutdown(cancel_futures=True)
        if process is not None:
            process.close()

    def _solved(self, problem: KeyframeProblem) -> Solution:
        """Solve a problem in the process, and once more in a new one if that dies."""
        for _ in range(_TRIES):
            if self._closed:
                break
            with contextlib.suppress(ProcessDiedError):
                if self._process is None:
                    self._process = process = WorkerProcess()
                    process.call(_prepare, self._instrument, self._background)
                return self._process.call(_solve, self._key, problem, self._threads)
            self._process = None
        raise DvrkCmaesError(f"keyframes: their process died {_TRIES} times: out of memory?")


def _prepare(instrument: Instrument, background: bool) -> None:
    """Prepare the instrument in the process."""
    from dvrk_cmaes.runs.worker import prepare_instrument

    if background and hasattr(os, "nice"):
        os.nice(10)
    prepare_instrument(instrument)


def _solve(key: str, problem: KeyframeProblem, threads: int) -> Solution:
    """Solve a problem with the instrument whose digest is ``key``."""
    from dvrk_cmaes.runs.worker import prepared_body

    return problem.solve(body_by(prepared_body(key), problem.config.silhouette.method), threads)
