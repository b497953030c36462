"""One worker process: it calls functions that are sent to it over a pipe, one at a time.

A pipe for each process needs no locks, so there is nothing of the operating system's, such as named semaphores, that a
process which is killed could leave behind. A process ends when the process that started it does.
"""

from __future__ import annotations

import contextlib
import functools
import multiprocessing
import os
import signal
import sys
import threading
import traceback
import warnings
from collections.abc import Callable, Iterator
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection
from typing import Any, TypeVar, cast

import cv2
from threadpoolctl import threadpool_limits

from dvrk_cmaes.errors import DvrkCmaesError, one_line
from dvrk_cmaes.runs.live_session import prepare_long_run

R = TypeVar("R")


class ProcessDiedError(Exception):
    """A worker process ended before it had answered."""


class CallTimeoutError(Exception):
    """A worker process has not answered in time."""


class WorkerProcess:
    """A spawned process; its libraries use one thread, and it is not interrupted by Ctrl-C.

    One ``for_long`` follows an instrument for hours: it is prepared for that, may have processes of its own, and is to
    be killed before this one ends.
    """

    def __init__(self, *, for_long: bool = False) -> None:
        spawn = multiprocessing.get_context("spawn")
        self._connection, theirs = spawn.Pipe()
        self._process = spawn.Process(target=_serve, args=(theirs, for_long), daemon=not for_long)
        with theirs, _interrupts_blocked():
            self._process.start()

    def call(self, function: Callable[..., R], *arguments: Any, time_limit: float | None = None) -> R:
        """Return the value of a picklable function in the process.

        Parameters
        ----------
        function, arguments
            The function and its arguments.
        time_limit
            Seconds to wait for the value, without limit if None.

        Raises
        ------
        ProcessDiedError
            The process has ended.
        CallTimeoutError
            There is no value yet; the process is still at work and cannot be called again.
        Exception
            What the function raised.
        """
        try:
            self._connection.send((function, arguments))
            if not self._connection.poll(time_limit):
                raise CallTimeoutError
            answer: tuple[Any, Exception | None] = self._connection.recv()
        except (EOFError, OSError):
            raise ProcessDiedError from None
        value, error = answer
        if error is not None:
            raise error
        return cast(R, value)

    def kill(self) -> None:
        """Kill the process; a call that waits for it in another thread raises ProcessDiedError."""
        self._process.kill()

    def close(self) -> None:
        """Let the process end, and wait until it has."""
        self._connection.close()
        self._process.join()


@contextlib.contextmanager
def _interrupts_blocked() -> Iterator[None]:
    """Block SIGINT in this thread; a process that is started meanwhile inherits that, and so does not see Ctrl-C."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    resource_tracker.ensure_running()  # which would otherwise be started with the process, and unblocks SIGINT
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _serve(connection: Connection, for_long: bool) -> None:
    """Answer calls with (value, None) or (None, exception) until the other end of the pipe is closed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if not sys.warnoptions:
        warnings.simplefilter("ignore")
    limit_library_threads()
    if for_long:
        prepare_long_run()
    parent = multiprocessing.parent_process()
    if parent is not None:
        threading.Thread(target=_exit_after, args=(parent,), daemon=True).start()
    with contextlib.suppress(EOFError, OSError):
        while True:
            function, arguments = connection.recv()
            answer = _answer(function, arguments)
            try:
                connection.send(answer)
            except (AttributeError, TypeError, ValueError) as error:  # it cannot be pickled
                connection.send((None, DvrkCmaesError(f"{answer[1] or 'value'} cannot be sent: {one_line(error)}")))


def _answer(function: Callable[..., Any], arguments: tuple[Any, ...]) -> tuple[Any, Exception | None]:
    try:
        return function(*arguments), None
    except Exception as error:
        error.add_note(f"In a worker process:\n{traceback.format_exc()}")
        return None, error


def _exit_after(parent: multiprocessing.process.BaseProcess) -> None:
    parent.join()
    os._exit(1)


@functools.cache
def limit_library_threads() -> threadpool_limits:
    """Limit OpenCV and the BLAS libraries of this process to one thread each; the cores are used by processes."""
    cv2.setNumThreads(1)
    return threadpool_limits(1)


@contextlib.contextmanager
def single_library_threads() -> Iterator[None]:
    """Limit OpenCV and the BLAS libraries of this process to one thread each meanwhile."""
    before = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        with threadpool_limits(1):
            yield
    finally:
        cv2.setNumThreads(before)
