"""What the page says of one frame, in words and numbers for people: millimetres and degrees."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any
from urllib.parse import quote

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from dvrk_cmaes.geometry import rotation_angle
from dvrk_cmaes.report.page_session import correction
from dvrk_cmaes.report.page_thumbnails import Thumbnail
from dvrk_cmaes.results.result import Alternative, Result

Float64 = NDArray[np.float64]

NOTHING = "-"
"""Where there is no number to show."""

STATUSES = ("failed", "doubtful", "ok")
"""Most doubtful first."""


@dataclass(frozen=True)
class Row:
    """A line of a table: its heading, its cells, and whether it says more about the line above it."""

    heading: str
    cells: tuple[str, ...]
    minor: bool = False


@dataclass(frozen=True)
class LeftOut:
    """What the other frames of a session say of a frame: overlap of what they predict, and its outline's distance, px.

    picture : address of its picture, None where there is none. reason : why the frame was left out, if it was.
    """

    iou: float | None
    contour_px: float | None
    picture: str | None
    reason: str


@dataclass(frozen=True)
class FrameView:
    """A frame as the template shows it.

    anchor : the name of its place on the page. place : 0, 1, ... in the order of names. keys : what to sort it by.
    overlay, document : addresses of files beside the page, None where there is none.
    """

    result: Result
    anchor: str
    place: int
    thumbnail: Thumbnail | None
    overlay: str | None
    document: str | None
    keys: Mapping[str, float]
    pose: tuple[Row, ...]
    joints: tuple[Row, ...]
    fit: tuple[tuple[str, str], ...]
    alternatives: tuple[Row, ...]
    change: str
    left_out: LeftOut | None


def doubt(result: Result) -> tuple[int, int, float, float]:
    """Sort key that puts the most doubtful first: failed, then most reasons to doubt, then least overlap."""
    q = result.quality
    overlap, outline = (-1.0, math.inf) if q is None else (q.iou, q.contour_px_95)
    return STATUSES.index(result.status), -len(result.reasons), overlap, -outline


def anchor(name: str) -> str:
    """Name a frame's place on the page, of characters that any address may hold."""
    return "frame-" + quote(name, safe="", errors="replace")


def frame_view(
    result: Result,
    *,
    place: int,
    thumbnail: Thumbnail | None,
    document: str | None,
    overlay: str | None,
    from_median: Float64 | None,
    left_out: LeftOut | None = None,
) -> FrameView:
    """Put a result in words.

    Parameters
    ----------
    result
        Of the frame.
    place
        The frame's place in the order of names, from 0.
    thumbnail, document, overlay
        Its picture, and the addresses of its files.
    from_median
        (3,) m in the camera: from the median of the RCMs of all frames to this frame's, where it has one.
    left_out
        What the session's other frames say of it, where it was calibrated.
    """
    return FrameView(
        result=result,
        anchor=anchor(result.frame),
        place=place,
        thumbnail=thumbnail,
        overlay=overlay,
        document=document,
        keys=_keys(result, from_median, left_out),
        pose=tuple(_pose(result, from_median)),
        joints=tuple(_joints(result)),
        fit=tuple(_fit(result)),
        alternatives=tuple(row for other in result.alternatives for row in _alternative(result, other)),
        change=_in_words(result.change),
        left_out=left_out,
    )


def fixed(value: float | None, digits: int) -> str:
    """Show a number with a fixed number of decimals, zero without a sign; a dash where there is none."""
    if value is None or not math.isfinite(value):
        return NOTHING
    text = f"{value:.{digits}f}"
    return text.removeprefix("-") if not text.strip("-0.") else text


def signed(value: float | None, digits: int) -> str:
    """Show a number as ``fixed``, with its sign."""
    text = fixed(value, digits)
    return text if text == NOTHING or text.startswith("-") or not text.strip("0.") else f"+{text}"


def _keys(result: Result, from_median: Float64 | None, left_out: LeftOut | None) -> dict[str, float]:
    """Numbers that frames can be sorted by; a name is left out where its number is not known."""
    keys = {"seconds": result.seconds}
    if result.quality is not None:
        keys |= {"iou": result.quality.iou, "contour": result.quality.contour_px_95}
    off = [abs(change) for change in (correction(result, joint) for joint in result.joints) if change is not None]
    if off:
        keys["correction"] = math.degrees(max(off))
    if from_median is not None:
        keys["rcm"] = 1e3 * float(np.linalg.norm(from_median))
    if left_out is not None and left_out.iou is not None:
        keys["predicted"] = left_out.iou
    return {name: round(value, 4) for name, value in keys.items() if math.isfinite(value)}


def _cells(values: Iterable[float], digits: int) -> tuple[str, ...]:
    return tuple(fixed(float(value), digits) for value in values)


def _pose(result: Result, from_median: Float64 | None) -> Iterable[Row]:
    """Position and rotation of the root and of the arm's base, with what is known of their errors."""
    pose = result.camera_from_root
    if pose is not None:
        yield Row(f"{result.root_link}: position, mm", _cells(1e3 * pose[:3, 3], 2))
        if result.std_translation_mm is not None:
            yield Row("standard deviation along its own axes, mm", _cells(result.std_translation_mm, 2), minor=True)
        yield Row(f"{result.root_link}: axis-angle, deg", _cells(axis_angle(pose), 2))
        if result.std_rotation_deg is not None:
            yield Row("standard deviation about its own axes, deg", _cells(result.std_rotation_deg, 2), minor=True)
    if result.camera_from_base is not None:
        yield Row("arm's base (RCM): position, mm", _cells(1e3 * result.camera_from_base[:3, 3], 2))
        if from_median is not None:
            away = tuple(signed(float(value), 2) for value in 1e3 * from_median)
            yield Row("from the median of all frames, mm", away, minor=True)
        yield Row("arm's base: axis-angle, deg", _cells(axis_angle(result.camera_from_base), 2))


def axis_angle(pose: Float64) -> Float64:
    """Rotation of a pose (4, 4) as axis times angle, (3,) deg."""
    return np.asarray(Rotation.from_matrix(pose[:3, :3]).as_rotvec(degrees=True), dtype=np.float64)


def _joints(result: Result) -> Iterable[Row]:
    """Found, standard deviation, read, found less read; then the readings of joints that are not the instrument's."""
    std = result.std_joints_deg or {}
    for name, value in result.joints.items():
        change, read = correction(result, name), result.readings.get(name)
        cells = (
            fixed(math.degrees(value), 2),
            fixed(std.get(name), 2),
            fixed(None if read is None else math.degrees(read), 2),
            signed(None if change is None else math.degrees(change), 2),
        )
        yield Row(f"{name}, deg", cells)
    for name, read in result.readings.items():
        if name not in result.joints:
            unit, shown = ("mm", 1e3 * read) if name == "insertion" else ("deg", math.degrees(read))
            yield Row(f"{name}, {unit}", ("", "", fixed(shown, 2), ""), minor=True)


def _fit(result: Result) -> Iterable[tuple[str, str]]:
    """Name and value of how well the silhouette explains the mask, and of what that took."""
    q = result.quality
    if q is not None:
        yield "overlap (IoU)", fixed(q.iou, 4)
        yield "outline to mask, median", f"{fixed(q.contour_px_median, 2)} px"
        yield "outline to mask, 95 %", f"{fixed(q.contour_px_95, 2)} px"
        terms = ", ".join(f"{name} {value:.3g}" for name, value in q.terms.items())
        yield "loss", f"{q.loss:.4g}" + (f" ({terms})" if terms else "")
    yield "time", f"{fixed(result.seconds, 2)} s, {result.evaluations:,} silhouettes, {result.rays:,} rays"
    yield "solved", "with the session's frames" if result.source == "session" else "by itself"


def _alternative(result: Result, other: Alternative) -> Iterable[Row]:
    """One other pose: overlap, loss, how far it is from the readings and from the result; below, its joints."""
    apart, turned = None, None
    if result.camera_from_root is not None:
        apart = 1e3 * float(np.linalg.norm(other.camera_from_root[:3, 3] - result.camera_from_root[:3, 3]))
        turned = math.degrees(float(rotation_angle(other.camera_from_root, result.camera_from_root)))
    cells = (
        fixed(other.iou, 4),
        f"{other.loss:.4g}",
        fixed(other.reading_distance_deg, 1),
        fixed(apart, 1),
        fixed(turned, 1),
    )
    yield Row(other.relation, cells)
    joints = ", ".join(f"{name} {fixed(math.degrees(value), 1)}" for name, value in other.joints.items())
    if joints:
        yield Row(f"{joints} deg", (), minor=True)


def _in_words(change: Mapping[str, Any] | None) -> str:
    """Write out what a session moved: names and values, lists and inner names in brackets."""

    def value(thing: Any) -> str:
        if isinstance(thing, Mapping):
            return ", ".join(f"{name} {value(inner)}" for name, inner in thing.items())
        if isinstance(thing, Sequence) and not isinstance(thing, str):
            return " ".join(value(inner) for inner in thing)
        return f"{thing:.2f}" if isinstance(thing, float) else str(thing)

    units = {"translation_mm": "translation, mm", "rotation_deg": "rotation, deg", "joints_deg": "joints, deg"}
    return "; ".join(f"{units.get(name, name)}: {value(thing)}" for name, thing in (change or {}).items())
