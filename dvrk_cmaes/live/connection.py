"""What a connection to ROS offers, whatever carries the messages, and what is handed over between its threads."""

from __future__ import annotations

import re
import time as clock
from collections import deque
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from threading import Condition, Lock
from typing import Any, Final, Generic, TypeVar

Receive = Callable[[Mapping[str, Any]], None]
Report = Callable[[str], None]
"""Takes a line for the user."""

LARGEST_MESSAGE: Final = 2**20
"""Bytes of a message of readings or of a camera."""
LARGEST_IMAGE: Final = 40 * 2**20
"""Bytes of a message of an image: in base64, 10 megapixels of three bytes."""


def too_large(topic: str, size: int, largest: int) -> str:
    """Return the line for a message of more bytes than the largest that is read."""
    return f"{topic}: expected a message of at most {largest / 2**20:.0f} MB, got {size / 2**20:.1f} MB; it is left out"


@dataclass(eq=False)
class Connection:
    """A connection to ROS, and this class itself one within this process, whose ``receivers`` take what is sent.

    Messages are plain values with the field names of ROS 2, or on receipt those of ROS 1. Sequences of bytes are base64
    when published; on receipt they are bytes or base64. ``name`` says how ROS is reached, for messages, and ``ros1``
    whether what is received is of ROS 1.
    """

    name: str
    ros1: bool = field(default=False, kw_only=True)
    receivers: dict[str, Receive] = field(default_factory=dict)

    @property
    def connected(self) -> bool:
        """Whether there is a connection now."""
        return True

    def topics(self, timeout: float) -> Mapping[str, str] | None:
        """Return the types of all topics by name, which may take ``timeout`` s; None without a connection."""
        return dict.fromkeys(self.receivers, "")

    def open(self, timeout: float) -> bool:
        """Start to connect; returns whether there is a connection after ``timeout`` s. Attempts go on if not."""
        return True

    def close(self) -> None:
        """Close the connection."""

    def subscribe(
        self, topic: str, kind: str, receive: Receive, *, largest: int = LARGEST_MESSAGE, newest: bool = False
    ) -> None:
        """Call ``receive`` with the fields of each message, on another thread.

        A message of more than ``largest`` bytes is reported and dropped before it is read. ``newest`` allows to skip
        late ones.
        """
        self.receivers[topic] = receive

    def advertise(self, topic: str, kind: str) -> None:
        """Announce a topic before messages are published on it."""

    def publish(self, topic: str, fields: Mapping[str, Any]) -> bool:
        """Send a message without waiting; returns whether it was sent, which it is not while there is no connection."""
        return True


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


_OFTEN: Final = 60.0  # s after which a fault that goes on is said again
_MOST_KINDS: Final = 500


class LogThrottle:
    """Hands lines on, but of lines that differ only in numbers at most one a minute.

    May be called from several threads. A line that cannot be written, as on a full disk, is lost without an error.
    """

    def __init__(self, report: Report) -> None:
        self._report = report
        self._said: dict[str, float] = {}  # s, by what lines have in common
        self._lock = Lock()

    def __call__(self, line: str) -> None:
        """Take a line."""
        kind, now = re.sub(r"-?\d+(?:\.\d+)?", "#", line), clock.monotonic()
        with self._lock:
            if now - self._said.get(kind, -_OFTEN) < _OFTEN:
                return
            self._said.pop(kind, None)
            self._said[kind] = now
            if len(self._said) > _MOST_KINDS:
                del self._said[next(iter(self._said))]
        with suppress(OSError):
            self._report(line)
