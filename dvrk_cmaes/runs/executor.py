"""Running many tasks in an executor of the caller: any ``concurrent.futures.Executor``, e.g. of a cluster."""

from __future__ import annotations

import threading
from collections.abc import Callable, Generator, Iterable
from concurrent.futures import FIRST_COMPLETED, CancelledError, Executor, Future, wait
from dataclasses import dataclass
from typing import TypeVar

from dvrk_cmaes.errors import DvrkCmaesError
from dvrk_cmaes.runs.processes import WorkerDied

T = TypeVar("T")
R = TypeVar("R")


@dataclass(frozen=True)
class ExternalExecutor:
    """An executor and its properties.

    ``at_once()`` is how many tasks to submit at a time: at least as many as it has workers. ``gives_up`` are the
    exceptions of a future whose worker has died so often that the executor gave the task up.
    """

    executor: Executor
    at_once: Callable[[], int]
    gives_up: tuple[type[BaseException], ...] = ()


def run_in_executor(
    tasks: Iterable[T], call: Callable[[T], R], *, external: ExternalExecutor, stop: threading.Event
) -> Generator[tuple[T, R | WorkerDied], None, None]:
    """Run tasks in an executor, and yield each with its value in the order of completion.

    ``call`` must not raise, and must be picklable if the executor's workers are processes. Once ``stop`` is set, tasks
    that were submitted are finished, and no more are submitted.

    Raises
    ------
    DvrkCmaesError
        The executor cannot go on.
    """
    source = iter(tasks)
    running: dict[Future[R], T] = {}
    try:
        while True:
            while not stop.is_set() and len(running) < external.at_once() and (task := next(source, None)) is not None:
                try:
                    running[external.executor.submit(call, task)] = task
                except (RuntimeError, OSError) as error:  # RuntimeError: shut down, or broken
                    raise _lost(error) from error
            if not running:
                return
            for future in wait(running, return_when=FIRST_COMPLETED).done:
                value = _value(future, external.gives_up)
                yield running.pop(future), value
    finally:
        for future in running:
            future.cancel()


def _value(future: Future[R], gives_up: tuple[type[BaseException], ...]) -> R | WorkerDied:
    try:
        return future.result()
    except gives_up as error:
        return WorkerDied(f"its worker died, more than once: out of memory, or a crash in a native library ({error})")
    except (Exception, CancelledError) as error:  # ``call`` does not raise: the error lies in the transport
        raise _lost(error) from error


def _lost(error: BaseException) -> DvrkCmaesError:
    said = " ".join(str(error).split()) or type(error).__name__
    return DvrkCmaesError(
        f"the workers were lost ({said}): what is done is kept, and the same command goes on from there"
    )
