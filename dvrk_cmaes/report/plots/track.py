"""Curves over the frames of a followed recording, in degrees, millimetres and pixels."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from dvrk_cmaes.geometry import Float64


@dataclass(frozen=True, eq=False)
class Curve:
    """Values (F,) of one quantity, NaN where it is not known.

    colour : number of its colour. faint : whether it is drawn in the background of the one with the same colour.
    """

    name: str
    values: Float64
    colour: int
    faint: bool = False


@dataclass(frozen=True, eq=False)
class Chart:
    """Curves with one vertical axis.

    name : identifier. title : with the unit. note : what is drawn, in a sentence. digits : decimals of a value.
    """

    name: str
    title: str
    note: str
    curves: tuple[Curve, ...]
    digits: int


def track_charts(
    rows: Sequence[Mapping[str, Any]],
    times: Float64 | None,
    readings: Mapping[str, Float64],
    residuals: Mapping[str, Float64],
) -> list[Chart]:
    """Make the charts of a recording, given by its lines of tracks.jsonl; those without any value are left out.

    Parameters
    ----------
    rows
        F lines of tracks.jsonl.
    times
        (F,) s; None if the frames have no times.
    readings
        Readings at the images' times by joint, (F,) rad, NaN where there is none.
    residuals
        Distances between outline and mask by name, (F,) px, NaN where there is no mask or no pose.
    """
    charts = (
        _joints(rows, readings),
        _offsets(rows),
        _residual(rows, residuals),
        _tips(rows),
        _speed(rows, times),
        _spread(rows),
        _base(rows),
    )
    return [_with_end(chart, rows) for chart in charts if any(map(_is_known, chart.curves))]


def _is_known(curve: Curve) -> bool:
    """Whether a curve has any value."""
    return bool(np.isfinite(curve.values).any())


def _with_end(chart: Chart, rows: Sequence[Mapping[str, Any]]) -> Chart:
    """Return a chart whose note says where its curves end, if that is before the last frame with a pose."""
    last = max(np.flatnonzero(np.isfinite(curve.values))[-1] for curve in chart.curves if _is_known(curve))
    later = sum(row["camera_from_root"] is not None for row in rows[last + 1 :])
    if not later:
        return chart
    frames = f"{later} later frame{'' if later == 1 else 's'} with a pose"
    return replace(chart, note=f"{chart.note} Ends at {rows[last]['frame']}: not known in {frames}.")


def _joints(rows: Sequence[Mapping[str, Any]], readings: Mapping[str, Float64]) -> Chart:
    """Chart the joints as found and, faintly, as read."""
    names = list(dict.fromkeys(name for row in rows for name in row["joints"]))
    curves = []
    for k, name in enumerate(names):
        curves.append(Curve(name, np.degrees(_column(row["joints"].get(name) for row in rows)), k))
        if name in readings:
            curves.append(Curve("read", np.degrees(readings[name]), k, faint=True))
    return Chart("joints", "Joints, deg", "Found, and faintly as the robot read them.", tuple(curves), 1)


def _offsets(rows: Sequence[Mapping[str, Any]]) -> Chart:
    """Chart the offsets of the readings."""
    offsets = [row.get("offsets") or {} for row in rows]
    names = list(dict.fromkeys(name for each in offsets for name in each if name != "roll"))
    names += ["roll"] if any("roll" in each for each in offsets) else []  # the joints have the colours they have above
    curves = tuple(
        Curve(name, np.degrees(_column(each.get(name) for each in offsets)), k) for k, name in enumerate(names)
    )
    return Chart("offsets", "Offsets, deg", "True = reading + offset, as it was believed at the time.", curves, 2)


def _residual(rows: Sequence[Mapping[str, Any]], residuals: Mapping[str, Float64]) -> Chart:
    """Chart the distances between masks and outlines, and those that the tracker was left with."""
    curves = [Curve(f"mask, {name}", values, k) for k, (name, values) in enumerate(residuals.items())]
    curves.append(Curve("edges used", _column(row.get("residual_px") for row in rows), len(curves)))
    known = tuple(filter(_is_known, curves))
    note = (
        "Distances of the mask's contour from the outline, and standard deviation of the edges that the tracker used."
    )
    return Chart("residual", "Residual, px", note, known, 2)


def _tips(rows: Sequence[Mapping[str, Any]]) -> Chart:
    """Chart the mean place of the tips, from its median."""
    middles = 1e3 * _middles(rows)
    known = np.isfinite(middles).all(axis=1)
    centre = np.median(middles[known], axis=0) if known.any() else np.zeros(3)
    curves = tuple(Curve(axis, middles[:, k] - centre[k], k) for k, axis in enumerate("xyz"))
    place = ", ".join(f"{axis} {value:.1f}" for axis, value in zip("xyz", centre, strict=True))
    note = f"Mean of the tips in the camera (x right, y down, z forward) from its median: {place} mm."
    return Chart("tips", "Tips, mm from their median", note, curves, 1)


def _speed(rows: Sequence[Mapping[str, Any]], times: Float64 | None) -> Chart:
    """Chart the speed of the mean of the tips since the frame before."""
    moved = 1e3 * np.linalg.norm(np.diff(_middles(rows), axis=0), axis=1)
    unit = "mm a frame"
    if times is not None:
        elapsed = np.diff(times)
        moved, unit = np.divide(moved, elapsed, out=np.full_like(moved, np.nan), where=elapsed > 0), "mm/s"
    values = np.concatenate([[np.nan], moved])[: len(rows)]
    return Chart("speed", f"Speed of the tips, {unit}", "From one frame to the next.", (Curve("speed", values, 0),), 1)


def _spread(rows: Sequence[Mapping[str, Any]]) -> Chart:
    """Chart the standard deviation of the tips."""
    values = _column((row["std"] or {}).get("tip_mm") for row in rows)
    note = "As the tracker states it: the norm over the three axes, mean over the tips."
    return Chart("spread", "Standard deviation of the tips, mm", note, (Curve("tips", values, 0),), 2)


def _base(rows: Sequence[Mapping[str, Any]]) -> Chart:
    """Chart the number of keyframes, that of those which were solved, and the error that their solution leaves."""
    known = [row.get("base") or {} for row in rows]
    curves = (
        Curve("keyframes", _column(each.get("keyframes") for each in known), 0),
        Curve("solved", _column(each.get("solved") for each in known), 1),
        Curve("tips, mm", _column(each.get("tip_mm") for each in known), 2),
    )
    note = "Keyframes kept, those of the last solution, and the error of the tips that it leaves."
    return Chart("base", "Keyframes, and how far the base is known", note, curves, 1)


def _middles(rows: Sequence[Mapping[str, Any]]) -> Float64:
    """Return the mean of the tips in each frame, (F, 3) m, NaN without."""
    return np.array([np.mean(row["tips"], axis=0) if row["tips"] else [np.nan] * 3 for row in rows]).reshape(-1, 3)


def _column(values: Iterator[float | None]) -> Float64:
    """Return values (F,), NaN for None."""
    return np.array([np.nan if value is None else value for value in values], dtype=np.float64)
