"""The page's entry for one frame, and its numbers as text, in millimetres and degrees."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any
from urllib.parse import quote

import numpy as np

from dvrk_cmaes.geometry import Float64, log_rotation, rotation_angle
from dvrk_cmaes.report.page_session import correction
from dvrk_cmaes.report.page_thumbnails import Thumbnail
from dvrk_cmaes.results.layers import FrameLayers
from dvrk_cmaes.results.result import Result

NOTHING = "-"
"""Text shown for a missing number."""

STATUSES = ("failed", "doubtful", "ok")
"""Statuses of results in the order of the page, the most doubtful first."""


@dataclass(frozen=True)
class LeaveOneOut:
    """Leave-one-out prediction of a frame by the session's other frames, and why the frame was left out of these.

    iou, contour_px : overlap and median contour distance, px, of the predicted silhouette and the mask; None if there
        is no prediction.
    picture : address of its picture, None if there is none. full : the picture as a ``data:`` address, if it is within
        the page.
    reason : why the frame was left out of the session's calibration; empty if it was not.
    """

    iou: float | None
    contour_px: float | None
    picture: str | None
    reason: str
    full: str | None = None


@dataclass(frozen=True, eq=False)
class FrameCard:
    """Contents of the page's entry for a frame.

    place : index in the order of names, from 0.
    overlay, document : addresses of the overlay and of the result's JSON beside the page, None if there are none.
    full, layers : the overlay as a ``data:`` address, and the layers of the drawing, where they are within the page.
    from_median : (3,) m in the camera, from the median of the RCMs of all frames to that of this frame, if it has one.
    left_out : leave-one-out prediction of the frame, if the session was calibrated.
    """

    result: Result
    place: int
    thumbnail: Thumbnail | None
    overlay: str | None
    document: str | None
    from_median: Float64 | None
    left_out: LeaveOneOut | None
    full: str | None = None
    layers: FrameLayers | None = None


def doubt_key(result: Result) -> tuple[int, int, float, float]:
    """Return a sort key that puts the most doubtful first: by status, number of reasons, then least overlap."""
    q = result.quality
    overlap, outline = (-1.0, math.inf) if q is None else (q.iou, q.contour_px_95)
    return STATUSES.index(result.status), -len(result.reasons), overlap, -outline


def anchor(name: str) -> str:
    """Return the identifier of a frame's element on the page, in characters that are valid in addresses."""
    return "frame-" + quote(name, safe="", errors="replace")


def fixed(value: float | None, digits: int) -> str:
    """Format a number with a fixed number of decimals, zero without a sign; a missing or infinite one as a dash."""
    if value is None or not math.isfinite(value):
        return NOTHING
    text = f"{value:.{digits}f}"
    return text.removeprefix("-") if not text.strip("-0.") else text


def signed(value: float | None, digits: int) -> str:
    """Format a number as `fixed`, with a sign unless it is zero."""
    text = fixed(value, digits)
    return text if text == NOTHING or text.startswith("-") or not text.strip("0.") else f"+{text}"


def sort_keys(card: FrameCard) -> dict[str, float]:
    """Return the known numbers that frames can be sorted by, by name."""
    result, from_median, left_out = card.result, card.from_median, card.left_out
    keys = {"seconds": result.seconds} if result.seconds else {}
    if result.time is not None:
        keys["time"] = result.time
    if result.quality is not None:
        keys |= {"iou": result.quality.iou, "contour": result.quality.contour_px_95}
    off = [abs(change) for change in (correction(result, joint) for joint in result.joints) if change is not None]
    if off:
        keys["correction"] = math.degrees(max(off))
    if from_median is not None:
        keys["rcm"] = 1e3 * float(np.linalg.norm(from_median))
    if left_out is not None and left_out.iou is not None:
        keys["predicted"] = left_out.iou
    if result.expected_error is not None:
        keys["tips"] = result.expected_error.tip_90_mm
    if result.mode_probability is not None:
        keys["mode"] = result.mode_probability
    return {name: round(value, 4) for name, value in keys.items() if math.isfinite(value)}


def degrees(value: float | None) -> float | None:
    """Convert an angle in rad; None of an unknown one."""
    return None if value is None else math.degrees(value)


def cells(values: Float64) -> list[str]:
    """Format numbers (N,) with two decimals, as `fixed`."""
    return [fixed(float(value), 2) for value in values]


def position_mm(pose: Float64) -> Float64:
    """Return the position of a pose (4, 4), (3,) mm."""
    return 1e3 * pose[:3, 3]


def axis_angle_deg(pose: Float64) -> Float64:
    """Return the rotation of a pose (4, 4) as axis times angle, (3,) deg."""
    return np.degrees(log_rotation(pose[:3, :3]))


def apart_from(pose: Float64, other: Float64 | None) -> tuple[float | None, float | None]:
    """Return the distance, mm, and the angle, deg, between two poses (4, 4); None without the other one."""
    if other is None:
        return None, None
    apart = float(np.linalg.norm(pose[:3, 3] - other[:3, 3]))
    return 1e3 * apart, math.degrees(float(rotation_angle(pose, other)))


def change_in_words(change: Mapping[str, Any] | None) -> str:
    """Return the changes by a session's calibration as text: names and values; lists and mappings are flattened."""

    def value(thing: Any) -> str:
        if isinstance(thing, Mapping):
            return ", ".join(f"{name} {value(inner)}" for name, inner in thing.items())
        if isinstance(thing, Sequence) and not isinstance(thing, str):
            return " ".join(value(inner) for inner in thing)
        return f"{thing:.2f}" if isinstance(thing, float) else str(thing)

    units = {"translation_mm": "translation, mm", "rotation_deg": "rotation, deg", "joints_deg": "joints, deg"}
    return "; ".join(f"{units.get(name, name)}: {value(thing)}" for name, thing in (change or {}).items())
