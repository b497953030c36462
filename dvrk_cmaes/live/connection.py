"""What a connection to ROS offers, whatever carries the messages."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, Protocol

Receive = Callable[[Mapping[str, Any]], None]
Report = Callable[[str], None]
"""Takes a line for the user."""


class Connection(Protocol):
    """A connection to ROS; messages are plain values with the field names of ROS 2, or on receipt those of ROS 1.

    Sequences of bytes are base64 when published; on receipt they are bytes or base64.
    """

    def open(self, timeout: float) -> bool:
        """Start to connect; returns whether there is a connection after ``timeout`` s. Attempts go on if not."""

    def close(self) -> None:
        """Close the connection."""

    def subscribe(self, topic: str, kind: str, receive: Receive, *, newest: bool = False) -> None:
        """Call ``receive`` with the fields of each message, on another thread; ``newest`` allows to skip late ones."""

    def advertise(self, topic: str, kind: str) -> None:
        """Announce a topic before messages are published on it."""

    def publish(self, topic: str, fields: Mapping[str, Any]) -> bool:
        """Send a message without waiting; returns whether it was sent, which it is not while there is no connection."""
