"""Hand-over of messages between threads: of images the newest only, of readings a bounded number."""

from __future__ import annotations

from collections import deque
from threading import Condition
from typing import Generic, TypeVar

T = TypeVar("T")


class Mailbox(Generic[T]):
    """Keeps the last ``most`` values that were put in and not taken yet; older ones are dropped."""

    def __init__(self, most: int = 1) -> None:
        self._values: deque[T] = deque(maxlen=most)
        self._changed = Condition()

    def put(self, value: T) -> None:
        """Add a value; never blocks."""
        with self._changed:
            self._values.append(value)
            self._changed.notify()

    def take(self, timeout: float) -> T | None:
        """Take the newest value and drop the others; None if there is none within ``timeout``, s."""
        with self._changed:
            if not self._changed.wait_for(lambda: self._values, timeout):
                return None
            newest = self._values[-1]
            self._values.clear()
            return newest

    def take_all(self) -> list[T]:
        """Take all values, the oldest first."""
        with self._changed:
            values = list(self._values)
            self._values.clear()
            return values
