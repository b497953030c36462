"""Worker processes on this machine, and running many tasks in them; a process that dies fails one task only.

Each process is driven by a thread of its own, so that the task on which a process dies is known. That task is tried
once more in a new process, since the cause may have been a temporary lack of memory, and then given up.
"""

from __future__ import annotations

import contextlib
import functools
import multiprocessing
import os
import queue
import signal
import threading
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import BrokenExecutor, ProcessPoolExecutor
from dataclasses import dataclass
from typing import Generic, TypeVar

import cv2
from threadpoolctl import threadpool_limits

from dvrk_cmaes.errors import DvrkCmaesError

T = TypeVar("T")
R = TypeVar("R")

_TRIES = 2  # of a task that its process dies on
_STARTS = 3  # of a process that dies at its start, after which the run fails


@dataclass(frozen=True)
class WorkerDied:
    """Stands for the value of a task that was given up; ``reason`` says why."""

    reason: str


def run_in_processes(
    tasks: Iterable[T],
    call: Callable[[T], R],
    *,
    start: Callable[[], object],
    workers: int,
    time_limit: float,
    stop: threading.Event,
) -> Iterator[tuple[T, R | WorkerDied]]:
    """Run tasks in worker processes, and yield each with its value in the order of completion.

    Parameters
    ----------
    tasks
        Arguments of ``call``, one each.
    call, start
        Picklable functions that do not raise. ``start`` is called first in each process.
    workers
        Number of processes.
    time_limit
        Seconds after which a task is given up and its process killed.
    stop
        Once this event is set, running tasks are finished and no more are started.

    Raises
    ------
    DvrkCmaesError
        Processes cannot be started.
    """
    source = _Source(tasks, stop)
    done: queue.SimpleQueue[tuple[T, R | WorkerDied] | Exception | None] = queue.SimpleQueue()
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
    """A task was not done because the run was stopped."""


class _Source(Generic[T]):
    """Iterator over tasks that several threads share; it ends early when the run is stopped or closed."""

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
    give: Callable[[tuple[T, R | WorkerDied] | Exception | None], None],
) -> None:
    """Run tasks one after the other in one process."""
    try:
        with contextlib.suppress(_NothingMoreError):
            for task in source:
                give((task, _tried(process, call, task, time_limit, source)))
        process.close(wait=True)
        give(None)
    except Exception as error:
        give(error)


def _tried(process: _Process, call: Callable[[T], R], task: T, time_limit: float, source: _Source[T]) -> R | WorkerDied:
    """Run a task, and again if its process dies, unless the run has been stopped by then."""
    for _ in range(_TRIES):
        try:
            return process.run(call, task, time_limit)
        except TimeoutError:
            process.kill()
            return WorkerDied(f"no result after {time_limit:g} s: its process was ended")
        except BrokenExecutor:
            process.close()
            if source.ended:
                raise _NothingMoreError from None
    return WorkerDied(f"its process died {_TRIES} times: out of memory, or a crash in a native library")


class _Process:
    """A worker process that is started when it is needed, and again after it has died."""

    def __init__(self, start: Callable[[], object]) -> None:
        self._start = start
        self._pool: ProcessPoolExecutor | None = None
        self._id: int | None = None
        self._over = False

    def run(self, call: Callable[[T], R], task: T, time_limit: float) -> R:
        """Run a task; raises BrokenExecutor if the process died on it, TimeoutError if it takes too long."""
        pool = self._started()
        return pool.submit(call, task).result(timeout=time_limit)

    def _started(self) -> ProcessPoolExecutor:
        deaths = 0
        while self._pool is None and not self._over:
            pool = spawn_pool(1, self._start)
            _leave_interrupts_to_the_main_thread()
            try:
                self._id = pool.submit(os.getpid).result()
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
        """Let the process end after its current task."""
        if self._pool is not None:
            self._pool.shutdown(wait=wait, cancel_futures=True)
        self._pool = None

    def kill(self) -> None:
        """Kill the process."""
        for one in multiprocessing.active_children():
            if one.pid == self._id:
                one.kill()
        self.close()

    def end(self) -> None:
        """Kill the process, and do not start it again."""
        self._over = True
        self.kill()


def _leave_interrupts_to_the_main_thread() -> None:
    """Block SIGINT in this thread; the processes it starts inherit that, and finish their task after Ctrl-C."""
    if hasattr(signal, "pthread_sigmask"):
        signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})


def spawn_pool(workers: int, start: Callable[[], object]) -> ProcessPoolExecutor:
    """Return a pool of spawned processes, in each of which `prepare_worker` and then ``start`` are called first."""
    return ProcessPoolExecutor(workers, multiprocessing.get_context("spawn"), _begin, (start,))


def _begin(start: Callable[[], object]) -> None:
    prepare_worker()
    start()


def prepare_worker() -> None:
    """Prepare a worker process: its libraries use one thread, and it exits when the process that started it does."""
    limit_library_threads()
    parent = multiprocessing.parent_process()
    if parent is not None:
        threading.Thread(target=_exit_after, args=(parent,), daemon=True).start()


@functools.cache
def limit_library_threads() -> threadpool_limits:
    """Limit OpenCV and the BLAS libraries of this process to one thread each; the cores are used by processes."""
    cv2.setNumThreads(1)
    return threadpool_limits(1)


def _exit_after(parent: multiprocessing.process.BaseProcess) -> None:
    parent.join()
    os._exit(1)
