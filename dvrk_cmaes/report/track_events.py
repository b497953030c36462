"""Stretches of a followed recording in which the instrument was lost, and frames at which the mode changed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

STATUSES: Final = ("ok", "doubtful", "lost", "gone")
"""Statuses of followed frames, the best first."""

SWITCHED: Final = "switched"
_FOLLOWED: Final = ("ok", "doubtful")
_REASON_OF_SWITCH: Final = "switched to "


@dataclass(frozen=True)
class TrackEvent:
    """A stretch without a supported pose, or a change of the mode.

    kind : the status of its first frame, or ``switched``. first : index of its first frame. back : index of the frame
    at which the instrument is followed again, None if it is not; the same as ``first`` for a change of the mode.
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
        if row["status"] not in _FOLLOWED:
            while number < len(rows) and rows[number]["status"] not in _FOLLOWED:
                number += 1
            back = number if number < len(rows) else None
            found.append(TrackEvent(row["status"], first, back, number - first, _first_reason(row["reasons"])))
            continue
        switch = next((reason for reason in row["reasons"] if reason.startswith(_REASON_OF_SWITCH)), None)
        if switch is not None:
            found.append(TrackEvent(SWITCHED, first, first, 1, switch))
        number += 1
    return found


def _first_reason(reasons: Sequence[str]) -> str:
    """Return the first of the reasons, or an empty text."""
    return reasons[0] if reasons else ""
