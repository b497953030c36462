"""What is expected of a pose beforehand, for example by a session, as a term."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dvrk_cmaes.geometry import Float64, Posed
from dvrk_cmaes.pose.terms.term import Quadratic, Term


@dataclass(frozen=True, eq=False)
class Expected(Term):
    """A normal distribution of pose and joints.

    ``mean`` is in the reference camera; ``information`` (6 + J, 6 + J) is the inverse covariance of the small changes
    from it, m and rad.
    """

    mean: Posed
    information: Float64

    @classmethod
    def of(cls, mean: Posed, covariance: Float64) -> Expected:
        """Return the distribution with a covariance (6 + J, 6 + J)."""
        return cls(mean, np.asarray(np.linalg.inv(covariance), dtype=np.float64))

    def cost(self, at: Posed) -> Float64:
        """Return the squared Mahalanobis distance (C,) from the mean."""
        off = at.minus(self.mean)
        return np.asarray(np.einsum("ci,ij,cj->c", off, self.information, off))

    def local(self, at: Posed) -> Quadratic:
        """Return the approximation of half of it, which is exact but for the curvature of rotations."""
        information = np.broadcast_to(self.information, (len(at), *self.information.shape))
        return Quadratic(information, at.minus(self.mean) @ self.information)
