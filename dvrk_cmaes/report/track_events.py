"""Stretches of a followed recording in which the instrument was lost or its pose doubtful, and changes of the mode."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
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
    number = 0
    while number < len(rows):
        row, first = rows[number], number
        switch = next((reason for reason in row["reasons"] if reason.startswith(_REASON_OF_SWITCH)), None)
        if switch is not None:
            found.append(TrackEvent(SWITCHED, first, first, 1, switch))
        kind = _kind(row["status"])
        while number < len(rows) and _kind(rows[number]["status"]) == kind:
            number += 1
            if kind == "ok":
                break
            if number < len(rows) and any(r.startswith(_REASON_OF_SWITCH) for r in rows[number]["reasons"]):
                break
        if kind != "ok" and switch is None:
            back = number if number < len(rows) else None
            found.append(TrackEvent(row["status"], first, back, number - first, _first_reason(row["reasons"])))
    return found


def _kind(status: str) -> str:
    """Return the status of which a stretch is: a lost instrument may be gone in some of its frames."""
    return status if status in ("ok", DOUBTFUL) else "lost"


def _first_reason(reasons: Sequence[str]) -> str:
    """Return the first of the reasons, or an empty text."""
    return reasons[0] if reasons else ""
