"""Processes that run for hours: no long pauses, steady memory."""

from __future__ import annotations

import contextlib
import ctypes
import gc
from typing import Final

_ARENA_MAX: Final = -8  # M_ARENA_MAX of glibc's mallopt


def prepare_long_run() -> None:
    """Leave what is there now out of later collections of garbage, and have all threads share one memory arena.

    From glibc, each new thread may otherwise get an arena of its own, which keeps the most that a search has needed in
    it. With another C library, only the collections change.
    """
    with contextlib.suppress(AttributeError, OSError, TypeError):
        ctypes.CDLL(None).mallopt(_ARENA_MAX, 1)
    gc.collect()
    gc.freeze()


def give_back_memory() -> None:
    """Return the memory that is free to the system, where the C library can, as glibc."""
    with contextlib.suppress(AttributeError, OSError, TypeError):
        ctypes.CDLL(None).malloc_trim(0)
