"""Consistency of a session's frames, measured without true poses.

The arm moves about its remote centre of motion (RCM), through which the shaft always passes. Hence in all frames of a
session (1) the shafts' axes should meet in one point (the paper's Table I, from poses alone), (2) the RCM computed from
the axis and the insertion should be the same, and (3) the pose of the arm's base, computed from all outer readings,
should be the same. Consistent poses may still be wrong: frames that were solved together are consistent by
construction.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from dvrk_cmaes.errors import InputError
from dvrk_cmaes.geometry import Float64, inverse, rotation_angle
from dvrk_cmaes.instrument.arm import INSERTION_OFFSET, ROLL_OFFSET, Arm, base_from_root

LEAST_FRAMES = 3
"""Least number of frames for a measure of consistency."""

_LEAST_SPREAD = 1e-6  # least eigenvalue of the mean of I - d d^T; axes with a smaller one are called parallel


@dataclass(frozen=True)
class TableOneRow:
    """Standard deviations of the axes' distances from their converging point, m: the paper's method, and PnP."""

    sigma_m: float
    pnp_sigma_m: float


TABLE_ONE: Final = {
    "easy": TableOneRow(0.00046, 0.05456),
    "medium": TableOneRow(0.00243, 0.06173),
    "hard": TableOneRow(0.00253, 0.06761),
}
"""Table I of the paper: Liang, Chiu, Richter and Yip, 2025, arXiv 2503.05953; ten frames each."""


@dataclass(frozen=True, eq=False)
class Convergence:
    """Point nearest to N axes in the least-squares sense, and its distances from them.

    point : (3,) x*, m in the camera's frame.
    distances : (N,) perpendicular distances of x* from the axes, m.
    turn : root mean square angle of the axes from their mean direction, rad. If it is small, x* is poorly determined
        along the axes.
    """

    point: Float64
    distances: Float64
    turn: float

    @property
    def sigma(self) -> float:
        """Standard deviation of the distances, m, as in the paper's Table I.

        Unlike `rms`, it is zero if all distances are equal.
        """
        return float(self.distances.std())

    @property
    def rms(self) -> float:
        """Root mean square of the distances, m."""
        return float(np.sqrt(np.mean(self.distances**2)))


@dataclass(frozen=True, eq=False)
class PointSpread:
    """Estimates (N, 3), m, of one point, and their scatter."""

    points: Float64

    @property
    def centre(self) -> Float64:
        """Mean of the points, (3,) m."""
        return np.asarray(self.points.mean(axis=0))

    @property
    def rms(self) -> float:
        """Root mean square distance from the mean, m."""
        return float(np.sqrt(((self.points - self.centre) ** 2).sum(axis=1).mean()))


@dataclass(frozen=True, eq=False)
class BaseSpread:
    """The scatter of the rotations of one pose of the arm's base in several frames.

    ``angles_deg`` (N,) are those between each frame's rotation and that of the most central frame, which is the frame
    with the smallest sum of angles to all others.
    """

    angles_deg: Float64

    @property
    def median_deg(self) -> float:
        """Median angle from the most central frame, that frame included, degrees."""
        return float(np.median(self.angles_deg))

    @property
    def largest_deg(self) -> float:
        """Largest angle from the most central frame, degrees."""
        return float(self.angles_deg.max())


def converge(points: ArrayLike, directions: ArrayLike) -> Convergence:
    """Find the point nearest to all axes: x* = (N I - sum d d^T)^-1 sum (I - d d^T) p (the paper's Table I).

    Parameters
    ----------
    points : (N, 3)
        A point p on each axis, m.
    directions : (N, 3)
        Unit vector d along each axis.

    Raises
    ------
    InputError
        Fewer than three axes, or axes that are all parallel.
    """
    p, d = np.asarray(points, dtype=np.float64), np.asarray(directions, dtype=np.float64)
    if len(p) < LEAST_FRAMES:
        raise InputError(f"axes: expected those of at least {LEAST_FRAMES} frames, got {len(p)}")
    across = np.eye(3) - d[:, :, None] * d[:, None, :]
    if np.linalg.eigvalsh(across.mean(axis=0))[0] < _LEAST_SPREAD:
        raise InputError("axes: expected a shaft that turned between the frames, got parallel axes, which meet nowhere")
    meeting = np.linalg.solve(across.sum(axis=0), np.einsum("nij,nj->i", across, p))
    aside = np.linalg.norm(np.einsum("nij,nj->ni", across, meeting - p), axis=1)
    mean = d.mean(axis=0) / np.linalg.norm(d.mean(axis=0))
    turn = np.arctan2(np.linalg.norm(np.cross(d, mean), axis=1), d @ mean)
    return Convergence(meeting, aside, float(np.sqrt(np.mean(turn**2))))


def converge_shafts(camera_from_root: Float64) -> Convergence:
    """Find the point nearest to the shafts' axes of poses (N, 4, 4), the root's z axes; errors as in `converge`."""
    return converge(camera_from_root[:, :3, 3], camera_from_root[:, :3, 2])


def rcm_spread(
    camera_from_root: Float64, insertion: ArrayLike, arm: Arm = "classic", *, roll_offset: float = ROLL_OFFSET
) -> PointSpread:
    """Compute the RCM of each frame in the camera's frame, from its pose (N, 4, 4) and its insertion reading (N,), m.

    ``roll_offset`` is the DH parameter d of the tool's roll joint, m.
    """
    beyond = np.asarray(insertion, dtype=np.float64) + INSERTION_OFFSET[arm] + roll_offset
    return PointSpread(camera_from_root[:, :3, 3] - beyond[:, None] * camera_from_root[:, :3, 2])


def base_spread(
    camera_from_root: Float64, outer: ArrayLike, arm: Arm = "classic", *, roll_offset: float = ROLL_OFFSET
) -> BaseSpread:
    """Compute the arm's base in each frame from its pose (N, 4, 4) and its outer readings (N, 4), rad and m."""
    reached = base_from_root(outer, arm, roll_offset=roll_offset)
    return spread_of_bases(np.asarray(camera_from_root @ inverse(reached)))


def spread_of_bases(camera_from_base: Float64) -> BaseSpread:
    """Compare the frames' poses of the arm's base (N, 4, 4) with that of the most central frame."""
    apart = rotation_angle(camera_from_base[:, None], camera_from_base[None, :])
    return BaseSpread(np.degrees(apart[int(apart.sum(axis=1).argmin())]))
