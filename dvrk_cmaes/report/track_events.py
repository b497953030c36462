"""Stretches of a followed recording in which the instrument was lost or its pose doubtful, and changes of the mode."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby
from typing import Any, Final

STATUSES: Final = ("ok", "doubtful", "lost", "gone")
"""Statuses of followed frames, the best first."""

SWITCHED: Final = "switched"
DOUBTFUL: Final = "doubtful"
_REASON_OF_SWITCH: Final = "switched to "


@dataclass(frozen=True)
class TrackEvent:
    """A stretch of doubtful poses or without a supported pose, or a change of the mode.

    kind : the status of its first frame, or ``switched``. first : index of its first frame. back : index of the frame
    at which the stretch is over, None if it is not; the same as ``first`` for a change of the mode.
    frames : number of frames of the stretch. reason : of the first frame.
    """

    kind: str
    first: int
    back: int | None
    frames: int
    reason: str


def track_events(rows: Sequence[Mapping[str, Any]]) -> list[TrackEvent]:
    """List what happened in a recording, given by its lines of tracks.jsonl, in the order of the frames."""
    found: list[TrackEvent] = []
    for kind, stretch in groupby(range(len(rows)), lambda k: _kind(rows[k]["status"])):
        numbers = list(stretch)
        switches = {} if kind == "lost" else {k: text for k in numbers if (text := _switch(rows[k]["reasons"]))}
        if kind != "ok" and len(switches) < len(numbers):
            first, back = numbers[0], numbers[-1] + 1
            reason = next(iter(rows[first]["reasons"]), "")
            status = rows[first]["status"]
            found.append(TrackEvent(status, first, back if back < len(rows) else None, len(numbers), reason))
        found += [TrackEvent(SWITCHED, k, k, 1, text) for k, text in switches.items()]
    return found


def _kind(status: str) -> str:
    """Return the status of which a stretch is: a lost instrument may be gone in some of its frames."""
    return status if status in ("ok", DOUBTFUL) else "lost"


def _switch(reasons: Sequence[str]) -> str:
    """Return the reason that says that the mode was switched; an empty text without one."""
    return next((reason for reason in reasons if reason.startswith(_REASON_OF_SWITCH)), "")
