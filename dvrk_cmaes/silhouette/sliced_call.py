"""A long call whose work is done in slices, between which its caller does something else.

The call runs in a thread of its own, but never at the same time as its caller: either waits for the other. A slice is
measured by what is drawn in it, not by the clock, so that the same calls end after the same slices.
"""

from __future__ import annotations

import threading
import weakref
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Final, Generic, TypeVar, cast

R = TypeVar("R")

SEGMENTING: Final = "segmenting"
"""Name of the work that finds a mask in an image."""

_local = threading.local()
_OF_A_DRAWING = 100
"""Pixel rows that take as long as what a drawing takes beside its rows."""


@dataclass
class Work:
    """Drawings, and the pixel rows of silhouettes that take as long as these and what else was counted."""

    drawings: int = 0
    rows: int = 0


_counted: list[Work] = []


@contextmanager
def counted_work() -> Iterator[Work]:
    """Count what is drawn in all threads meanwhile, whether in a `SlicedCall` or not."""
    work = Work()
    _counted.append(work)
    try:
        yield work
    finally:
        _counted.remove(work)


def worked(rows: int, *, drawn: bool = True) -> None:
    """Count a drawing of some pixel rows of silhouettes; in a `SlicedCall` whose slice is done, wait for the next.

    If nothing was ``drawn``, they are rows that take as long as the work that was done.
    """
    taken = rows + _OF_A_DRAWING if drawn else rows
    for work in _counted:
        work.drawings += drawn
        work.rows += taken
    call: _Call | None = getattr(_local, "call", None)
    if call is not None:
        call.worked(taken)


def stage(name: str) -> None:
    """Begin a piece of work that draws nothing; in a `SlicedCall`, wait for the next slice first."""
    call: _Call | None = getattr(_local, "call", None)
    if call is not None:
        call.begin(name)


class SlicedCall(Generic[R]):
    """A call that is done in slices; it is given up when this object is deleted.

    Parameters
    ----------
    function
        What is called. It must draw in the thread that calls it.
    """

    def __init__(self, function: Callable[[], R]) -> None:
        self._call = _Call(function)
        self._give_up = weakref.finalize(self, self._call.give_up)

    def advance(self, work: float) -> bool:
        """Go on until ``work`` pixel rows are drawn, or the call has ended; returns whether it has."""
        self._call.advance(work)
        return self._call.ended

    @property
    def left(self) -> float:
        """Pixel rows of the last slice that were not drawn, because the call has ended; negative if it drew more."""
        return self._call.left

    @property
    def stage(self) -> str:
        """Name of the piece of work that is being done or is next; empty while it draws."""
        return self._call.stage

    def value(self) -> R:
        """Return the value of the call, which has ended, or raise what it raised."""
        if self._call.error is not None:
            raise self._call.error
        return cast(R, self._call.value)


class _GivenUpError(BaseException):
    """The call is not wanted any more."""


class _Call:
    """State of a call, which its thread and its caller share."""

    def __init__(self, function: Callable[[], object]) -> None:
        self.ended, self.value, self.error = False, cast(object, None), cast(BaseException | None, None)
        self.stage = ""
        self._function = function
        self.left, self._given_up = 0.0, False
        self._go, self._back = threading.Semaphore(0), threading.Semaphore(0)
        self._thread: threading.Thread | None = None

    def advance(self, work: float) -> None:
        if self.ended:
            return
        self.left = work
        if self._thread is None:
            self._thread = threading.Thread(target=self._run, daemon=True)
            self._thread.start()
        else:
            self._go.release()
        self._back.acquire()

    def give_up(self) -> None:
        if self._thread is not None and not self.ended:
            self._given_up = True
            self._go.release()

    def begin(self, name: str) -> None:
        self.stage = name
        self._spend(self.left)

    def worked(self, rows: int) -> None:
        self.stage = ""
        self._spend(rows)

    def _spend(self, rows: float) -> None:
        self.left -= rows
        if self.left <= 0:
            self._back.release()
            self._go.acquire()
            if self._given_up:
                raise _GivenUpError

    def _run(self) -> None:
        _local.call = self
        try:
            self.value = self._function()
        except _GivenUpError:
            return
        except BaseException as error:
            self.error = error
        self.ended = True
        self._back.release()
