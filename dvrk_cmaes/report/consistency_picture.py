"""Figure of the shafts' axes and of the point where they should meet: one overview and one close-up for each set."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.draw.figure import new_figure
from dvrk_cmaes.evaluate.agreement import Agreement

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Float64 = NDArray[np.float64]

_AXIS: Final = "#33658a"
_MEETING: Final = "#c1121f"
_RCM: Final = "#2a9d8f"
_BEYOND: Final = 0.25  # length drawn beyond x*, as a fraction of the distance from the root to x*


def draw_axes(sets: Sequence[Agreement]) -> Figure:
    """Draw a row for each set: its axes in the plane of their largest scatter, and their distances from x*, mm."""
    figure = new_figure(11.0, 4.6 * len(sets))
    panels = figure.subplots(len(sets), 2, squeeze=False)
    for agreement, (whole, close) in zip(sets, panels, strict=True):
        _draw_whole(whole, agreement)
        _draw_close(close, agreement)
    return figure


def _view(agreement: Agreement) -> Float64:
    """Return two orthonormal vectors (2, 3): the axes' mean direction, and the direction of their largest scatter."""
    directions = agreement.results.camera_from_root[:, :3, 2]
    along = directions.mean(axis=0)
    along /= np.linalg.norm(along)
    across = np.linalg.svd(directions - np.outer(directions @ along, along))[2][0]
    across -= (across @ along) * along
    return np.stack([along, across / np.linalg.norm(across)])


def _draw_whole(panel: Axes, agreement: Agreement) -> None:
    """Draw the axes from beyond x* to the root links, in mm relative to x*, and the camera."""
    view, meeting = _view(agreement), agreement.axes.point
    poses = agreement.results.camera_from_root
    for pose in poses:
        root = 1e3 * view @ (pose[:3, 3] - meeting)
        direction = view @ pose[:3, 2]
        start = root - (1 + _BEYOND) * np.linalg.norm(root) * direction
        panel.plot([start[0], root[0]], [start[1], root[1]], color=_AXIS, linewidth=0.9, alpha=0.8)
        panel.plot(*root, "o", color=_AXIS, markersize=3.5)
    eye = -1e3 * view @ meeting
    panel.plot(*eye, "s", color="black", markersize=6)
    panel.annotate("camera", (eye[0], eye[1]), textcoords="offset points", xytext=(7, 4), fontsize=8)
    panel.plot(0, 0, "+", color=_MEETING, markersize=14, markeredgewidth=2)
    panel.set_aspect("equal", adjustable="datalim")
    panel.set_xlabel("along the mean axis from x*, mm")
    panel.set_ylabel("across, mm")
    results = agreement.results
    panel.set_title(f"{results.name}: {len(results.frames)} frames solved {results.solved}", fontsize=9)
    panel.grid(alpha=0.25)


def _draw_close(panel: Axes, agreement: Agreement) -> None:
    """Draw the nearest point of each axis to x*, seen along the mean axis, and circles of radius sigma and rms."""
    from matplotlib.patches import Circle

    view, meeting = _view(agreement), agreement.axes.point
    plane = np.stack([view[1], np.cross(view[0], view[1])])
    poses = agreement.results.camera_from_root
    off = poses[:, :3, 3] - meeting
    nearest = off - (off * poses[:, :3, 2]).sum(axis=1)[:, None] * poses[:, :3, 2]
    for frame, point in zip(agreement.results.frames, 1e3 * nearest @ plane.T, strict=True):
        panel.plot(*point, "o", color=_AXIS, markersize=4)
        panel.annotate(frame, (point[0], point[1]), textcoords="offset points", xytext=(4, 3), fontsize=7, color=_AXIS)
    if agreement.rcm is not None:
        points = 1e3 * (agreement.rcm.points - meeting) @ plane.T
        panel.plot(*points.T, "x", color=_RCM, markersize=4, label="RCM from axis and insertion")
    panel.plot(0, 0, "+", color=_MEETING, markersize=14, markeredgewidth=2, label="x*")
    sigma, rms = 1e3 * agreement.axes.sigma, 1e3 * agreement.axes.rms
    panel.add_patch(Circle((0, 0), rms, fill=False, color=_MEETING, linewidth=1, label=f"rms {rms:.2f} mm"))
    panel.add_patch(
        Circle((0, 0), sigma, fill=False, color=_MEETING, linewidth=1, linestyle=":", label=f"sigma {sigma:.2f} mm")
    )
    panel.set_aspect("equal", adjustable="datalim")
    panel.set_xlabel("mm")
    panel.set_title("nearest points of the axes, seen along them", fontsize=9)
    panel.legend(fontsize=7, loc="best")
    panel.grid(alpha=0.25)
