"""The page's plots: how far joints are from their readings, and where each frame puts the remote centre of motion.

What is computed here are places in a drawing; the template makes an SVG of them, whose colours follow the page's.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dvrk_cmaes.report.page_axes import Axis, centred_axis, name_axis, value_axis
from dvrk_cmaes.report.page_session import SessionBase, correction
from dvrk_cmaes.results.result import Result

_OUTLINES: dict[str, tuple[tuple[float, float], ...]] = {
    "circle": ((-1.0, 0.0),),
    "square": ((-0.9, -0.9), (1.8, 0.0), (0.0, 1.8), (-1.8, 0.0)),
    "triangle": ((0.0, -1.3), (1.25, 2.1), (-2.5, 0.0)),
    "diamond": ((0.0, -1.3), (1.3, 1.3), (-1.3, 1.3), (-1.3, -1.3)),
    "flat": ((-1.5, -0.55), (3.0, 0.0), (0.0, 1.1), (-3.0, 0.0)),
}
"""Where a mark of radius 1 begins, and its strokes from there."""

SHAPES = tuple(_OUTLINES)
"""Of the marks of the first, second, ... series; they repeat."""

_BARS_FOR_AT_MOST = 80  # frames; error bars of more would hide each other
_FAR = 6.0  # times the median distance: what is farther off does not widen the plot
_LEAST_REACH = 0.5  # mm
_WIDE_FROM = 120  # frames
_SIDE = 274.0  # of the square panels of the RCM


@dataclass(frozen=True)
class Mark:
    """A frame's mark: the frame's place in the order of names, and where the mark's centre lies in the drawing.

    sure : whether the frame is ok. beyond : whether the value lies outside, and the mark at the border.
    """

    place: int
    x: float
    y: float
    sure: bool
    beyond: bool = False


@dataclass(frozen=True)
class Series:
    """Marks of one kind, and error bars (x, upper end, lower end)."""

    name: str
    shape: str
    marks: tuple[Mark, ...]
    bars: tuple[tuple[float, float, float], ...] = ()


@dataclass(frozen=True)
class Panel:
    """A drawing of a size with one pair of axes, and what is drawn between them.

    zero : height of the line of value zero, if it is to be drawn.
    centre : where to mark the middle, and the radius of the ring about it, if any.
    """

    width: float
    height: float
    across: Axis
    up: Axis
    series: tuple[Series, ...]
    zero: float | None = None
    centre: tuple[float, float, float] | None = None


@dataclass(frozen=True)
class Plot:
    """Panels beside each other; ``size`` is the marks' radius.

    wide : whether it should have the page's whole width. beyond : in words, what lies outside.
    """

    name: str
    size: float
    panels: tuple[Panel, ...]
    wide: bool = False
    beyond: tuple[str, ...] = ()


def short(value: float) -> str:
    """Write a coordinate with one decimal at most, which is finer than anybody sees."""
    return f"{value:.1f}".removesuffix(".0")


def mark_path(shape: str, x: float, y: float, radius: float) -> str:
    """Outline of a mark about a point, as the path of an SVG; all shapes have about the same area."""
    start, *strokes = _OUTLINES[shape]
    outline = f"M{short(x + start[0] * radius)} {short(y + start[1] * radius)}"
    if shape == "circle":
        r, d = short(radius), short(2 * radius)
        return f"{outline}a{r} {r} 0 1 0 {d} 0a{r} {r} 0 1 0 -{d} 0z"
    return outline + "".join(f"l{short(dx * radius)} {short(dy * radius)}" for dx, dy in strokes) + "z"


def joint_plot(results: Sequence[Result]) -> Plot | None:
    """Plot found less read, deg, over the frames, in the order given; None where no joint was read."""
    read: dict[str, list[tuple[int, float, float | None]]] = {}
    for place, result in enumerate(results):
        std = result.std_joints_deg or {}
        for joint in result.joints:
            off = correction(result, joint)
            if off is not None:
                read.setdefault(joint, []).append((place, float(np.degrees(off)), std.get(joint)))
    if not read:
        return None
    bars = len(results) <= _BARS_FOR_AT_MOST
    ends = [0.0]
    for points in read.values():
        for _, off, std_deg in points:
            half = std_deg if bars and std_deg is not None else 0.0
            ends += [off - half, off + half]
    low, high = min(ends), max(ends)
    least = max(0.0, 1.0 - (high - low))
    wide = len(results) >= _WIDE_FROM
    width = 1320 if wide else 720
    names = tuple(result.frame for result in results)
    across = name_axis("frame", names, start=64, end=width - 12, most=20 if wide else 10)
    up = value_axis("found - read, deg", low - least / 2, high + least / 2, start=276, end=14)
    step = across.at(1) - across.at(0)
    series = []
    for k, (joint, points) in enumerate(read.items()):
        aside = (k - (len(read) - 1) / 2) * min(0.22 * step, 7.0)
        marks = [
            Mark(place, across.at(place) + aside, up.at(off), results[place].status == "ok") for place, off, _ in points
        ]
        spans = [
            (across.at(place) + aside, up.clamped(off + std_deg), up.clamped(off - std_deg))
            for place, off, std_deg in points
            if bars and std_deg is not None
        ]
        series.append(Series(joint, SHAPES[k % len(SHAPES)], tuple(marks), tuple(spans)))
    panel = Panel(width, 330, across, up, tuple(series), zero=up.at(0.0))
    return Plot("joints", mark_size(len(results)), (panel,), wide)


def rcm_plot(results: Sequence[Result], base: SessionBase) -> Plot:
    """Plot where each frame puts the RCM in the camera, mm: as the camera looks, and from its side, to one scale.

    Points much farther from the median than most are drawn at the border.
    """
    places = {result.frame: place for place, result in enumerate(results)}
    points, centre, distances = 1e3 * base.points, 1e3 * base.centre, 1e3 * base.distances
    near = distances <= max(_FAR * float(np.median(distances)), _LEAST_REACH)
    reach = max(1.15 * float(np.abs(points[near] - centre).max()), _LEAST_REACH)
    ring = float(np.median(distances))
    panels = []
    outside = np.zeros(len(points), dtype=bool)
    for column, label in ((0, "x, mm (to the right)"), (2, "z, mm (away from the camera)")):
        across = centred_axis(label, centre[column], reach, 64, 64 + _SIDE)
        up = centred_axis("y, mm (downwards)", centre[1], reach, 14, 14 + _SIDE)  # y runs down, as in the image
        marks = []
        for k, (name, point) in enumerate(zip(base.frames, points, strict=True)):
            x, y = float(point[column]), float(point[1])
            beyond = not (across.holds(x) and up.holds(y))
            outside[k] |= beyond
            sure = results[places[name]].status == "ok"
            marks.append(Mark(places[name], across.clamped(x), up.clamped(y), sure, beyond))
        middle = across.at(float(centre[column])), up.at(float(centre[1])), across.at(ring) - across.at(0.0)
        panels.append(
            Panel(_SIDE + 84, _SIDE + 64, across, up, (Series("RCM", SHAPES[0], tuple(marks)),), centre=middle)
        )
    far = sorted(((float(distances[k]), base.frames[k]) for k in np.flatnonzero(outside)), reverse=True)
    return Plot(
        "rcm",
        mark_size(len(points)),
        tuple(panels),
        beyond=tuple(f"{name} ({distance:.0f} mm away)" for distance, name in far),
    )


def mark_size(frames: int) -> float:
    """Radius of marks: smaller where there are many."""
    return 4.5 if frames <= 100 else 3.0
