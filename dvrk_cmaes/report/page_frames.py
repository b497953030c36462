"""The page's entry for one frame: texts and table rows, in millimetres and degrees."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any
from urllib.parse import quote

import numpy as np

from dvrk_cmaes.geometry import Float64, log_rotation, rotation_angle
from dvrk_cmaes.report.page_layers import DrawnLayers
from dvrk_cmaes.report.page_session import correction
from dvrk_cmaes.report.page_thumbnails import Thumbnail
from dvrk_cmaes.results.result import Result

NOTHING = "-"
"""Text shown for a missing number."""

STATUSES = ("failed", "doubtful", "ok")
"""Statuses of results in the order of the page, the most doubtful first."""


@dataclass(frozen=True)
class TableRow:
    """A row of a table: its heading, its cells, and whether it is a detail of the row above."""

    heading: str
    cells: tuple[str, ...]
    minor: bool = False


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
    layers: DrawnLayers | None = None


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


def _cells(values: Iterable[float]) -> tuple[str, ...]:
    return tuple(fixed(float(value), 2) for value in values)


def pose_rows(card: FrameCard) -> Iterator[TableRow]:
    """Yield rows of the position and rotation of the root and of the arm's base, with standard deviations if known."""
    result, root = card.result, card.result.root_link
    if result.camera_from_root is not None:
        headings, std = (f"{root}: position, mm", f"{root}: axis-angle, deg"), OWN_AXES
        yield from rows_of(result.camera_from_root, headings, std, result.std_translation_mm, result.std_rotation_deg)
    for k, tip in enumerate(result.tips, start=1):
        name = "tip" if len(result.tips) == 1 else f"jaw_{k}"
        yield TableRow(f"{name if name == 'tip' else name + ', tip'}: position, mm", _cells(1e3 * tip))
        if result.expected_error is not None and name in result.expected_error.tip_axes_mm:
            axes = _cells(result.expected_error.tip_axes_mm[name])
            yield TableRow("standard deviation along the camera's axes, mm", axes, minor=True)
    if result.camera_from_base is not None:
        position, rotation = rows_of(
            result.camera_from_base, ("arm's base (RCM): position, mm", "arm's base: axis-angle, deg")
        )
        yield position
        if card.from_median is not None:
            away = tuple(signed(float(value), 2) for value in 1e3 * card.from_median)
            yield TableRow("from the median of all frames, mm", away, minor=True)
        yield rotation


OWN_AXES = ("standard deviation along its own axes, mm", "standard deviation about its own axes, deg")
"""Headings of the standard deviations of a pose."""


def rows_of(
    pose: Float64,
    headings: tuple[str, str],
    of_std: tuple[str, str] = OWN_AXES,
    std_mm: Float64 | None = None,
    std_deg: Float64 | None = None,
) -> Iterator[TableRow]:
    """Yield rows of the position and the rotation of a pose (4, 4), and of their standard deviations (3,) if known."""
    values = 1e3 * pose[:3, 3], np.degrees(log_rotation(pose[:3, :3]))
    for heading, value, detail, std in zip(headings, values, of_std, (std_mm, std_deg), strict=True):
        yield TableRow(heading, _cells(value))
        if std is not None:
            yield TableRow(detail, _cells(std), minor=True)


def joint_rows(result: Result) -> Iterator[TableRow]:
    """Yield rows of found, standard deviation, read, found less read; then the readings of the arm's joints."""
    std = result.std_joints_deg or {}
    for name, value in result.joints.items():
        change, read = correction(result, name), result.readings.get(name)
        cells = (
            fixed(math.degrees(value), 2),
            fixed(std.get(name), 2),
            fixed(None if read is None else math.degrees(read), 2),
            signed(None if change is None else math.degrees(change), 2),
        )
        yield TableRow(f"{name}, deg", cells)
    for name, read in result.readings.items():
        if name not in result.joints:
            unit, shown = ("mm", 1e3 * read) if name.endswith("insertion") else ("deg", math.degrees(read))
            yield TableRow(f"{name}, {unit}", ("", "", fixed(shown, 2), ""), minor=True)


def fit_figures(result: Result) -> Iterator[tuple[str, str]]:
    """Yield names and values: expected errors, agreement with the mask, loss, time, and how the frame was solved."""
    if result.expected_error is not None:
        yield "expected error of the tips, rms", f"{fixed(result.expected_error.of_tips_mm, 2)} mm"
        yield "expected error of the shaft's direction, rms", f"{fixed(result.expected_error.shaft_deg, 2)} deg"
    if result.mode_probability is not None:
        yield "probability of the right mode", fixed(result.mode_probability, 2)
    if result.tip_probability is not None:
        yield "probability of tips within the limit", fixed(result.tip_probability, 2)
    q = result.quality
    if q is not None:
        yield "overlap (IoU)", fixed(q.iou, 4)
        yield "outline to mask, median", f"{fixed(q.contour_px_median, 2)} px"
        yield "outline to mask, 95 %", f"{fixed(q.contour_px_95, 2)} px"
        yield "contour off in stretches", f"{fixed(100 * q.steady_share, 0)} %"
        yield "contour beyond the shaft, rms", f"{fixed(q.distal_px, 2)} px"
        terms = ", ".join(f"{name} {value:.3g}" for name, value in q.terms.items())
        yield "loss", f"{q.loss:.4g}" + (f" ({terms})" if terms else "")
    if result.time is not None:
        yield "image at", f"{result.time:.3f} s"
    if result.seconds:
        yield "time", f"{fixed(result.seconds, 2)} s, {result.evaluations:,} silhouettes, {result.rays:,} rays"
    yield "solved", "with the session's frames" if result.source == "session" else "by itself"


def alternative_rows(result: Result) -> Iterator[TableRow]:
    """Yield rows of other poses: overlap, loss, distances from the readings and the result; their joints."""
    for other in result.alternatives:
        apart, turned = None, None
        if result.camera_from_root is not None:
            apart = 1e3 * float(np.linalg.norm(other.camera_from_root[:3, 3] - result.camera_from_root[:3, 3]))
            turned = math.degrees(float(rotation_angle(other.camera_from_root, result.camera_from_root)))
        far = (fixed(number, 1) for number in (other.reading_distance_deg, apart, turned))
        yield TableRow(other.relation, (fixed(other.iou, 4), f"{other.loss:.4g}", *far))
        joints = ", ".join(f"{name} {fixed(math.degrees(value), 1)}" for name, value in other.joints.items())
        if joints:
            yield TableRow(f"{joints} deg", (), minor=True)


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
