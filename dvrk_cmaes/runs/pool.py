"""Many tasks in any `concurrent.futures.Executor`: worker processes of this machine, or those of a cluster.

A process that dies breaks the whole pool of this machine. Each task that was in flight is then tried alone in a new
pool, and the one on which that dies, too, is given up by name. This module imports little, so that processes can start
while the program that needs them is imported.
"""

from __future__ import annotations

import contextlib
import faulthandler
import functools
import multiprocessing
import os
import pickle
import signal
import sys
import threading
import warnings
from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence, Sized
from concurrent.futures import FIRST_COMPLETED, CancelledError, Executor, Future, ProcessPoolExecutor
from concurrent.futures import wait as wait_for
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, field
from multiprocessing import resource_tracker
from multiprocessing.process import BaseProcess
from types import FrameType
from typing import TYPE_CHECKING, Any, Final, TypeVar

import cv2
from threadpoolctl import threadpool_limits

from dvrk_cmaes.errors import DvrkCmaesError
from dvrk_cmaes.runs.live_session import prepare_long_run

if TYPE_CHECKING:
    from dvrk_cmaes.calibration.session_frame import Run
    from dvrk_cmaes.config import EstimateConfig
    from dvrk_cmaes.silhouette import Body

T = TypeVar("T")
R = TypeVar("R")
Notice = Callable[[str], None]
"""Takes a message about a whole run."""

_DIED: Final = "its process died twice: out of memory, or a crash in a native library"
_PAYS: Final = 4  # frames of a calibration from which on one process more is sooner done: its start takes about two
_MOST_SHARED: Final = 4  # values that a process keeps for its tasks
_STUCK: Final = 30.0  # s after its time limit, after which a process that is in native code is ended


@dataclass(frozen=True)
class WorkerDied:
    """Stands for the value of a task that was given up; ``reason`` says why."""

    reason: str


class StoppedError(Exception):
    """The run is to end."""


class TimeUpError(BaseException):
    """A task takes too long: no error that a task may handle."""


def usable_cores() -> int:
    """Count the cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


class Executors:
    """An executor of the caller, such as that of a cluster.

    Parameters
    ----------
    executor
        The executor, which stays open.
    at_once
        Returns how many tasks to submit at a time: at least as many as it has workers.
    gives_up
        Exceptions of a future whose worker has died so often that the executor gave the task up.
    """

    def __init__(
        self, executor: Executor, at_once: Callable[[], int], gives_up: tuple[type[BaseException], ...] = ()
    ) -> None:
        self._executor, self.at_once, self._gives_up = executor, at_once, gives_up

    def submit(self, call: Callable[..., R], *arguments: Any) -> Future[R]:
        """Submit a call, which must not raise; DvrkCmaesError if the executor cannot go on."""
        try:
            return self._executor.submit(call, *arguments)
        except (RuntimeError, OSError) as error:  # RuntimeError: shut down, or broken
            raise _lost(error) from error

    def value(self, future: Future[R]) -> R | WorkerDied:
        """Return the value of a call that has ended."""
        try:
            return future.result()
        except self._gives_up as error:
            return WorkerDied(
                f"its worker died, more than once: out of memory, or a crash in a native library ({error})"
            )
        except (Exception, CancelledError) as error:  # the call does not raise: the error lies in the transport
            raise _lost(error) from error


class Pool(Executors):
    """Worker processes of this machine, as a context manager at whose end they have ended.

    Parameters
    ----------
    start
        Small picklable function that is called first in each process and does not raise; the process that starts
        another one waits until that has read it.
    count
        Number of processes, each of which is started when there is a task for it.
    here
        Whether this process does tasks as well as the others, with one thread in its libraries meanwhile.
    """

    def __init__(self, start: Callable[[], object], count: int, *, here: bool = False) -> None:
        self.start, self.count, self.here = start, count, here
        self.at_once = lambda: 2 * count if here else count  # one waits while this process is at a task
        self._pool: ProcessPoolExecutor | None = None
        self._lock = threading.Lock()

    def __enter__(self) -> Pool:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        if kind is not None:
            self.kill()
        if self._pool is not None:
            self._pool.shutdown()  # which waits until the processes have ended after their calls

    def begin(self) -> Pool:
        """Start the processes before there are tasks for them, and do not wait until they are ready."""
        for _ in range(self.count):
            self.submit(int)
        return self

    def submit(self, call: Callable[..., R], *arguments: Any) -> Future[R]:
        """Submit a call; the future of a pool that a death has just broken has ended with its error."""
        with self._lock, _interrupts_blocked():
            if self._pool is None:
                spawn = multiprocessing.get_context("spawn")
                self._pool = ProcessPoolExecutor(self.count, spawn, _begin, (self.start,))
            try:
                return self._pool.submit(call, *arguments)
            except BrokenProcessPool as error:
                broken = Future[R]()
                broken.set_exception(error)
                return broken

    def value(self, future: Future[R]) -> R:
        """Return the value of a call that has ended; raises what the call raised."""
        return future.result()

    def renew(self) -> None:
        """Start the processes again; DvrkCmaesError if they die at once."""
        self.kill()
        try:
            self.submit(int).result()
        except BrokenProcessPool:
            raise DvrkCmaesError(
                "worker processes die at their start: out of memory? Try fewer workers; what is done is kept, and the "
                "same command goes on from there"
            ) from None

    def kill(self) -> None:
        """Kill the processes; new ones are started for later calls."""
        with self._lock:
            pool, self._pool = self._pool, None
        if pool is not None:
            for process in list((pool._processes or {}).values()):
                process.kill()
            pool.shutdown(cancel_futures=True)

    def values(self, call: Callable[[T], R], tasks: Sequence[T], by: Workers | None = None) -> list[R]:
        """Return the values of a picklable function in the order of the tasks; DvrkCmaesError if a process died.

        What is done is reported ``by``; once its ``stop`` is set, running tasks are finished and `StoppedError` is
        raised.
        """
        found, by = dict[int, R](), by or Workers()
        for (k, _), value in run(self, enumerate(tasks), functools.partial(_numbered, call), stop=by.stop):
            if isinstance(value, WorkerDied):
                raise DvrkCmaesError(f"frame {k + 1} of {len(tasks)}: {value.reason}: try fewer --workers")
            found[k] = value
            by.report(len(found), len(tasks))
        if len(found) < len(tasks):
            raise StoppedError
        return [found[k] for k in range(len(tasks))]


TIME_LIMIT = 600.0
"""Seconds after which a frame is given up in a worker process."""


@dataclass(frozen=True, eq=False)
class Workers:
    """What a run is done by, and who hears of it: ``count`` processes, or the ``executor``, which may be open ones.

    By default there are as many processes as the cores allow. A frame is given up after ``time_limit`` s in a process.
    Once ``stop`` is set, running frames are finished and no more are started. ``report`` is called at the start and as
    frames are done, whose files are written, with the numbers of frames done and to do, and more in words. ``notice``
    is called with messages about the whole run.
    """

    count: int | None = None
    executor: Executor | Executors | None = None
    time_limit: float = TIME_LIMIT
    stop: threading.Event = field(default_factory=threading.Event)
    report: Callable[..., None] = lambda done, todo, more="": None
    notice: Notice = lambda text: None

    def stage(self, name: str, frames: int) -> None:
        """Say that a stage of the run begins, of some frames."""
        self.notice(f"{name}: {frames} frames")


def run(
    workers: Executors,
    tasks: Iterable[T],
    call: Callable[[T], R],
    *,
    time_limit: float | None = None,
    stop: threading.Event | None = None,
) -> Generator[tuple[T, R | WorkerDied], None, None]:
    """Run tasks, and yield each with its value in the order of completion.

    If the iterator is closed early, the processes of a pool are killed.

    Parameters
    ----------
    workers
        What runs the tasks.
    tasks
        Arguments of ``call``, one each.
    call
        Picklable function.
    time_limit
        Seconds after which a process of a pool gives a task up.
    stop
        Once this event is set, running tasks are finished and no more are started.

    Raises
    ------
    DvrkCmaesError
        Processes cannot be started, or a cluster was lost.
    Exception
        What ``call`` raised.
    """
    source, stop = iter(tasks), stop or threading.Event()
    pool = workers if isinstance(workers, Pool) else None
    limit = () if time_limit is None or pool is None else (limited, time_limit)
    running: dict[Future[Any], T] = {}
    alone: deque[T] = deque()  # those that were in flight when a process died
    here, limits = pool is not None and pool.here, contextlib.ExitStack()
    try:
        if pool is not None and here:
            limits.callback(cv2.setNumThreads, cv2.getNumThreads())
            cv2.setNumThreads(1)
            limits.enter_context(threadpool_limits(1))
            pool.start()
        while True:
            while not stop.is_set() and (not running if alone else len(running) < workers.at_once()):
                task = alone[0] if alone else next(source, None)
                if task is None:
                    break
                running[workers.submit(*limit, call, task)] = task
            own = next(source, None) if here and not alone and not stop.is_set() else None
            if own is not None:
                yield own, call(own)
            elif not running:
                return
            ended = wait_for(running, None if own is None else 0, FIRST_COMPLETED).done
            if any(map(_has_died, ended)):
                ended = wait_for(running).done
            died = [running.pop(future) for future in ended if _has_died(future)]
            for future in ended:
                if future in running:
                    if alone:
                        alone.popleft()
                    yield running.pop(future), workers.value(future)
            if died and pool is not None:
                pool.renew()
            if died and alone:
                yield alone.popleft(), WorkerDied(_DIED)
            else:
                alone.extend(died)
    finally:
        if running and pool is not None:
            pool.kill()
        for future in running:
            future.cancel()
        limits.close()


def _has_died(future: Future[Any]) -> bool:
    """Whether the pool of a call was broken, which has ended."""
    return not future.cancelled() and isinstance(future.exception(), BrokenProcessPool)


def _lost(error: BaseException) -> DvrkCmaesError:
    said = " ".join(str(error).split()) or type(error).__name__
    return DvrkCmaesError(
        f"the workers were lost ({said}): what is done is kept, and the same command goes on from there"
    )


def _numbered(call: Callable[[T], R], task: tuple[int, T]) -> R:
    return call(task[1])


def limited(seconds: float, call: Callable[[T], R], task: T) -> R | WorkerDied:
    """Call a function in a process of a pool, and give it up after some seconds.

    Native code that does not come back is ended with its process somewhat later.
    """

    def stop(_signal: int, _frame: FrameType | None) -> None:
        raise TimeUpError

    with open(os.devnull, "wb") as nowhere:
        faulthandler.dump_traceback_later(seconds + _STUCK, exit=True, file=nowhere)
        signal.signal(signal.SIGALRM, stop)
        try:
            try:
                signal.setitimer(signal.ITIMER_REAL, seconds)
                return call(task)
            finally:
                signal.setitimer(signal.ITIMER_REAL, 0)
        except TimeUpError:
            return WorkerDied(f"no result after {seconds:g} s: it was stopped")
        finally:
            faulthandler.cancel_dump_traceback_later()


@contextlib.contextmanager
def _interrupts_blocked() -> Iterator[None]:
    """Block SIGINT in this thread; a process that is started meanwhile inherits that, and so does not see Ctrl-C."""
    resource_tracker.ensure_running()  # which would otherwise be started with the process, and unblocks SIGINT
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _begin(start: Callable[[], object]) -> None:
    """Prepare a worker process, which ends when the one that started it does."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if not sys.warnoptions:
        warnings.simplefilter("ignore")
    limit_library_threads()
    parent = multiprocessing.parent_process()
    if parent is not None:
        threading.Thread(target=_exit_after, args=(parent,), daemon=True).start()
    start()
    prepare_long_run()


def _exit_after(parent: BaseProcess) -> None:
    parent.join()
    os._exit(1)


def packed(value: Any) -> bytes:
    """Pickle what many tasks share, which each process unpickles once by `unpacked`."""
    return pickle.dumps(value, protocol=pickle.HIGHEST_PROTOCOL)


@functools.lru_cache(maxsize=_MOST_SHARED)
def unpacked(data: bytes) -> Any:
    """Return what was pickled by `packed`."""
    return pickle.loads(data)


@functools.cache
def limit_library_threads() -> threadpool_limits:
    """Limit OpenCV and the BLAS libraries of this process to one thread each; the cores are used by processes."""
    cv2.setNumThreads(1)
    return threadpool_limits(1)


def pool_of(workers: int, frames: Sized | None = None) -> Pool:
    """Return processes for frames: of those that are given, this one and as many others as they pay."""
    if frames is None:
        return Pool(_prepare, workers)
    return Pool(_prepare, further_processes(workers, len(frames)), here=True)


def further_processes(workers: int, frames: int) -> int:
    """Return the number of processes besides this one with which a calibration is soonest done."""
    return min(workers - 1, frames // _PAYS)


def run_in(pool: Pool, body: Body, config: EstimateConfig, by: Workers) -> Run[Any, Any]:
    """Return what applies a function of body, settings and task to tasks; reports and errors as of `Pool.values`."""
    shared = packed(body)
    return lambda function, tasks: pool.values(functools.partial(_with_body, shared, config, function), tasks, by)


def _prepare() -> None:
    """Import what the tasks of a process need."""
    import dvrk_cmaes.runs.calibration_pictures  # noqa: F401


def _with_body(
    body: bytes, config: EstimateConfig, function: Callable[[Body, EstimateConfig, Any], Any], task: Any
) -> Any:
    from dvrk_cmaes.silhouette.prepare import body_by

    return function(body_by(unpacked(body), config.silhouette.method), config, task)
