"""The readings of the joints and their limits as a term."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.geometry import Posed
from dvrk_cmaes.joints.prior import LIMIT_SIGMA, Readings
from dvrk_cmaes.pose.terms.term import Quadratic, Term

Float64 = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class ReadingsTerm(Term):
    """Deviations of the joints from their ``readings``, and beyond their limits."""

    readings: Readings

    def cost(self, at: Posed) -> Float64:
        """Return the sum of squares (C,)."""
        return self.readings.cost(at.joints)

    def local(self, at: Posed) -> Quadratic:
        """Return the approximation of half of it, which is exact but for the corners at the limits."""
        values, sigma = self.readings.values, self.readings.sigma
        known = ~np.isnan(values)
        weight, centre = np.where(known, 1 / sigma**2, 0.0), np.where(known, values, 0.0)
        quadratic = Quadratic.zero(len(at), 6 + len(values))
        low, high = self.readings.low - at.joints, at.joints - self.readings.high
        joints = range(6, 6 + len(values))
        quadratic.information[:, joints, joints] = weight + ((low > 0) | (high > 0)) / LIMIT_SIGMA**2
        quadratic.slope[:, 6:] = weight * (at.joints - centre)
        quadratic.slope[:, 6:] += (np.maximum(high, 0) - np.maximum(low, 0)) / LIMIT_SIGMA**2
        return quadratic

    def allowed(self, at: Posed) -> Posed:
        """Return the poses with joints clipped to at most ``LIMIT_SIGMA`` beyond their limits."""
        low, high = self.readings.low - LIMIT_SIGMA, self.readings.high + LIMIT_SIGMA
        return replace(at, joints=np.clip(at.joints, low, high))
