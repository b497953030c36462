"""Figure of the shafts' axes and of the point where they should meet: one overview and one close-up for each set."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from dvrk_cmaes.draw.figure import new_figure
from dvrk_cmaes.evaluate.agreement import Agreement
from dvrk_cmaes.geometry import Float64

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_AXIS: Final = "#33658a"
_MEETING: Final = "#c1121f"
_RCM: Final = "#2a9d8f"
_MARGIN: Final = 0.08  # on each side, as a fraction of the larger extent
_SHAPE: Final = 1.27  # width of a panel by its height
_GAP: Final = 1.0  # px between names
_POINT: Final = 2.5  # half size of a point that names must not cover, px
_BESIDE: Final = (
    ("left", 4, 6),
    ("left", 5, 0),
    ("left", 4, -6),
    ("right", -4, 6),
    ("right", -5, 0),
    ("right", -4, -6),
    ("center", 0, 9),
    ("center", 0, -9),
)
"""Places of a name beside its point: horizontal alignment and distances to the right and up, in points."""
_BEYOND: Final = 0.25  # length drawn beyond x*, as a fraction of the distance from the root to x*


def draw_axes(sets: Sequence[Agreement]) -> Figure:
    """Draw a row for each set: its axes in the plane of their largest scatter, and their distances from x*, mm.

    All rows have the same view and the same scales, so that they can be compared.
    """
    view = _common_view(sets)
    rows = [_PictureRow.of(agreement, view) for agreement in sets]
    figure = new_figure(11.0, 4.6 * len(sets))
    panels = figure.subplots(len(sets), 2, squeeze=False)
    for row, (whole, close) in zip(rows, panels, strict=True):
        _draw_whole(whole, row)
        _draw_close(close, row)
    _share_limits(panels[:, 0], np.concatenate([row.far for row in rows]))
    _share_limits(panels[:, 1], np.concatenate([row.near for row in rows]))
    for close in panels[:, 1]:
        close.legend(fontsize=7, loc="best")
    figure.draw_without_rendering()  # lays the panels out, so that the places of names are known, ...
    figure.set_layout_engine("none")  # and does not change when the picture is written
    for row, close in zip(rows, panels[:, 1], strict=True):
        _name_points(close, row)
    return figure


@dataclass(frozen=True, eq=False)
class _PictureRow:
    """What is drawn of a set, (.., 2) mm about x*.

    starts, roots : (N, 2) ends of the axes' parts drawn, in the plane of the view. eye : (2,) the camera.
    nearest : (N, 2) points of the axes nearest to x*, seen along the view. rcm : (N, 2) RCMs, None if not known.
    """

    agreement: Agreement
    starts: Float64
    roots: Float64
    eye: Float64
    nearest: Float64
    rcm: Float64 | None

    @staticmethod
    def of(agreement: Agreement, view: Float64) -> _PictureRow:
        """Project a set; ``view`` (2, 3) are the directions along and across."""
        plane = np.stack([view[1], np.cross(view[0], view[1])])
        poses, meeting = agreement.results.camera_from_root, agreement.axes.point
        off, directions = poses[:, :3, 3] - meeting, poses[:, :3, 2]
        roots = 1e3 * off @ view.T
        starts = roots - (1 + _BEYOND) * np.linalg.norm(roots, axis=1, keepdims=True) * (directions @ view.T)
        nearest = off - (off * directions).sum(axis=1, keepdims=True) * directions
        rcm = None if agreement.rcm is None else 1e3 * (agreement.rcm.points - meeting) @ plane.T
        return _PictureRow(agreement, starts, roots, -1e3 * view @ meeting, 1e3 * nearest @ plane.T, rcm)

    @property
    def far(self) -> Float64:
        """All points of the overview, (M, 2)."""
        return np.concatenate([self.starts, self.roots, self.eye[None], np.zeros((1, 2))])

    @property
    def near(self) -> Float64:
        """All points of the close-up, (M, 2), with the ends of its larger circle."""
        reach = 1e3 * self.agreement.axes.rms
        circle = reach * np.array([[1, 0], [-1, 0], [0, 1], [0, -1]])
        return np.concatenate([self.nearest, circle, *([] if self.rcm is None else [self.rcm])])


def _common_view(sets: Sequence[Agreement]) -> Float64:
    """Return two orthonormal vectors (2, 3): all axes' mean direction, and the direction of their largest scatter."""
    directions = np.concatenate([agreement.results.camera_from_root[:, :3, 2] for agreement in sets])
    along = directions.mean(axis=0)
    along /= np.linalg.norm(along)
    across = np.linalg.svd(directions - np.outer(directions @ along, along))[2][0]
    across -= (across @ along) * along
    return np.stack([along, across / np.linalg.norm(across)])


def _share_limits(panels: Iterable[Axes], points: Float64) -> None:
    """Give panels the same limits and scale, with a margin about points (N, 2) in which labels are not cut off."""
    low, high = points.min(axis=0), points.max(axis=0)
    margin = _MARGIN * float((high - low).max())
    low, high = low - margin, high + margin * np.array([2.0, 1.0])  # labels are to the right of their points
    half = np.array([_SHAPE, 1.0]) * max(float((high - low)[0]) / _SHAPE, float((high - low)[1])) / 2
    middle = (low + high) / 2
    for panel in panels:
        panel.set_xlim(middle[0] - half[0], middle[0] + half[0])
        panel.set_ylim(middle[1] - half[1], middle[1] + half[1])
        panel.set_aspect("equal", adjustable="box")


def _draw_whole(panel: Axes, row: _PictureRow) -> None:
    """Draw the axes from beyond x* to the root links, in mm relative to x*, and the camera."""
    for start, root in zip(row.starts, row.roots, strict=True):
        panel.plot([start[0], root[0]], [start[1], root[1]], color=_AXIS, linewidth=0.9, alpha=0.8)
        panel.plot(*root, "o", color=_AXIS, markersize=3.5)
    panel.plot(*row.eye, "s", color="black", markersize=6)
    panel.annotate("camera", (row.eye[0], row.eye[1]), textcoords="offset points", xytext=(7, 4), fontsize=8)
    panel.plot(0, 0, "+", color=_MEETING, markersize=14, markeredgewidth=2)
    panel.set_xlabel("along the mean axis from x*, mm")
    panel.set_ylabel("across, mm")
    results = row.agreement.results
    panel.set_title(f"{results.name}: {len(results.frames)} frames solved {results.solved}", fontsize=9, wrap=True)
    panel.grid(alpha=0.25)


def _draw_close(panel: Axes, row: _PictureRow) -> None:
    """Draw the nearest point of each axis to x*, seen along the mean axis, and circles of radius sigma and rms."""
    from matplotlib.patches import Circle

    panel.plot(*row.nearest.T, "o", color=_AXIS, markersize=4)
    if row.rcm is not None:
        panel.plot(*row.rcm.T, "x", color=_RCM, markersize=4, label="RCM from axis and insertion")
    panel.plot(0, 0, "+", color=_MEETING, markersize=14, markeredgewidth=2, label="x*")
    sigma, rms = 1e3 * row.agreement.axes.sigma, 1e3 * row.agreement.axes.rms
    panel.add_patch(Circle((0, 0), rms, fill=False, color=_MEETING, linewidth=1, label=f"rms {rms:.2f} mm"))
    panel.add_patch(
        Circle((0, 0), sigma, fill=False, color=_MEETING, linewidth=1, linestyle=":", label=f"sigma {sigma:.2f} mm")
    )
    panel.set_xlabel("mm")
    panel.set_title("nearest points of the axes, seen along them", fontsize=9)
    panel.grid(alpha=0.25)


def _name_points(panel: Axes, row: _PictureRow) -> None:
    """Write the names of frames beside their nearest points where they cover no other name or point, outermost first.

    The panel must have its final size. Where not all names have a place, the title says how many do.
    """
    from matplotlib.transforms import Bbox

    points = panel.transData.transform(row.nearest)
    taken = [Bbox.from_bounds(u - _POINT, v - _POINT, 2 * _POINT, 2 * _POINT) for u, v in points.tolist()]
    legend = panel.get_legend()
    if legend is not None:
        taken.append(legend.get_window_extent())
    named = 0
    frames = row.agreement.results.frames
    for index in np.argsort(-np.linalg.norm(row.nearest, axis=1), kind="stable").tolist():
        for aside, across, up in _BESIDE:
            text = panel.annotate(
                frames[index],
                (float(row.nearest[index, 0]), float(row.nearest[index, 1])),
                textcoords="offset points",
                xytext=(across, up),
                fontsize=7,
                color=_AXIS,
                ha=aside,
                va="center",
            )
            text.set_in_layout(False)
            box = text.get_window_extent()
            inside = panel.bbox.x0 <= box.x0 and box.x1 <= panel.bbox.x1
            inside &= bool(panel.bbox.y0 <= box.y0 and box.y1 <= panel.bbox.y1)
            if inside and not any(box.padded(_GAP).overlaps(other) for other in taken):
                taken.append(box)
                named += 1
                break
            text.remove()
    if named < len(frames):
        panel.set_title(f"{panel.get_title()}; {named} of {len(frames)} named", fontsize=9)
