"""Edges that an image shows near an outline, and what is done with them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.evidence.quantiles import NORMAL_MEDIAN, median

Float64 = NDArray[np.float64]

OWN_VARIANCE: Final = 0.25
"""px^2, variance of the edges of either kind of evidence, until poses have told more of it."""


@dataclass(frozen=True, eq=False)
class EdgeDistances:
    """Distances (N,), px, by which outline points lie outside the edge that was found, and whether one was, (N,).

    ``variance`` (N,), px^2, is that of the edge's place beyond the running variance of all edges.
    """

    distance: Float64
    found: NDArray[np.bool_]
    variance: Float64

    @property
    def robust_variance(self) -> float | None:
        """Variance, px^2, of the distances that were found, by their median absolute value; None without any."""
        return (NORMAL_MEDIAN * median(np.abs(self.distance[self.found]))) ** 2 if self.found.any() else None

    @staticmethod
    def joined(parts: Sequence[EdgeDistances]) -> EdgeDistances:
        """Return the distances of several groups of points, one after another."""
        return EdgeDistances(
            np.concatenate([part.distance for part in parts]),
            np.concatenate([part.found for part in parts]),
            np.concatenate([part.variance for part in parts]),
        )

    def with_other(self, other: EdgeDistances, own: tuple[float, float]) -> EdgeDistances:
        """Return the edges of the same points that are in either of two kinds of evidence; of both, their mean.

        ``own``, px^2, are the variances of the two kinds of edges beyond those of single points.
        """
        shares = [edges.found / (kind + edges.variance) for edges, kind in zip((self, other), own, strict=True)]
        total = np.maximum(shares[0] + shares[1], 1e-12)
        mean = (shares[0] * self.distance + shares[1] * other.distance) / total
        apart = np.where(self.found & other.found, (self.distance - other.distance) ** 2 / 4, 0.0)
        variance = np.where(self.found, np.where(other.found, 0.0, self.variance), other.variance)
        return EdgeDistances(mean, self.found | other.found, variance + apart)


@dataclass(frozen=True)
class Pass:
    """What is done after one drawing of the outline: ``steps`` of the correction, by edges within ``reach`` px."""

    reach: float
    steps: int
