"""Lag of the images behind the readings, found while following.

For each lag of a grid, the base that makes the arm's readings agree best with the poses followed lately is solved for
in closed form; the lag is where the remaining disagreement is least. Rotation about the shaft does not count, since the
play of roll's cables looks like a lag. The disagreement is linear in the entries of the base's pose, so that of many
poses only the sum of their squares is needed.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.geometry import inverse

Float64 = NDArray[np.float64]

LAGS = np.arange(-6, 31) / 90.0
"""Lags that are compared, (L,) s."""

_KEPT = 150  # poses
_LEAST = 12  # poses before the first search
_EVERY = 6  # poses between searches
_SIGMA = np.array([3e-4, 3e-4, 6e-4, 5e-3, 5e-3])  # m and rad, least of a pose along its axes and of its z axis
_AROUND = 3  # steps of the grid on either side of the best one, through which a parabola is laid
_TOGETHER = 12.0  # consecutive poses that count as one, since their errors are alike
_LARGEST_STD = 0.012  # s, above which a lag is not determined
_LEAST_GAIN = 8.0  # of the sum of squares, from the ends of the grid to the best lag


@dataclass(frozen=True)
class FoundLag:
    """A lag and its standard deviation, s."""

    seconds: float
    std: float


class LagSearch:
    """Finds the lag from the latest poses followed; ``base_from_root`` maps outer readings (..., 4) to poses."""

    def __init__(self, base_from_root: Callable[[Float64], Float64]) -> None:
        self._base_from_root = base_from_root
        self._poses: deque[Float64] = deque(maxlen=_KEPT)
        self._outer: deque[Float64] = deque(maxlen=_KEPT)
        self._sigmas: deque[Float64] = deque(maxlen=_KEPT)
        self._squares: deque[Float64] = deque(maxlen=_KEPT // _EVERY)  # of each block of poses
        self._count = 0

    def clear(self) -> None:
        """Forget all poses, for example because the base moved."""
        self._poses.clear()
        self._outer.clear()
        self._sigmas.clear()
        self._squares.clear()
        self._count = 0

    def add(self, pose: Float64, covariance: Float64, outer: Float64) -> None:
        """Add the root's pose (4, 4) of an image, its covariance (6, 6), and the outer readings (L, 4) at all lags."""
        if np.isnan(outer).any():
            return
        self._poses.append(pose)
        self._outer.append(outer)
        self._sigmas.append(np.sqrt(np.diag(covariance)[:5] + _SIGMA**2))
        self._count += 1
        if self._count % _EVERY == 0:
            self._squares.append(self._squares_of(len(self._poses) - _EVERY))

    def checkpoint(self) -> dict[str, Any]:
        """Return the poses so far as plain values."""
        parts = {"poses": self._poses, "outer": self._outer, "sigmas": self._sigmas}
        return {"count": self._count} | {name: [one.tolist() for one in values] for name, values in parts.items()}

    def restore(self, saved: Mapping[str, Any]) -> None:
        """Go on with the poses of a checkpoint."""
        self.clear()
        for name, values in (("poses", self._poses), ("outer", self._outer), ("sigmas", self._sigmas)):
            values.extend(np.array(one, dtype=np.float64) for one in saved[name])
        self._count = int(saved["count"])
        blocks, rest = divmod(len(self._poses) - self._count % _EVERY, _EVERY)
        self._squares.extend(self._squares_of(rest + k * _EVERY) for k in range(blocks))

    @property
    def due(self) -> bool:
        """Whether enough poses were added since the last search."""
        return len(self._poses) >= _LEAST and self._count % _EVERY == 0

    def search(self, camera_from_base: Float64) -> FoundLag | None:
        """Return the lag; None if the motion so far does not determine it. ``camera_from_base`` (4, 4) is a guess."""
        costs = self._costs(camera_from_base)
        best = int(np.argmin(costs))
        if not _AROUND <= best < len(LAGS) - _AROUND or min(costs[0], costs[-1]) - costs[best] < _LEAST_GAIN:
            return None
        near = slice(best - _AROUND, best + _AROUND + 1)
        half, slope, _ = np.polyfit(LAGS[near] - LAGS[best], costs[near], 2)
        if half <= 0:
            return None
        freedom = 5 * len(self._poses) / _TOGETHER
        std = float(np.sqrt(max(2 * costs[best] / freedom, 1.0) / (2 * half)))
        return None if std > _LARGEST_STD else FoundLag(float(LAGS[best] - slope / (2 * half)), std)

    def _costs(self, camera_from_base: Float64) -> Float64:
        """Compute half the sum of squares that remains at each lag of the grid, (L,)."""
        squares = np.sum(self._squares, axis=0)
        entries, motion = _entries(camera_from_base)
        information = motion.T @ squares @ motion + 1e-6 * np.eye(6)
        off = squares @ entries
        slope = off @ motion
        gain = np.einsum("lj,lj->l", slope, np.linalg.solve(information, slope[..., None])[..., 0])
        return np.asarray((off @ entries - gain) / (2 * _TOGETHER))

    def _squares_of(self, first: int) -> Float64:
        """Return the matrices (L, 13, 13) of the sum of squares of a block of poses by the entries of `_entries`.

        The block begins with the kept pose number ``first``.
        """
        index = range(first, first + _EVERY)
        pose, sigma = (np.array([values[k] for k in index])[:, None] for values in (self._poses, self._sigmas))
        root = self._base_from_root(np.array([self._outer[k] for k in index]))  # (N, L, 4, 4)
        back, position = root[..., :3, :3].swapaxes(-1, -2), root[..., :3, 3:]
        # position of the root and direction of the shaft; to first order, that of z is a rotation about -y and x
        off = np.zeros((*root.shape[:2], 5, 13))
        off[..., :3, :9] = (back[..., None] * pose[..., None, None, :3, 3]).reshape(*root.shape[:2], 3, 9)
        off[..., :3, 9:12], off[..., :3, 12:] = back, -back @ position
        turned = (back[..., :2, :, None] * pose[..., None, None, :3, 2]).reshape(*root.shape[:2], 2, 9)
        off[..., 3, :9], off[..., 4, :9] = -turned[..., 1, :], turned[..., 0, :]
        off /= sigma[..., None]
        each = off.swapaxes(0, 1).reshape(len(LAGS), -1, 13)
        return np.asarray(each.swapaxes(1, 2) @ each)


def _entries(camera_from_base: Float64) -> tuple[Float64, Float64]:
    """Return the entries (13,) of base_from_camera, by rows, then its position, then 1, and their rates (13, 6).

    The rates are those by small changes of the base.
    """
    pose = inverse(camera_from_base)
    motion = np.zeros((13, 6))
    motion[9:12, :3] = -np.eye(3)
    for axis in range(3):
        turn = np.cross(np.eye(3)[axis], pose[:3], axisb=0, axisc=0)  # (3, 4)
        motion[:9, 3 + axis], motion[9:12, 3 + axis] = -turn[:, :3].ravel(), -turn[:, 3]
    return np.concatenate([pose[:3, :3].ravel(), pose[:3, 3], [1.0]]), motion
