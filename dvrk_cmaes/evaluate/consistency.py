"""How well the frames of a session agree, without any truth: what must be one and the same in all of them.

While the arm moves about its remote centre of motion (RCM), the shaft passes through one point. So the axes of all
frames should meet (the paper's Table I, from poses alone); the RCM that each frame's axis and insertion give, and with
all outer readings the arm's base, should be the same in every frame. A pose may be consistent and wrong all the same:
frames solved together agree by construction.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dvrk_cmaes.errors import InputError
from dvrk_cmaes.geometry import inverse, rotation_angle
from dvrk_cmaes.instrument.arm import INSERTION_OFFSET, ROLL_OFFSET, Arm, base_from_root

Float64 = NDArray[np.float64]

FEWEST = 3
"""Frames below which a spread says nothing."""

_LEAST_SPREAD = 1e-6  # of the axes' directions: smallest eigenvalue of the mean of I - d d^T


@dataclass(frozen=True, eq=False)
class Convergence:
    """Where N axes meet, and how nearly.

    point : (3,) x*, the point nearest to all axes, m in the camera.
    distances : (N,) of x* from each axis, perpendicular to it, m.
    turn : root mean square angle of the axes from their mean direction, rad. Axes that hardly turn fix x* only across
    them: it slides along.
    """

    point: Float64
    distances: Float64
    turn: float

    @property
    def sigma(self) -> float:
        """Standard deviation of the distances, m: the figure of the paper's Table I.

        It forgives a constant distance; `rms` does not.
        """
        return float(self.distances.std())

    @property
    def rms(self) -> float:
        """Root mean square of the distances, m."""
        return float(np.sqrt(np.mean(self.distances**2)))


@dataclass(frozen=True, eq=False)
class PointSpread:
    """Points (N, 3), m, that should be one.

    ``centre`` (3,) is their mean, ``rms`` their root mean square distance from it, m.
    """

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
    """Poses of the arm's base that should be one: ``camera_from_base`` (N, 4, 4).

    ``angles`` (N,), rad: of each frame's rotation from that of the most central frame, the one with the smallest sum.
    """

    camera_from_base: Float64
    angles: Float64

    @property
    def angles_deg(self) -> Float64:
        """Angles in degrees, (N,)."""
        return np.degrees(self.angles)

    @property
    def median_deg(self) -> float:
        """Median angle from the most central frame, that frame included, degrees."""
        return float(np.median(self.angles_deg))

    @property
    def largest_deg(self) -> float:
        """Largest angle from the most central frame, degrees."""
        return float(self.angles_deg.max())


def converge(points: ArrayLike, directions: ArrayLike) -> Convergence:
    """Find where axes meet: x* = (N I - sum d d^T)^-1 sum (I - d d^T) p (the paper's Table I).

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
    if len(p) < FEWEST:
        raise InputError(f"axes: expected those of at least {FEWEST} frames, got {len(p)}")
    across = np.eye(3) - d[:, :, None] * d[:, None, :]
    if np.linalg.eigvalsh(across.mean(axis=0))[0] < _LEAST_SPREAD:
        raise InputError("axes: expected a shaft that turned between the frames, got parallel axes, which meet nowhere")
    meeting = np.linalg.solve(across.sum(axis=0), np.einsum("nij,nj->i", across, p))
    aside = np.linalg.norm(np.einsum("nij,nj->ni", across, meeting - p), axis=1)
    mean = d.mean(axis=0) / np.linalg.norm(d.mean(axis=0))
    turn = np.arctan2(np.linalg.norm(np.cross(d, mean), axis=1), d @ mean)
    return Convergence(meeting, aside, float(np.sqrt(np.mean(turn**2))))


def converge_shafts(camera_from_root: Float64) -> Convergence:
    """Find where the shafts' axes of poses (N, 4, 4) meet: the root's z axis through its origin; as `converge`."""
    return converge(camera_from_root[:, :3, 3], camera_from_root[:, :3, 2])


def rcm_spread(
    camera_from_root: Float64, insertion: ArrayLike, arm: Arm = "classic", *, roll_offset: float = ROLL_OFFSET
) -> PointSpread:
    """Find the RCM of each frame in the camera, from its pose (N, 4, 4) and the insertion read, (N,) m.

    ``roll_offset`` is the D of the tool's roll joint, m.
    """
    beyond = np.asarray(insertion, dtype=np.float64) + INSERTION_OFFSET[arm] + roll_offset
    return PointSpread(camera_from_root[:, :3, 3] - beyond[:, None] * camera_from_root[:, :3, 2])


def base_spread(
    camera_from_root: Float64, outer: ArrayLike, arm: Arm = "classic", *, roll_offset: float = ROLL_OFFSET
) -> BaseSpread:
    """Find the arm's base in each frame, from its pose (N, 4, 4) and the outer readings (N, 4), rad and m."""
    reached = base_from_root(outer, arm, roll_offset=roll_offset)
    return spread_of_bases(np.asarray(camera_from_root @ inverse(reached)))


def spread_of_bases(camera_from_base: Float64) -> BaseSpread:
    """Compare the arm's bases of frames, (N, 4, 4), with the most central of them."""
    apart = rotation_angle(camera_from_base[:, None], camera_from_base[None, :])
    return BaseSpread(camera_from_base, apart[int(apart.sum(axis=1).argmin())])
