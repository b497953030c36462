"""Worker processes replaced by calls in the test's own process, for tests whose subject is not processes.

A worker takes a second of processor time to start. What goes to a worker and back is pickled here, too.
"""

from __future__ import annotations

import pickle
import threading
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from typing import Any

import pytest

from dvrk_cmaes.runs import processes

_REAL = processes.WorkerConnection
_ONE_AT_A_TIME = threading.Lock()


class _CallsHere:
    """Stands for a worker process: runs one task at a time, in the thread that gives it."""

    is_beginning = False

    def __init__(self, start: Callable[[], object]) -> None:
        self._start = start

    def begin(self) -> None:
        pass

    def run(self, call: Callable[..., Any], *arguments: Any, time_limit: float | None = None) -> Any:
        with _ONE_AT_A_TIME:
            pickle.loads(pickle.dumps(self._start))()  # each time, because another one's instrument may be prepared
            function, copies = pickle.loads(pickle.dumps((call, arguments)))
            return pickle.loads(pickle.dumps(function(*copies)))

    def close(self) -> None:
        pass

    kill = end = close


def processes_here() -> AbstractContextManager[None]:
    """Let batches, calibrations and recordings that are followed run the tasks of their workers in this process."""
    return _with(_CallsHere)


def real_processes() -> AbstractContextManager[None]:
    """Let them have worker processes within `processes_here`."""
    return _with(_REAL)


@contextmanager
def _with(process: type) -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(processes, "WorkerConnection", process)
        yield
