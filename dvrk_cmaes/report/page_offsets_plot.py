"""Drawing of a session's joint offsets: how large, how sure, and how far single frames are from them.

As in page_plots.py, what is computed here are places in a drawing; the template makes an SVG of them.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from dvrk_cmaes.calibration import SessionCalibration
from dvrk_cmaes.report.page_axes import Axis, value_axis
from dvrk_cmaes.report.page_plots import Mark, mark_size

_WIDTH, _LEFT = 560.0, 96.0  # of the drawing, and where its axis begins
_ROW, _TOP = 50.0, 6.0
_ABOVE, _BELOW = 14.0, 10.0  # of a row's middle: the offset, and the middle of the frames' marks
_SCATTER = 8.0  # to both sides of that
_GOLDEN = 0.6180339887  # of a turn: places that follow each other never lie beside each other
_SPREADS = 3.0  # on both sides of an offset; frames farther off are drawn at the border


@dataclass(frozen=True)
class Amount:
    """An offset in a unit, its standard deviation, and the spread of frames about it."""

    offset: float
    std: float
    spread: float


@dataclass(frozen=True)
class OffsetRow:
    """One joint: where its offset lies, one standard deviation about it, and the spread from frame to frame.

    ``offset_y`` and ``marks_y`` are heights of the offset and of the frames; ``series`` says which colour.
    """

    joint: str
    series: int
    offset_y: float
    marks_y: float
    offset: float
    std: tuple[float, float]
    spread: tuple[float, float]
    marks: tuple[Mark, ...]


@dataclass(frozen=True)
class OffsetPanel:
    """Joints of one unit below each other over one axis; ``zero`` is its zero, ``size`` the radius of marks."""

    width: float
    height: float
    across: Axis
    zero: float
    size: float
    rows: tuple[OffsetRow, ...]


def amounts(calibration: SessionCalibration) -> Iterator[tuple[str, str, float, Amount]]:
    """Give each joint, its unit for people, that unit in SI units' inverse, and its offset in that unit."""
    for (name, offset), std in zip(
        calibration.offsets.items(), np.sqrt(np.diag(calibration.covariance))[6:], strict=True
    ):
        unit, factor = ("mm", 1e3) if name == "insertion" else ("deg", 180 / np.pi)
        spread = calibration.spreads.get(name, 0.0)
        yield name, unit, factor, Amount(factor * offset, factor * float(std), factor * spread)


def offset_panels(
    calibration: SessionCalibration, found: Mapping[str, Mapping[int, float]], unsure: frozenset[int]
) -> tuple[OffsetPanel, ...]:
    """Plot offsets of the joints that turn, in degrees, and below of those that slide, in mm.

    Parameters
    ----------
    calibration
        The session's.
    found
        By joint and place of the frame: found less read, rad or m.
    unsure
        Places of frames that are not ok.
    """
    by_unit: dict[str, dict[str, Amount]] = {}
    in_unit: dict[str, dict[int, float]] = {}
    for name, unit, factor, amount in amounts(calibration):
        by_unit.setdefault(unit, {})[name] = amount
        in_unit[name] = {place: factor * value for place, value in found.get(name, {}).items()}
    size = 0.75 * mark_size(len(calibration.frames))
    names = tuple(calibration.offsets)
    colours = {name: k for k, name in enumerate((*names[2:], *names[:2]))}  # the instrument's as where they are plotted
    panels = []
    for unit in sorted(by_unit):
        across = _axis(unit, by_unit[unit])
        rows = tuple(
            _row(name, colours[name], _TOP + _ROW * (k + 0.5), across, amount, in_unit[name], unsure)
            for k, (name, amount) in enumerate(by_unit[unit].items())
        )
        panels.append(OffsetPanel(_WIDTH, _TOP + _ROW * len(rows) + 48, across, across.at(0.0), size, rows))
    return tuple(panels)


def _axis(unit: str, joints: Mapping[str, Amount]) -> Axis:
    reach = [max(1.2 * one.std, _SPREADS * one.spread) for one in joints.values()]
    low = min(0.0, *(one.offset - by for one, by in zip(joints.values(), reach, strict=True)))
    high = max(0.0, *(one.offset + by for one, by in zip(joints.values(), reach, strict=True)))
    least = max(0.0, 0.5 - (high - low)) / 2
    return value_axis(f"offset, {unit}", low - least, high + least, start=_LEFT, end=_WIDTH - 14, most=8)


def _row(
    joint: str,
    series: int,
    middle: float,
    across: Axis,
    amount: Amount,
    found: Mapping[int, float],
    unsure: frozenset[int],
) -> OffsetRow:
    def mark(place: int, value: float) -> Mark:
        aside = (((place + 1) * _GOLDEN) % 1 - 0.5) * 2 * _SCATTER
        return Mark(place, across.clamped(value), middle + _BELOW + aside, place not in unsure, not across.holds(value))

    def about(by: float) -> tuple[float, float]:
        return across.clamped(amount.offset - by), across.clamped(amount.offset + by)

    return OffsetRow(
        joint=joint,
        series=series,
        offset_y=middle - _ABOVE,
        marks_y=middle + _BELOW,
        offset=across.at(amount.offset),
        std=about(amount.std),
        spread=about(amount.spread),
        marks=tuple(mark(place, value) for place, value in found.items()),
    )
