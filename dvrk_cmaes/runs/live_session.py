"""Following a running robot for hours: the calibration that it keeps in a folder, no long pauses, steady memory."""

from __future__ import annotations

import contextlib
import ctypes
import gc
from pathlib import Path
from typing import Final

from dvrk_cmaes.calibration.document import SessionCalibration
from dvrk_cmaes.io.atomic import write_json
from dvrk_cmaes.results.folder import SESSION


def save_calibration(out: Path, found: SessionCalibration) -> None:
    """Write a calibration in the place of the earlier one; errors as of `write_json`."""
    write_json(out / SESSION, found.to_dict())


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
