"""The page's plots: the joints' corrections, and each frame's remote centre of motion (RCM).

Coordinates in the drawing are computed here; the template makes the SVG, and the style sheet defines its colours.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dvrk_cmaes.report.page_session import FrameBases, correction
from dvrk_cmaes.report.plots.axes import SIDE, VIEWS, Axis, frame_axis, square_axes, value_axis
from dvrk_cmaes.results.result import Result

_OUTLINES: dict[str, tuple[tuple[float, float], ...]] = {
    "circle": ((-1.0, 0.0),),
    "square": ((-0.9, -0.9), (1.8, 0.0), (0.0, 1.8), (-1.8, 0.0)),
    "triangle": ((0.0, -1.3), (1.25, 2.1), (-2.5, 0.0)),
    "diamond": ((0.0, -1.3), (1.3, 1.3), (-1.3, 1.3), (-1.3, -1.3)),
    "flat": ((-1.5, -0.55), (3.0, 0.0), (0.0, 1.1), (-3.0, 0.0)),
}
"""Outlines of marks of radius 1: the start point relative to the centre, then relative line segments."""

SHAPES = tuple(_OUTLINES)
"""Shapes of the marks of successive series, repeated cyclically."""

_BARS_FOR_AT_MOST = 80  # largest number of frames for which error bars are drawn
_FAR = 6.0  # multiple of the median distance; points farther from the median do not extend the axes
_LEAST_REACH = 0.5  # mm, least half length of the axes
_WIDE_FROM = 120  # number of frames from which the plot has the page's whole width


@dataclass(frozen=True)
class Mark:
    """Mark of a frame.

    place : index of the frame in the order of names. x, y : coordinates of the mark's centre in the drawing.
    sure : whether the frame's status is ok.
    beyond : whether the value lies outside the axes; the mark is then drawn at the border.
    """

    place: int
    x: float
    y: float
    sure: bool
    beyond: bool = False


@dataclass(frozen=True)
class Series:
    """Marks of one shape and colour, and error bars (x, upper end, lower end).

    colour : number of the colour; None for the series' place in its panel.
    """

    name: str
    shape: str
    marks: tuple[Mark, ...]
    bars: tuple[tuple[float, float, float], ...] = ()
    colour: int | None = None


@dataclass(frozen=True)
class Panel:
    """A drawing with one pair of axes.

    zero : vertical coordinate of the line of value 0, None if it is not drawn.
    centre : coordinates of the marked centre and radius of the ring about it, None if they are not drawn.
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
    """Panels in a row.

    size : radius of the marks. wide : whether the plot has the page's whole width.
    beyond : texts about the frames outside the axes.
    """

    name: str
    size: float
    panels: tuple[Panel, ...]
    wide: bool = False
    beyond: tuple[str, ...] = ()


def short(value: float) -> str:
    """Format a coordinate of the drawing with at most one decimal."""
    return f"{value:.1f}".removesuffix(".0")


def mark_path(shape: str, x: float, y: float, radius: float) -> str:
    """Return the outline of a mark about a point as an SVG path; all shapes have about the same area."""
    start, *strokes = _OUTLINES[shape]
    outline = f"M{short(x + start[0] * radius)} {short(y + start[1] * radius)}"
    if shape == "circle":
        r, d = short(radius), short(2 * radius)
        return f"{outline}a{r} {r} 0 1 0 {d} 0a{r} {r} 0 1 0 -{d} 0z"
    return outline + "".join(f"l{short(dx * radius)} {short(dy * radius)}" for dx, dy in strokes) + "z"


def joint_plot(results: Sequence[Result]) -> Plot | None:
    """Plot each joint's found less read, deg, over time or, without times, over the frames; None if none was read."""
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
    wide = len(results) >= _WIDE_FROM
    width = 1320 if wide else 720
    across, at = frame_axis(results, end=width - 24, most=20 if wide else 10)
    up = value_axis("found - read, deg", min(ends), max(ends), start=276, end=14, least=1.0)
    step = (across.end - across.start) / len(results)
    series = []
    for k, (joint, points) in enumerate(read.items()):
        aside = (k - (len(read) - 1) / 2) * min(0.22 * step, 7.0)
        marks = [
            Mark(place, across.at(at[place]) + aside, up.at(off), results[place].status == "ok")
            for place, off, _ in points
        ]
        spans = [
            (across.at(at[place]) + aside, up.clamped(off + std_deg), up.clamped(off - std_deg))
            for place, off, std_deg in points
            if bars and std_deg is not None
        ]
        series.append(Series(joint, SHAPES[k % len(SHAPES)], tuple(marks), tuple(spans)))
    panel = Panel(width, 330, across, up, tuple(series), zero=up.at(0.0))
    return Plot("joints", mark_size(len(results)), (panel,), wide)


def rcm_plot(results: Sequence[Result], base: FrameBases) -> Plot:
    """Plot each frame's RCM in the camera's frame, mm: y over x, and y over z, to the same scale.

    Points outside the axes, which are much farther from the median than most, are drawn at the border.
    """
    places = {result.frame: place for place, result in enumerate(results)}
    points, centre, distances = 1e3 * base.points, 1e3 * base.centre, 1e3 * base.distances
    near = distances <= max(_FAR * float(np.median(distances)), _LEAST_REACH)
    reach = max(1.15 * float(np.abs(points[near] - centre).max()), _LEAST_REACH)
    ring = float(np.median(distances))
    panels = []
    outside = np.zeros(len(points), dtype=bool)
    for label, column in VIEWS:
        across, up = square_axes(label, column, centre, reach)
        marks = []
        for k, (name, point) in enumerate(zip(base.frames, points, strict=True)):
            x, y = float(point[column]), float(point[1])
            beyond = not (across.contains(x) and up.contains(y))
            outside[k] |= beyond
            sure = results[places[name]].status == "ok"
            marks.append(Mark(places[name], across.clamped(x), up.clamped(y), sure, beyond))
        middle = across.at(float(centre[column])), up.at(float(centre[1])), across.at(ring) - across.at(0.0)
        panels.append(Panel(SIDE + 84, SIDE + 64, across, up, (Series("RCM", SHAPES[0], tuple(marks)),), centre=middle))
    far = sorted(((float(distances[k]), base.frames[k]) for k in np.flatnonzero(outside)), reverse=True)
    return Plot(
        "rcm",
        mark_size(len(points)),
        tuple(panels),
        beyond=tuple(f"{name} ({distance:.0f} mm away)" for distance, name in far),
    )


def mark_size(frames: int) -> float:
    """Return the radius of marks: 4.5 for at most 100 frames, else 3."""
    return 4.5 if frames <= 100 else 3.0
