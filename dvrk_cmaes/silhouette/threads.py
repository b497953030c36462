"""Threads: map a function over independent items, and keep BLAS from using more threads."""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from threading import Lock
from typing import TypeVar

from threadpoolctl import ThreadpoolController

A = TypeVar("A")
B = TypeVar("B")


class _BlasThreads:
    """Limits the BLAS libraries of the process to one thread while at least one caller needs it."""

    def __init__(self) -> None:
        self._libraries = ThreadpoolController()
        self._lock = Lock()
        self._callers = 0

    def limit(self) -> None:
        """Begin the limit, unless another caller has."""
        with self._lock:
            self._callers += 1
            if self._callers == 1:
                self._take_over()
                self._limit = self._libraries.limit(limits=1, user_api="blas")

    def release(self) -> None:
        """End the limit if no other caller needs it."""
        with self._lock:
            self._callers -= 1
            if not self._callers:
                self._take_over()
                self._limit.restore_original_limits()
                self._take_over()

    def _take_over(self) -> None:
        """Let any thread change the limits next: threadpoolctl, from 3.8 on, obeys only the first that has."""
        for library in self._libraries.lib_controllers:
            clear = getattr(library, "clear_controlling_thread", None)
            if clear is not None:
                clear(force=True)


_blas_threads = functools.cache(_BlasThreads)


@contextmanager
def single_blas_thread() -> Iterator[None]:
    """Keep BLAS to one thread meanwhile; also a decorator.

    The matrices of a pose are small: with more threads, a banded system of 800 equations takes a hundred times the
    processor time, which the threads spend waiting for each other.
    """
    threads = _blas_threads()
    threads.limit()
    try:
        yield
    finally:
        threads.release()


def map_threaded(function: Callable[[A], B], items: Sequence[A], threads: int) -> list[B]:
    """Apply a function to each item in up to ``threads`` threads; returns the values in the order of the items.

    Each item is one call of the function, so the values do not depend on the number of threads.
    """
    if threads <= 1 or len(items) <= 1:
        return [function(item) for item in items]
    with ThreadPoolExecutor(min(threads, len(items))) as pool:
        return list(pool.map(function, items))
