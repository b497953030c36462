"""What a connection to ROS offers, whatever carries the messages."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Final

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
    when published; on receipt they are bytes or base64. ``name`` tells how ROS is reached, for messages.
    """

    name: str
    receivers: dict[str, Receive] = field(default_factory=dict)

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
