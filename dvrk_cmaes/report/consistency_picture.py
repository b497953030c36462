"""Figure of the shafts' axes and of the point where they should meet: an overview and a close-up for each set."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from dvrk_cmaes.evaluate.agreement import Agreement
from dvrk_cmaes.geometry import Float64
from dvrk_cmaes.report.curves import Chart, Curve, chart_svg, stacked

_BEYOND: Final = 0.25  # length drawn beyond x*, as a fraction of the distance from the root to x*
_SIZE: Final = 560, 420  # px, of a panel without its legend
_LEGEND: Final = 40  # px


def draw_axes(sets: Sequence[Agreement]) -> str:
    """Draw a row for each set as SVG: its axes in the plane of their largest scatter, and their distances from x*, mm.

    All rows have the same view.
    """
    view = _common_view(sets)
    drawn = [[chart_svg(chart, *_SIZE) for chart in _charts(agreement, view)] for agreement in sets]
    return stacked(drawn, _SIZE[0], _SIZE[1] + _LEGEND)


def _common_view(sets: Sequence[Agreement]) -> Float64:
    """Return two orthonormal vectors (2, 3): all axes' mean direction, and the direction of their largest scatter."""
    directions = np.concatenate([agreement.results.camera_from_root[:, :3, 2] for agreement in sets])
    along = directions.mean(axis=0)
    along /= np.linalg.norm(along)
    across = np.linalg.svd(directions - np.outer(directions @ along, along))[2][0]
    across -= (across @ along) * along
    return np.stack([along, across / np.linalg.norm(across)])


def _charts(agreement: Agreement, view: Float64) -> tuple[Chart, Chart]:
    """Return the overview and the close-up of a set, in mm about x*; ``view`` (2, 3) is along and across."""
    results, meeting = agreement.results, agreement.axes.point
    off, directions = results.camera_from_root[:, :3, 3] - meeting, results.camera_from_root[:, :3, 2]
    roots = 1e3 * off @ view.T
    starts = roots - (1 + _BEYOND) * np.linalg.norm(roots, axis=1, keepdims=True) * (directions @ view.T)
    lines = np.stack([starts, roots, np.full_like(roots, np.nan)], axis=1).reshape(-1, 2)
    eye = -1e3 * view @ meeting
    whole = [
        Curve("shafts", lines[:, 0], lines[:, 1]),
        Curve("root links", roots[:, 0], roots[:, 1], points=True, frames=results.frames, colour=0),
        Curve("x*", np.zeros(1), np.zeros(1), points=True, colour=1),
        Curve("camera", eye[:1], eye[1:], points=True, colour=5),
    ]
    plane = np.stack([view[1], np.cross(view[0], view[1])])
    nearest = 1e3 * (off - (off * directions).sum(axis=1, keepdims=True) * directions) @ plane.T
    close = [Curve("nearest points of the axes", nearest[:, 0], nearest[:, 1], points=True, frames=results.frames)]
    if agreement.rcm is not None:
        rcm = 1e3 * (agreement.rcm.points - meeting) @ plane.T
        close.append(Curve("RCM from axis and insertion", rcm[:, 0], rcm[:, 1], points=True, colour=2))
    turn = np.linspace(0, 2 * np.pi, 91)
    for name, radius, colour in (("rms", agreement.axes.rms, 1), ("sigma", agreement.axes.sigma, 3)):
        ring = 1e3 * radius * np.stack([np.cos(turn), np.sin(turn)])
        close.append(Curve(f"{name} {1e3 * radius:.2f} mm", ring[0], ring[1], colour=colour))
    title = f"{results.name}: {len(results.frames)} frames solved {results.solved}"
    return (
        Chart(title, f"{title}: along the mean axis from x*, mm", "across, mm", whole, equal=True),
        Chart(title, "about x*, seen along the axes, mm", "mm", close, equal=True),
    )
