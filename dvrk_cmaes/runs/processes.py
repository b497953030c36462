"""Running many tasks in worker processes of this machine; a process that dies fails one task only.

Each process is driven by a thread of its own. Where tasks turn out to be short, several are sent to it together, since
a process waits between its answer and what it is sent next. If it dies on them, or takes as long as one task may, they
are sent again one by one, so that the task on which it dies is known. That task is tried once more in a new process,
since the cause may have been a temporary lack of memory, and then given up.
"""

from __future__ import annotations

import contextlib
import functools
import itertools
import math
import os
import queue
import threading
import time
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from types import TracebackType
from typing import Any, Generic, TypeVar

from dvrk_cmaes.errors import DvrkCmaesError
from dvrk_cmaes.runs.worker_process import CallTimeoutError, ProcessDiedError, WorkerProcess, single_library_threads

T = TypeVar("T")
R = TypeVar("R")
A = TypeVar("A")
B = TypeVar("B")

_TRIES = 2  # of a task that its process dies on
_TOGETHER_S = 0.05  # time that tasks which are sent together take, at most
_MOST_TOGETHER = 32
_SHARE = 0.2  # of the last tasks in the mean time of one
_STARTS = 3  # of a process that dies at its start, after which the run fails


@dataclass(frozen=True)
class WorkerDied:
    """Stands for the value of a task that was given up; ``reason`` says why."""

    reason: str


def usable_cores() -> int:
    """Count the cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


class Processes:
    """Worker processes, as a context manager at whose end they have ended.

    Parameters
    ----------
    start
        Picklable function that is called first in each process and does not raise.
    workers
        Number of processes. Each is started when there is a task for it.
    here
        Whether this process does tasks as well, beside the workers, with one thread in its libraries. It has no time
        limit, and a task on which it dies ends the program.
    """

    def __init__(self, start: Callable[[], object], workers: int, *, here: bool = False) -> None:
        self._processes = [WorkerConnection(start) for _ in range(workers)]
        self._start_here: Callable[[], object] | None = start if here else None

    def __enter__(self) -> Processes:
        return self

    def begin(self) -> None:
        """Start the worker processes before there are tasks for them, and do not wait until they are ready."""
        for process in self._processes:
            process.begin()

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for process in self._processes:
            if kind is not None or process.is_beginning:
                process.end()
        for process in self._processes:
            process.close()

    def run(
        self,
        tasks: Iterable[T],
        call: Callable[[T], R],
        *,
        time_limit: float | None = None,
        stop: threading.Event | None = None,
    ) -> Generator[tuple[T, R | WorkerDied], None, None]:
        """Run tasks, and yield each with its value in the order of completion.

        If the iterator is closed early, the processes are killed, and run no more tasks.

        Parameters
        ----------
        tasks
            Arguments of ``call``, one each.
        call
            Picklable function.
        time_limit
            Seconds after which a task is given up and its process killed.
        stop
            Once this event is set, running tasks are finished and no more are started.

        Raises
        ------
        DvrkCmaesError
            Processes cannot be started.
        Exception
            What ``call`` raised.
        """
        run = _SharedTasks(iter(tasks), call, time_limit, stop or threading.Event())
        threads = [threading.Thread(target=run.drive, args=(process,), daemon=True) for process in self._processes]
        for thread in threads:
            thread.start()
        busy = len(threads)
        try:
            if self._start_here is not None:
                yield from self._run_here(run, self._start_here)
            while busy:
                match run.done.get():
                    case None:
                        busy -= 1
                    case Exception() as error:
                        raise error
                    case outcome:
                        yield outcome
        finally:
            run.closed = True
            if busy:
                for process in self._processes:
                    process.end()
            for thread in threads:
                thread.join()

    @staticmethod
    def _run_here(run: _SharedTasks[T, R], start: Callable[[], object]) -> Iterator[tuple[T, R]]:
        """Do tasks in this thread, until there are none or a worker has failed."""
        with single_library_threads():
            start()
            for (task,) in run.several(1):
                yield task, run.call(task)


def _each(call: Callable[[T], R], tasks: Sequence[T]) -> list[R]:
    """Do some tasks, in the process that this is called in."""
    return [call(task) for task in tasks]


@dataclass(eq=False)
class _SharedTasks(Generic[T, R]):
    """Tasks that several threads share, each of which drives a process; there are no more once it is stopped or closed.

    ``done`` gets each task with its value, and from each thread None at its end, or what went wrong.
    """

    tasks: Iterator[T]
    call: Callable[[T], R]
    time_limit: float | None
    stop: threading.Event
    closed: bool = False
    done: queue.SimpleQueue[tuple[T, R | WorkerDied] | Exception | None] = field(default_factory=queue.SimpleQueue)
    _lock: threading.Lock = field(default_factory=threading.Lock)
    _seconds: float = math.inf  # of a task; until that is known, they are sent one by one

    @property
    def ended(self) -> bool:
        return self.closed or self.stop.is_set()

    def several(self, most: int) -> Iterator[list[T]]:
        """Iterate over groups of tasks that take `_TOGETHER_S` together, at most ``most`` of them."""
        while not self.ended:
            count = max(int(_TOGETHER_S / max(self._seconds, 1e-9)), 1)
            with self._lock:
                tasks = list(itertools.islice(self.tasks, min(count, most)))
            if not tasks:
                return
            yield tasks

    def drive(self, process: WorkerConnection) -> None:
        """Do tasks in one process, as long as there are some."""
        try:
            with contextlib.suppress(ProcessDiedError):  # that of the task that a stopped run leaves
                for tasks in self.several(_MOST_TOGETHER):
                    for done in self._done(process, tasks):
                        self.done.put(done)
            self.done.put(None)
        except Exception as error:
            self.closed = True
            self.done.put(error)

    def _done(self, process: WorkerConnection, tasks: Sequence[T]) -> Iterator[tuple[T, R | WorkerDied]]:
        """Run tasks together, or one by one where there is only one or that fails; yield each with its value."""
        if len(tasks) > 1:
            started = time.monotonic()
            values = self._tried(process, functools.partial(_each, self.call), tasks, tries=1)
            if not isinstance(values, WorkerDied):
                self._took(time.monotonic() - started, len(tasks))
                yield from zip(tasks, values, strict=True)
                return
        for task in tasks:
            started = time.monotonic()
            value = self._tried(process, self.call, task)
            self._took(time.monotonic() - started, 1)
            yield task, value

    def _took(self, seconds: float, tasks: int) -> None:
        """Note how long some tasks took; a longer time counts at once."""
        each = seconds / tasks
        before = self._seconds if math.isfinite(self._seconds) else each
        self._seconds = max(each, before + _SHARE * (each - before))

    def _tried(self, process: WorkerConnection, call: Callable[[A], B], task: A, tries: int = _TRIES) -> B | WorkerDied:
        """Run a task, ``tries`` times if its process dies; ProcessDiedError if the run has been stopped by then."""
        for _ in range(tries):
            try:
                return process.run(call, task, time_limit=self.time_limit)
            except CallTimeoutError:
                process.kill()
                process.close()
                return WorkerDied(f"no result after {self.time_limit:g} s: its process was ended")
            except ProcessDiedError:
                process.close()
                if self.ended:
                    raise
        return WorkerDied(f"its process died {tries} times: out of memory, or a crash in a native library")


class WorkerConnection:
    """A worker process that is started when it is needed, and again after it has died."""

    def __init__(self, start: Callable[[], object]) -> None:
        self._start = start
        self._process: WorkerProcess | None = None
        self._over = False
        self._lock = threading.Lock()  # of both fields: `end` is called while another thread runs a task
        self._beginning: threading.Thread | None = None

    def begin(self) -> None:
        """Start the process in a thread; what fails there is tried again, and raised, by `run`."""
        self._beginning = threading.Thread(target=self._begin, daemon=True)
        self._beginning.start()

    def _begin(self) -> None:
        with contextlib.suppress(Exception):
            self._started()

    @property
    def is_beginning(self) -> bool:
        """Whether the process is being started by `begin`."""
        return self._beginning is not None and self._beginning.is_alive()

    def run(self, call: Callable[..., R], *arguments: Any, time_limit: float | None = None) -> R:
        """Call a function there; ProcessDiedError if the process died on it, CallTimeoutError if it takes too long."""
        if self._beginning is not None:
            self._beginning.join()
        process = self._process or self._started()
        return process.call(call, *arguments, time_limit=time_limit)

    def _started(self) -> WorkerProcess:
        for _ in range(_STARTS):
            with self._lock:
                if self._over:
                    break
                self._process = process = WorkerProcess()
            try:
                process.call(self._start)
                return process
            except (ProcessDiedError, MemoryError):
                self.close()
        else:
            raise DvrkCmaesError(
                f"worker processes died {_STARTS} times at their start: out of memory? Try fewer workers; "
                "what is done is kept, and the same command goes on from there"
            )
        raise ProcessDiedError

    def close(self) -> None:
        """Let the process end after its current task, and wait until it has, also where `begin` is ending it."""
        with self._lock:
            process, self._process = self._process, None
        if process is not None:
            process.close()
        if self._beginning is not None and self._beginning is not threading.current_thread():
            self._beginning.join()

    def kill(self) -> None:
        """Kill the process."""
        with self._lock:
            if self._process is not None:
                self._process.kill()

    def end(self) -> None:
        """Kill the process, and do not start it again."""
        self._over = True
        self.kill()
