"""Axes of the page's plots: ticks at round numbers, and the map from values to coordinates of the drawing."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from dvrk_cmaes.geometry import Float64
from dvrk_cmaes.results.result import Result

_ROUND = (1.0, 2.0, 5.0, 10.0)
_START = 64  # of an axis of frames
SIDE = 274.0  # of a square panel

VIEWS = (("x, mm (to the right)", 0), ("z, mm (away from the camera)", 2))
"""Label and coordinate of the horizontal axis in the two views of the camera's frame; the vertical axis is y."""


@dataclass(frozen=True)
class Axis:
    """A linear axis of values from ``low`` to ``high``, drawn from coordinate ``start`` to ``end`` of the drawing.

    ``label`` names the quantity and its unit. ``ticks`` are texts and their coordinates.
    """

    label: str
    low: float
    high: float
    start: float
    end: float
    ticks: tuple[tuple[str, float], ...] = ()

    def at(self, value: float) -> float:
        """Return the coordinate of a value in the drawing."""
        return self.start + (value - self.low) / (self.high - self.low) * (self.end - self.start)

    def contains(self, value: float) -> bool:
        """Whether a value lies between the ends of the axis."""
        return self.low <= value <= self.high

    def clamped(self, value: float) -> float:
        """Return the coordinate of a value, clipped to the ends of the axis."""
        return self.at(min(max(value, self.low), self.high))


def round_step(span: float, most: int) -> float:
    """Return the smallest of 1, 2, 5 times a power of ten that divides a positive span into at most ``most`` parts."""
    power = 10.0 ** math.floor(math.log10(span / most))
    return next(power * factor for factor in _ROUND if power * factor * most >= span * (1 - 1e-9))


def value_axis(
    label: str,
    low: float,
    high: float,
    *,
    start: float,
    end: float,
    most: int = 7,
    to_ticks: bool = True,
    least: float = 0.0,
) -> Axis:
    """Make an axis with about ``most`` ticks at round numbers; ``to_ticks`` extends it to begin and end at a tick.

    An axis from ``low`` to ``high`` that is shorter than ``least`` is extended to it, as much on both sides.
    """
    beside = max(0.0, least - (high - low)) / 2
    low, high = low - beside, high + beside
    step = round_step(high - low, most)
    first, last = math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9)
    if to_ticks:
        first, last = math.floor(low / step + 1e-9), math.ceil(high / step - 1e-9)
        low, high = first * step, last * step
    digits = max(0, -math.floor(math.log10(step) + 1e-9))
    axis = Axis(label, low, high, start, end)
    ticks = tuple((f"{k * step:.{digits}f}", axis.at(k * step)) for k in range(first, last + 1))
    return Axis(label, low, high, start, end, ticks)


def square_axes(label: str, column: int, centre: Float64, reach: float) -> tuple[Axis, Axis]:
    """Make the axes of one of the `VIEWS`, with ticks at round numbers, about a centre (3,), mm in the camera."""
    u, v = float(centre[column]), float(centre[1])
    across = value_axis(label, u - reach, u + reach, start=64, end=64 + SIDE, most=6, to_ticks=False)
    up = "y, mm (downwards)"  # y runs down, as in the image
    return across, value_axis(up, v - reach, v + reach, start=14, end=14 + SIDE, most=6, to_ticks=False)


def frame_axis(results: Sequence[Result], *, end: float, most: int = 10) -> tuple[Axis, list[float]]:
    """Make an axis of the frames of results and return it with the frames' values on it.

    It is an axis of time, s, from the first image on, if the times of all frames are known and differ; else the frames
    are at 0, 1, ..., labelled by their names.
    """
    names, known = tuple(result.frame for result in results), [r.time for r in results if r.time is not None]
    if len(known) == len(names) > 1 and max(known) > min(known):
        values = [time - min(known) for time in known]
        label = "time from the first image, s"
        return value_axis(label, 0.0, max(values), start=_START, end=end, most=most, to_ticks=False), values
    return name_axis(names, start=_START, end=end, most=most), [float(k) for k in range(len(names))]


def name_axis(names: tuple[str, ...], *, start: float, end: float, most: int = 10) -> Axis:
    """Make an axis of frames at 0, 1, ...; at most ``most`` evenly chosen ones are labelled, with shortened names."""
    longest = round((end - start) / most / 7)
    step = max(1, math.ceil(len(names) / most))
    axis = Axis("frame", -0.5, max(len(names) - 0.5, 0.5), start, end)
    ticks = tuple(
        (name if len(name) <= longest else name[: longest - 1] + "…", axis.at(k))
        for k, name in enumerate(names)
        if k % step == 0
    )
    return Axis(axis.label, axis.low, axis.high, start, end, ticks)
