"""Edges that an image shows near an outline, and what is done with them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Float64 = NDArray[np.float64]

_OWN_VARIANCE = 0.25  # px^2, of an edge's place, where two kinds of evidence are weighed


@dataclass(frozen=True, eq=False)
class EdgeDistances:
    """Distances (N,), px, by which outline points lie outside the edge that was found, and whether one was, (N,).

    ``variance`` (N,), px^2, is that of the edge's place beyond the running variance of all edges.
    """

    distance: Float64
    found: NDArray[np.bool_]
    variance: Float64

    @staticmethod
    def joined(parts: Sequence[EdgeDistances]) -> EdgeDistances:
        """Return the distances of several groups of points, one after another."""
        return EdgeDistances(
            np.concatenate([part.distance for part in parts]),
            np.concatenate([part.found for part in parts]),
            np.concatenate([part.variance for part in parts]),
        )

    def with_other(self, other: EdgeDistances) -> EdgeDistances:
        """Return the edges of the same points that are in either of two kinds of evidence; of both, their mean."""
        shares = [edges.found / (_OWN_VARIANCE + edges.variance) for edges in (self, other)]
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
