"""Plot of the shafts' axes of a session's frames, which meet at the remote centre of motion (RCM).

As in panels.py, coordinates in the drawing are computed here; the template makes the SVGs.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from dvrk_cmaes.calibration.document import SessionCalibration
from dvrk_cmaes.geometry import Float64
from dvrk_cmaes.report.plots.axes import SIDE, VIEWS, Axis, square_axes

_BEYOND = 0.15  # length drawn beyond the RCM, as a fraction of the distance from the root to the RCM
_FAR = 6.0  # multiple of the axes' median distance from the RCM; axes farther off do not extend the plot
_LEAST_REACH = 1.0  # mm, least half length of the plot's axes
_ARROW = 0.2  # length of the base's axes, as a fraction of the plot's half length
_SHORTEST, _NAME_BESIDE = 8.0, 8.0  # least length of a drawn base axis, and distance of its name from its end
_MANY = 60  # number of frames above which their axes are drawn fainter


@dataclass(frozen=True)
class ShaftLine:
    """A frame's shaft: index in the order of names, coordinates of its ends, and whether the calibration used it."""

    place: int
    start: tuple[float, float]
    end: tuple[float, float]
    used: bool


@dataclass(frozen=True)
class ShaftsView:
    """One view of the shafts' axes.

    ellipse : one standard deviation of the RCM: the two half axes, and the rotation, deg.
    camera : coordinates of the camera, None if it is outside or not drawn.
    base : for each of the base's axes its name, its end and the place of the name; axes that are nearly parallel to the
        viewing direction are omitted.
    """

    across: Axis
    up: Axis
    lines: tuple[ShaftLine, ...]
    rcm: tuple[float, float]
    ellipse: tuple[float, float, float]
    camera: tuple[float, float] | None = None
    base: tuple[tuple[str, tuple[float, float], tuple[float, float]], ...] = ()


@dataclass(frozen=True)
class ShaftsPlot:
    """Two views of all shafts, two views of the surroundings of the RCM, and whether there are many shafts."""

    far: tuple[ShaftsView, ...]
    near: tuple[ShaftsView, ...]
    many: bool


def shafts_plot(
    calibration: SessionCalibration, poses: Mapping[int, Float64], used: frozenset[int]
) -> ShaftsPlot | None:
    """Plot the shafts' axes of frames.

    Parameters
    ----------
    calibration
        The session's calibration.
    poses
        ``camera_from_root`` (4, 4) by index of the frame.
    used
        Indices of the frames that the calibration used.

    Returns
    -------
    ShaftsPlot or None
        None if no frame with a pose was used.
    """
    if not used & poses.keys():
        return None
    rcm = 1e3 * calibration.rcm
    origins = {place: 1e3 * pose[:3, 3] for place, pose in poses.items()}
    directions = {place: pose[:3, 2] for place, pose in poses.items()}
    length = {place: float(np.linalg.norm(origin - rcm)) for place, origin in origins.items()}
    ends = {
        place: (origins[place] - (1 + _BEYOND) * length[place] * directions[place], origins[place]) for place in poses
    }
    ours = np.stack([point for place in sorted(used & poses.keys()) for point in ends[place]])
    everything = np.concatenate([ours, [np.zeros(3)], [rcm]])
    low, high = everything.min(axis=0), everything.max(axis=0)
    base = calibration.camera_from_base[:3, :3]
    across_base = base @ calibration.covariance[:3, :3] @ base.T * 1e6  # of the RCM, mm^2, along the camera's axes
    lines = [(origins[place], directions[place]) for place in sorted(used & poses.keys())]
    away = np.array([np.linalg.norm(np.cross(rcm - origin, direction)) for origin, direction in lines])
    near = away[away <= max(_FAR * float(np.median(away)), _LEAST_REACH)]
    reach = max(_LEAST_REACH, 1.4 * float(near.max()), 3 * float(np.sqrt(np.linalg.eigvalsh(across_base)[-1])))

    def views(centre: Float64, reach: float, *, whole: bool) -> tuple[ShaftsView, ...]:
        return tuple(
            _view(label, column, centre, reach, ends, used, rcm, across_base, base if whole else None)
            for label, column in VIEWS
        )

    return ShaftsPlot(
        far=views((low + high) / 2, 0.6 * float((high - low).max()), whole=True),
        near=views(rcm, reach, whole=False),
        many=len(poses) > _MANY,
    )


def _view(
    label: str,
    column: int,
    centre: Float64,
    reach: float,
    ends: Mapping[int, tuple[Float64, Float64]],
    used: frozenset[int],
    rcm: Float64,
    covariance: Float64,
    base: Float64 | None,
) -> ShaftsView:
    across, up = square_axes(label, column, centre, reach)

    def at(point: Float64) -> tuple[float, float]:
        return across.at(float(point[column])), up.at(float(point[1]))

    lines = []
    for place, (start, end) in ends.items():
        inside = _clipped(np.array(at(start)), np.array(at(end)), (across.start, up.start), (across.end, up.end))
        if inside is not None:
            lines.append(ShaftLine(place, *inside, used=place in used))
    scale = SIDE / (across.high - across.low)
    values, vectors = np.linalg.eigh(covariance[np.ix_((column, 1), (column, 1))])
    half = scale * np.sqrt(np.maximum(values, 0))
    turn = float(np.degrees(np.arctan2(vectors[1, 1], vectors[0, 1])))
    seen = base is not None and across.contains(0.0) and up.contains(0.0)
    arrows = []
    for name, axis in zip("xyz", () if base is None else base.T, strict=False):
        away = scale * _ARROW * reach * axis[[column, 1]]
        drawn = float(np.linalg.norm(away))
        if drawn > _SHORTEST:
            end = np.array(at(rcm)) + away
            arrows.append((name, _pair(end), _pair(end + away / drawn * _NAME_BESIDE)))
    return ShaftsView(
        across=across,
        up=up,
        lines=tuple(sorted(lines, key=lambda line: (line.used, line.place))),
        rcm=at(rcm),
        ellipse=(float(half[1]), float(half[0]), turn),
        camera=at(np.zeros(3)) if seen else None,
        base=tuple(arrows),
    )


def _clipped(
    start: Float64, end: Float64, low: Sequence[float], high: Sequence[float]
) -> tuple[tuple[float, float], tuple[float, float]] | None:
    """Return the ends of the part of a line segment that lies in a rectangle, None if no part does."""
    along = end - start
    first, last = 0.0, 1.0
    for k in range(2):
        if abs(along[k]) < 1e-9:
            if not low[k] <= start[k] <= high[k]:
                return None
            continue
        enters, leaves = sorted(((low[k] - start[k]) / along[k], (high[k] - start[k]) / along[k]))
        first, last = max(first, float(enters)), min(last, float(leaves))
    if first >= last:
        return None
    return _pair(start + first * along), _pair(start + last * along)


def _pair(point: Float64) -> tuple[float, float]:
    return float(point[0]), float(point[1])
