"""The page's plots of the tips: their place in the camera over time, or over the frames, and their speed over time."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from dvrk_cmaes.report.plots.axes import frame_axis, value_axis
from dvrk_cmaes.report.plots.panels import SHAPES, Mark, Panel, Plot, Series, mark_size
from dvrk_cmaes.results.result import Result

_LEAST_SPAN = 1.0  # mm
_COLOURS = (1, 2, 0)  # of x, y and z, as in the overlays
_LEAST_SPEED = 1.0  # mm/s, least length of the axis


def tips_plot(results: Sequence[Result]) -> Plot | None:
    """Plot the mean position of the tips, mm from its median over the frames; None for fewer than two frames with tips.

    The series are the camera's axes x, y and z; bars are their standard deviations.
    """
    places = [place for place, result in enumerate(results) if result.tips]
    if len(places) < 2:
        return None
    middles = np.array([1e3 * np.mean(results[place].tips, axis=0) for place in places])
    off = middles - np.median(middles, axis=0)
    across, at = frame_axis(results, end=696)
    span = max(float(np.ptp(off)), _LEAST_SPAN)
    up = value_axis("tips, mm from their median", float(off.min()), float(off.min()) + span, start=276, end=14)
    series = []
    for k, axis in enumerate("xyz"):
        marks, bars = [], []
        for place, value in zip(places, off[:, k].tolist(), strict=True):
            x = across.at(at[place])
            marks.append(Mark(place, x, up.at(value), results[place].status == "ok"))
            expected = results[place].expected_error
            axes = None if expected is None else expected.tip_axes_mm.get("mean", expected.tip_axes_mm.get("tip"))
            if axes is not None:
                bars.append((x, up.clamped(value + float(axes[k])), up.clamped(value - float(axes[k]))))
        series.append(Series(axis, SHAPES[k], tuple(marks), tuple(bars), colour=_COLOURS[k]))
    return Plot("tips", mark_size(len(results)), (Panel(720, 330, across, up, tuple(series), zero=up.clamped(0.0)),))


def speed_plot(results: Sequence[Result]) -> Plot | None:
    """Plot the tips' speed in the camera, mm/s, over time; None without two frames with tips at different known times.

    It is the distance of the mean of the tips from that of the frame with tips before, in the order of time, divided
    by the time between them. Motion in between is not seen, so it is a lower bound.
    """
    known = sorted(
        (result.time, place) for place, result in enumerate(results) if result.tips and result.time is not None
    )
    across, at = frame_axis(results, end=696)
    pairs = [(a, b, until - since) for (since, a), (until, b) in pairwise(known) if until > since]
    if not pairs or any(result.time is None for result in results):
        return None
    middles = {place: 1e3 * np.mean(results[place].tips, axis=0) for _, place in known}
    speeds = [float(np.linalg.norm(middles[b] - middles[a])) / seconds for a, b, seconds in pairs]
    up = value_axis("speed of the tips, mm/s", 0.0, max(*speeds, _LEAST_SPEED), start=276, end=14)
    marks = tuple(
        Mark(b, across.at(at[b]), up.at(speed), results[a].status == "ok" and results[b].status == "ok")
        for (a, b, _), speed in zip(pairs, speeds, strict=True)
    )
    return Plot("speed", mark_size(len(results)), (Panel(720, 330, across, up, (Series("speed", SHAPES[0], marks),)),))
