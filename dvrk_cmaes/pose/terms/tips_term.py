"""Jaw tips that were given in a view as a term, and all terms of a frame beside its outline.

The readings of the joints and their limits as a term.

The prior of a pose, for example by a session, as a term.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from dvrk_cmaes.config import OutlineConfig
from dvrk_cmaes.geometry import Float64, Posed
from dvrk_cmaes.joints.prior import LIMIT_SIGMA, Readings
from dvrk_cmaes.pose.search.objective import project_tips
from dvrk_cmaes.pose.terms.term import Quadratic, Term
from dvrk_cmaes.pose.views import FrameView

_STEP = 1e-6  # m and rad, of the central differences


class TipsTerm(Term):
    """Distances of the projected jaw tips from those given in a ``view``; each is paired with the nearer one.

    ``sigma`` is their standard deviation, px.
    """

    def __init__(self, view: FrameView, sigma: float) -> None:
        assert view.evidence.tips is not None
        self._view = view
        self._tips = view.evidence.tips
        self._sigma = sigma

    @staticmethod
    def of_views(views: Sequence[FrameView], config: OutlineConfig) -> list[TipsTerm]:
        """Return a term for each view in which tips were given."""
        given = [view for view in views if view.evidence.tips_given and view.evidence.tips is not None]
        return [TipsTerm(view, config.keypoint_sigma) for view in given]

    def cost(self, at: Posed) -> Float64:
        """Return the sum of squares (C,)."""
        return np.asarray((self._residuals(self._projected(at)) ** 2).sum(axis=1))

    def local(self, at: Posed) -> Quadratic:
        """Return the approximation of half of it, by central differences of the projected tips."""
        count = 6 + at.joints.shape[1]
        changes = _STEP * np.concatenate([np.eye(count), -np.eye(count)])
        around = at[np.repeat(np.arange(len(at)), 2 * count)].moved(np.tile(changes, (len(at), 1)))
        ahead, behind = np.moveaxis(self._projected(around).reshape(len(at), 2, count, 4), 1, 0)
        transposed = (ahead - behind) / (2 * _STEP * self._sigma)
        slope = transposed @ self._residuals(self._projected(at))[:, :, None]
        return Quadratic(transposed @ transposed.swapaxes(1, 2), slope[:, :, 0])

    def _projected(self, at: Posed) -> Float64:
        """Project the tips of C poses, (C, 4) px."""
        instrument, camera = self._view.renderer.body.instrument, self._view.evidence.camera
        return project_tips(instrument, camera, at.seen_from(self._view.view_from_camera)).reshape(-1, 4)

    def _residuals(self, projected: Float64) -> Float64:
        """Return the C projected tips, (C, 4) px, less those given, in standard deviations.

        The given ones are taken in the order that is nearer to the projected ones.
        """
        given = np.stack([self._tips, self._tips[::-1]]).reshape(2, 4)
        nearer = given[((projected[:, None] - given) ** 2).sum(axis=2).argmin(axis=1)]
        return np.asarray((projected - nearer) / self._sigma)


def terms_of_frame(views: Sequence[FrameView], readings: Readings, config: OutlineConfig, *more: Term) -> list[Term]:
    """Return the terms of a frame's readings and given tips, and those of what else is expected of its pose."""
    return [ReadingsTerm(readings), *TipsTerm.of_views(views, config), *more]


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
