"""Plot of a session's joint offsets, with their standard deviations and the corrections of single frames.

As in panels.py, coordinates in the drawing are computed here; the template makes the SVG.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from dvrk_cmaes.calibration.document import SessionCalibration
from dvrk_cmaes.report.plots.axes import Axis, value_axis
from dvrk_cmaes.report.plots.panels import Mark, mark_size

_WIDTH, _LEFT = 560.0, 96.0  # width of the drawing, and start of its axis
_ROW, _TOP = 50.0, 6.0  # height of a row, and top of the first
_ABOVE, _BELOW = 14.0, 10.0  # distances from a row's middle up to the offset, and down to the middle of the marks
_SCATTER = 8.0  # largest vertical distance of the marks from their middle
_GOLDEN = 0.6180339887  # golden ratio: successive multiples modulo 1 spread the marks evenly
_DEVIATIONS = 3.0  # standard deviations on both sides of an offset that the axis contains


@dataclass(frozen=True)
class OffsetEstimate:
    """A joint's offset, its standard deviation, and that from frame to frame, in a unit: rad or m times ``factor``."""

    joint: str
    unit: str
    factor: float
    offset: float
    std: float
    frame_std: float


@dataclass(frozen=True)
class OffsetRow:
    """Coordinates in the drawing of one joint's offset.

    series : number of the colour.
    offset_y, marks_y : vertical coordinates of the offset, and of the middle of the frames' marks.
    offset, std, frame_std : horizontal coordinates of the offset, and of the intervals of one standard deviation about
        it: of the offset, and from frame to frame.
    marks : marks of the frames' corrections.
    """

    joint: str
    series: int
    offset_y: float
    marks_y: float
    offset: float
    std: tuple[float, float]
    frame_std: tuple[float, float]
    marks: tuple[Mark, ...]


@dataclass(frozen=True)
class OffsetPanel:
    """Joints of one unit in rows over one axis, the height of the drawing, and the radius of its marks."""

    height: float
    across: Axis
    size: float
    rows: tuple[OffsetRow, ...]


def offset_estimates(calibration: SessionCalibration) -> Iterator[OffsetEstimate]:
    """Yield the offset of each joint, in deg or mm."""
    stds = np.sqrt(np.diag(calibration.covariance))[6:].tolist()
    for (name, offset), std in zip(calibration.offsets.items(), stds, strict=True):
        unit, factor = ("mm", 1e3) if name == "insertion" else ("deg", 180 / np.pi)
        frame_std = calibration.spreads.get(name, 0.0)
        yield OffsetEstimate(name, unit, factor, factor * offset, factor * std, factor * frame_std)


def offset_panels(
    calibration: SessionCalibration, found: Mapping[str, Mapping[int, float]], unsure: frozenset[int]
) -> tuple[OffsetPanel, ...]:
    """Plot the offsets of revolute joints, in degrees, and below those of prismatic joints, in mm.

    Parameters
    ----------
    calibration
        The session's calibration.
    found
        Found less read, rad or m, by joint and index of the frame.
    unsure
        Indices of the frames whose status is not ok.
    """
    estimates = list(offset_estimates(calibration))
    size = 0.75 * mark_size(len(calibration.frames))
    names = tuple(calibration.offsets)
    # the instrument's joints first, so that their colours are those of the plot of corrections
    colours = {name: k for k, name in enumerate((*names[2:], *names[:2]))}
    panels = []
    for unit in sorted({one.unit for one in estimates}):
        own = [one for one in estimates if one.unit == unit]
        across = _axis(unit, own)
        rows = tuple(
            _row(one, colours[one.joint], _TOP + _ROW * (k + 0.5), across, found.get(one.joint, {}), unsure)
            for k, one in enumerate(own)
        )
        panels.append(OffsetPanel(_TOP + _ROW * len(rows) + 48, across, size, rows))
    return tuple(panels)


def _axis(unit: str, joints: Sequence[OffsetEstimate]) -> Axis:
    reach = [max(1.2 * joint.std, _DEVIATIONS * joint.frame_std) for joint in joints]
    ends = [joint.offset + by * side for joint, by in zip(joints, reach, strict=True) for side in (-1, 1)]
    low, high = min(0.0, *ends), max(0.0, *ends)
    return value_axis(f"offset, {unit}", low, high, start=_LEFT, end=_WIDTH - 14, most=8, least=0.5)


def _row(
    estimate: OffsetEstimate,
    series: int,
    middle: float,
    across: Axis,
    found: Mapping[int, float],
    unsure: frozenset[int],
) -> OffsetRow:
    def mark(place: int, value: float) -> Mark:
        aside = (((place + 1) * _GOLDEN) % 1 - 0.5) * 2 * _SCATTER
        return Mark(
            place, across.clamped(value), middle + _BELOW + aside, place not in unsure, not across.contains(value)
        )

    def about(by: float) -> tuple[float, float]:
        return across.clamped(estimate.offset - by), across.clamped(estimate.offset + by)

    marks = tuple(mark(place, estimate.factor * value) for place, value in found.items())
    stds, above, below = (about(estimate.std), about(estimate.frame_std)), middle - _ABOVE, middle + _BELOW
    return OffsetRow(estimate.joint, series, above, below, across.at(estimate.offset), *stds, marks)
