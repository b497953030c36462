"""Jaw tips that were given in a view as a term, and all terms of a frame beside its outline."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dvrk_cmaes.config import OutlineConfig
from dvrk_cmaes.geometry import Float64, Posed
from dvrk_cmaes.joints.prior import Readings
from dvrk_cmaes.pose.search.objective import project_tips
from dvrk_cmaes.pose.terms.readings_term import ReadingsTerm
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
