"""Lines for the user about faults that may be repeated with every message: each is said once while it goes on."""

from __future__ import annotations

import re
import time as clock
from dataclasses import dataclass
from threading import Lock
from typing import Final

from dvrk_cmaes.live.connection import Report

_QUIET: Final = 10.0  # s without a fault, after which the next one of its kind is a new one
_OFTEN: Final = 60.0  # s after which a fault that goes on is said again
_MOST_KINDS: Final = 500


@dataclass
class _Kind:
    said: float
    heard: float
    untold: int = 0


class RepeatedLines:
    """Hands lines on, but of lines that differ only in numbers one, and after a minute one more with their number.

    May be called from several threads. A line that cannot be written, as on a full disk, is lost without an error.
    """

    def __init__(self, report: Report) -> None:
        self._report = report
        self._kinds: dict[str, _Kind] = {}
        self._lock = Lock()

    def __call__(self, line: str) -> None:
        """Take a line."""
        with self._lock:
            said = self._said(line, clock.monotonic())
        if said is not None:
            try:
                self._report(said)
            except OSError:
                return

    def _said(self, line: str, now: float) -> str | None:
        """Return what is said of a line; None if nothing is."""
        name = re.sub(r"-?\d+(?:\.\d+)?", "#", line)
        kind = self._kinds.get(name)
        if kind is None or now - kind.heard > _QUIET:
            self._kinds.pop(name, None)
            self._kinds[name] = _Kind(now, now)
            if len(self._kinds) > _MOST_KINDS:
                del self._kinds[next(iter(self._kinds))]
            return line
        kind.heard = now
        if now - kind.said <= _OFTEN:
            kind.untold += 1
            return None
        untold, kind.untold, kind.said = kind.untold, 0, now
        return f"{line} (and {untold} like it)" if untold else line
