"""The readings of the joints and their limits as a term."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from dvrk_cmaes.geometry import Float64, Posed
from dvrk_cmaes.joints.prior import LIMIT_SIGMA, Readings
from dvrk_cmaes.pose.terms.term import Quadratic, Term


@dataclass(frozen=True, eq=False)
class ReadingsTerm(Term):
    """Deviations of the joints from their ``readings``, and beyond their limits."""

    readings: Readings

    def cost(self, at: Posed) -> Float64:
        """Return the sum of squares (C,)."""
        return self.readings.cost(at.joints)

    def local(self, at: Posed) -> Quadratic:
        """Return the approximation of half of it, which is exact but for the corners at the limits."""
        weight, centre = self.readings.weight_and_centre
        quadratic = Quadratic.zero(len(at), 6 + len(weight))
        beyond = np.maximum(at.joints - self.readings.high, 0) - np.maximum(self.readings.low - at.joints, 0)
        np.einsum("cii->ci", quadratic.information)[:, 6:] = weight + (beyond != 0) / LIMIT_SIGMA**2
        quadratic.slope[:, 6:] = weight * (at.joints - centre)
        quadratic.slope[:, 6:] += beyond / LIMIT_SIGMA**2
        return quadratic

    def allowed(self, at: Posed) -> Posed:
        """Return the poses with joints clipped to at most ``LIMIT_SIGMA`` beyond their limits."""
        low, high = self.readings.low - LIMIT_SIGMA, self.readings.high + LIMIT_SIGMA
        return replace(at, joints=np.clip(at.joints, low, high))
