"""Many tasks over processes of our own; one that dies on a task costs that task only.

Each process is driven by a thread of its own, so when one dies it is known on which task. That task is tried once more
in a fresh process (something else may have used up the memory), then given up.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import queue
import signal
import threading
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import BrokenExecutor, ProcessPoolExecutor
from dataclasses import dataclass
from typing import Generic, TypeVar

from dvrk_cmaes.errors import DvrkCmaesError

T = TypeVar("T")
R = TypeVar("R")

_TRIES = 2  # of a task that its process dies on
_STARTS = 3  # of a process, before it is taken for impossible


@dataclass(frozen=True)
class Died:
    """Instead of a task's value: why there is none."""

    reason: str


def through_processes(
    tasks: Iterable[T],
    call: Callable[[T], R],
    *,
    start: Callable[[], object],
    workers: int,
    time_limit: float,
    stop: threading.Event,
) -> Iterator[tuple[T, R | Died]]:
    """Do tasks in processes of our own, and yield each with its value as it is done, in no certain order.

    Parameters
    ----------
    tasks
        What ``call`` takes.
    call, start
        Functions that can be pickled; ``start`` is called first in each process. Neither should raise.
    workers
        How many processes.
    time_limit
        Seconds after which a task's process is ended.
    stop
        Once it is set, what is running is finished, and nothing more is begun.

    Raises
    ------
    DvrkCmaesError
        Processes cannot be started.
    """
    source = _Source(tasks, stop)
    done: queue.SimpleQueue[tuple[T, R | Died] | Exception | None] = queue.SimpleQueue()
    processes = [_Process(start) for _ in range(workers)]
    threads = [
        threading.Thread(target=_drive, args=(one, source, call, time_limit, done.put), daemon=True)
        for one in processes
    ]
    for thread in threads:
        thread.start()
    busy = len(threads)
    try:
        while busy:
            match done.get():
                case None:
                    busy -= 1
                case Exception() as error:
                    raise error
                case outcome:
                    yield outcome
    finally:
        source.close()
        if busy:
            for process in processes:
                process.end()
        for thread in threads:
            thread.join()


class _NothingMoreError(Exception):
    """A task is left undone, because nobody wants it any more."""


class _Source(Generic[T]):
    """Tasks for several threads, until there are none or nobody wants them."""

    def __init__(self, tasks: Iterable[T], stop: threading.Event) -> None:
        self._tasks, self._stop = iter(tasks), stop
        self._closed = False
        self._lock = threading.Lock()

    def close(self) -> None:
        self._closed = True

    @property
    def ended(self) -> bool:
        return self._closed or self._stop.is_set()

    def __iter__(self) -> Iterator[T]:
        while not self.ended:
            with self._lock:
                task = next(self._tasks, None)
            if task is None:
                return
            yield task


def _drive(
    process: _Process,
    source: _Source[T],
    call: Callable[[T], R],
    time_limit: float,
    give: Callable[[tuple[T, R | Died] | Exception | None], None],
) -> None:
    """Do tasks one after the other in one process."""
    try:
        with contextlib.suppress(_NothingMoreError):
            for task in source:
                give((task, _tried(process, call, task, time_limit, source)))
        process.close(wait=True)
        give(None)
    except Exception as error:
        give(error)


def _tried(process: _Process, call: Callable[[T], R], task: T, time_limit: float, source: _Source[T]) -> R | Died:
    """Do a task, again if its process dies, unless nothing more should be begun by then."""
    for _ in range(_TRIES):
        try:
            return process.run(call, task, time_limit)
        except TimeoutError:
            process.kill()
            return Died(f"no result after {time_limit:g} s: its process was ended")
        except BrokenExecutor:
            process.close()
            if source.ended:
                raise _NothingMoreError from None
    return Died(f"its process died {_TRIES} times: out of memory, or a crash in a native library")


class _Process:
    """A process that is started when it is needed, and again when it has died."""

    def __init__(self, start: Callable[[], object]) -> None:
        self._start = start
        self._pool: ProcessPoolExecutor | None = None
        self._id: int | None = None
        self._over = False

    def run(self, call: Callable[[T], R], task: T, time_limit: float) -> R:
        """Do a task; raises BrokenExecutor if the process died on it, TimeoutError if it takes too long."""
        pool = self._started()
        return pool.submit(call, task).result(timeout=time_limit)

    def _started(self) -> ProcessPoolExecutor:
        deaths = 0
        while self._pool is None and not self._over:
            pool = ProcessPoolExecutor(1, multiprocessing.get_context("spawn"))
            _leave_interrupts_to_the_main_thread()
            try:
                self._id = pool.submit(_begin, self._start).result()
                self._pool = pool
            except BrokenExecutor:
                pool.shutdown(wait=False)
                deaths += 1
            if deaths == _STARTS:
                raise DvrkCmaesError(
                    f"worker processes died {_STARTS} times at their start: out of memory? Try fewer workers; "
                    "what is done is kept, and the same command goes on from there"
                )
        if self._pool is None or self._over:
            raise BrokenExecutor("nothing more is to be begun")
        return self._pool

    def close(self, *, wait: bool = False) -> None:
        """Let the process end once it has nothing to do."""
        if self._pool is not None:
            self._pool.shutdown(wait=wait, cancel_futures=True)
        self._pool = None

    def kill(self) -> None:
        """End the process whatever it is doing."""
        for one in multiprocessing.active_children():
            if one.pid == self._id:
                one.kill()
        self.close()

    def end(self) -> None:
        """End the process for good."""
        self._over = True
        self.kill()


def _leave_interrupts_to_the_main_thread() -> None:
    """Block Ctrl-C in this thread: the processes it starts inherit that, and finish what they are doing."""
    if hasattr(signal, "pthread_sigmask"):
        signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})


def _begin(start: Callable[[], object]) -> int:
    """Prepare a fresh process, and see to it that it ends with the one that started it, however that ends."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        threading.Thread(target=_end_after, args=(parent,), daemon=True).start()
    start()
    return os.getpid()


def _end_after(parent: multiprocessing.process.BaseProcess) -> None:
    parent.join()
    os._exit(1)
