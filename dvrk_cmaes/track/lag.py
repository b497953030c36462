"""Lag of the images behind the readings, found while following.

For each lag of a grid, the base that makes the arm's readings agree best with the poses followed lately is solved for
in closed form; the lag is where the remaining disagreement is least. Rotation about the shaft does not count, since the
play of roll's cables looks like a lag.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.geometry import adjoint, change_between, inverse

Float64 = NDArray[np.float64]

_GRID = np.arange(-6, 31) / 90.0  # s
_KEPT = 150  # poses
_LEAST = 12  # poses before the first search
_EVERY = 6  # poses between searches
_SIGMA = np.array([3e-4, 3e-4, 6e-4, 5e-3, 5e-3])  # m and rad, of a pose along and about the root's axes but its z
_TOGETHER = 4.0  # consecutive poses that count as one, since their errors are alike
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
        self._count = 0

    def clear(self) -> None:
        """Forget all poses, for example because the base moved."""
        self._poses.clear()
        self._outer.clear()
        self._count = 0

    def add(self, pose: Float64, outer_at: Callable[[Float64], Float64]) -> None:
        """Add the root's pose (4, 4) of an image; ``outer_at`` gives its outer readings (L, 4) at lags (L,)."""
        outer = outer_at(_GRID)
        if np.isnan(outer).any():
            return
        self._poses.append(pose)
        self._outer.append(outer)
        self._count += 1

    @property
    def due(self) -> bool:
        """Whether enough poses were added since the last search."""
        return len(self._poses) >= _LEAST and self._count % _EVERY == 0

    def search(self, camera_from_base: Float64) -> FoundLag | None:
        """Return the lag; None if the motion so far does not determine it. ``camera_from_base`` (4, 4) is a guess."""
        costs = self._costs(camera_from_base)
        best = int(np.argmin(costs))
        if best in (0, len(_GRID) - 1) or min(costs[0], costs[-1]) - costs[best] < _LEAST_GAIN:
            return None
        before, here, after = costs[best - 1 : best + 2]
        step = _GRID[1] - _GRID[0]
        curvature = (before - 2 * here + after) / step**2
        freedom = 5 * len(self._poses) / _TOGETHER
        spread = max(2 * here / freedom, 1.0)
        std = float(np.sqrt(spread / curvature)) if curvature > 0 else np.inf
        if std > _LARGEST_STD:
            return None
        return FoundLag(float(_GRID[best] + (before - after) / (2 * step * curvature)), std)

    def _costs(self, camera_from_base: Float64) -> Float64:
        """Compute half the sum of squares that remains at each lag of the grid, (L,)."""
        poses, outer = np.array(self._poses), np.array(self._outer)  # (N, 4, 4), (N, L, 4)
        root = self._base_from_root(outer)
        off = change_between(camera_from_base @ root, poses[:, None])[..., :5] / _SIGMA
        motion = adjoint(inverse(root))[..., :5, :] / _SIGMA[:, None]  # (N, L, 5, 6)
        information = np.einsum("nlij,nlik->ljk", motion, motion) + 1e-6 * np.eye(6)
        slope = np.einsum("nlij,nli->lj", motion, off)
        gain = np.einsum("lj,lj->l", slope, np.linalg.solve(information, slope[..., None])[..., 0])
        return np.asarray(((off**2).sum(axis=(0, 2)) - gain) / (2 * _TOGETHER))
