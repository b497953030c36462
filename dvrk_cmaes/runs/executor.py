"""Many tasks over any ``concurrent.futures.Executor``: somebody else's processes, threads, or a cluster."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, CancelledError, Executor, Future, wait
from dataclasses import dataclass
from typing import TypeVar

from dvrk_cmaes.errors import DvrkCmaesError
from dvrk_cmaes.runs.processes import Died

T = TypeVar("T")
R = TypeVar("R")


@dataclass(frozen=True)
class Elsewhere:
    """An executor, and what must be known of it.

    ``at_once()`` is how many tasks to hand over at a time, more than it has workers, so that none has to wait;
    ``gives_up`` are the exceptions of a task's future that say that its worker died, and not for the first time.
    """

    executor: Executor
    at_once: Callable[[], int]
    gives_up: tuple[type[BaseException], ...] = ()


def through_executor(
    tasks: Iterable[T], call: Callable[[T], R], *, elsewhere: Elsewhere, stop: threading.Event
) -> Iterator[tuple[T, R | Died]]:
    """Do tasks by an executor, and yield each with its value as it is done, in no certain order.

    ``call`` must be picklable where the executor's workers are processes, and should not raise. Once ``stop`` is set,
    what was handed over is finished, and nothing more is.

    Raises
    ------
    DvrkCmaesError
        The executor cannot go on.
    """
    source = iter(tasks)
    running: dict[Future[R], T] = {}
    try:
        while True:
            while not stop.is_set() and len(running) < elsewhere.at_once() and (task := next(source, None)) is not None:
                running[_submitted(elsewhere.executor, call, task)] = task
            if not running:
                return
            for future in wait(running, return_when=FIRST_COMPLETED).done:
                value = _value(future, elsewhere.gives_up)
                yield running.pop(future), value
    finally:
        for future in running:
            future.cancel()


def _submitted(executor: Executor, call: Callable[[T], R], task: T) -> Future[R]:
    try:
        return executor.submit(call, task)
    except (RuntimeError, OSError) as error:  # RuntimeError: shut down, or broken
        raise _lost(error) from error


def _value(future: Future[R], gives_up: tuple[type[BaseException], ...]) -> R | Died:
    try:
        return future.result()
    except gives_up as error:
        return Died(f"its worker died, more than once: out of memory, or a crash in a native library ({error})")
    except (Exception, CancelledError) as error:  # ``call`` does not raise: it is the way there or back.
        raise _lost(error) from error


def _lost(error: BaseException) -> DvrkCmaesError:
    said = " ".join(str(error).split()) or type(error).__name__
    return DvrkCmaesError(
        f"the workers were lost ({said}): what is done is kept, and the same command goes on from there"
    )
