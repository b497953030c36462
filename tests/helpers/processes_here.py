"""Worker processes replaced by calls in the test's own process, for tests whose subject is not processes.

A worker takes a second of processor time to start. What goes to a worker and back is pickled here, too.
"""

from __future__ import annotations

import pickle
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from contextlib import AbstractContextManager, contextmanager
from typing import Any

import pytest

from dvrk_cmaes.runs.pool import Pool

_REAL = Pool.submit, Pool.begin
_ONE_AT_A_TIME = threading.Lock()


def _submit_here(pool: Pool, call: Callable[..., Any], *arguments: Any) -> Future[Any]:
    """Run one call at a time, in the thread that submits it."""
    future = Future[Any]()
    with _ONE_AT_A_TIME:
        try:
            pickle.loads(pickle.dumps(pool.start))()  # each time, because another one's instrument may be prepared
            function, copies = pickle.loads(pickle.dumps((call, arguments)))
            future.set_result(pickle.loads(pickle.dumps(function(*copies))))
        except Exception as error:
            future.set_exception(error)
    return future


def _begin_nothing(pool: Pool) -> Pool:
    return pool


def processes_here() -> AbstractContextManager[None]:
    """Let batches, calibrations and recordings that are followed run the tasks of their workers in this process."""
    return _with(_submit_here, _begin_nothing)


def real_processes() -> AbstractContextManager[None]:
    """Let them have worker processes within `processes_here`."""
    return _with(*_REAL)


@contextmanager
def _with(submit: Callable[..., Future[Any]], begin: Callable[[Pool], Pool]) -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Pool, "submit", submit)
        patch.setattr(Pool, "begin", begin)
        yield
