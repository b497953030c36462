"""Jaw tips that were given in a view as a term, and all terms of a frame beside its outline."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dvrk_cmaes.config import OutlineConfig
from dvrk_cmaes.geometry import Float64, Indices, Posed
from dvrk_cmaes.instrument import Instrument
from dvrk_cmaes.joints.prior import Readings
from dvrk_cmaes.pose.search.objective import project_tips
from dvrk_cmaes.pose.terms.readings_term import ReadingsTerm
from dvrk_cmaes.pose.terms.term import Quadratic, Term
from dvrk_cmaes.pose.views import FrameView
from dvrk_cmaes.silhouette.moving_points import moving_points


@dataclass(frozen=True, eq=False)
class _TipsAlongAxes:
    """Each jaw tip twice, as points whose motion along u and along v is asked for; ``order`` sorts tips by link."""

    order: Indices
    link: Indices
    points: Float64
    normals: Float64

    @staticmethod
    def of(instrument: Instrument) -> _TipsAlongAxes:
        """Take the tips of an instrument."""
        links = np.array([tip.link for tip in instrument.jaw_tips])
        order = np.argsort(links, kind="stable")
        points = np.stack([tip.position for tip in instrument.jaw_tips])[order]
        return _TipsAlongAxes(
            order, np.repeat(links[order], 2), np.repeat(points, 2, axis=0), np.tile(np.eye(2), (len(links), 1))
        )


class TipsTerm(Term):
    """Distances of the projected jaw tips from those given in a ``view``; each is paired with the nearer one.

    ``sigma`` is their standard deviation, px.
    """

    def __init__(self, view: FrameView, sigma: float) -> None:
        assert view.evidence.tips is not None
        self._view = view
        self._tips = view.evidence.tips
        self._sigma = sigma
        self._fixed = _TipsAlongAxes.of(view.renderer.body.instrument)

    @staticmethod
    def of_views(views: Sequence[FrameView], config: OutlineConfig) -> list[TipsTerm]:
        """Return a term for each view in which tips were given."""
        given = [view for view in views if view.evidence.tips_given and view.evidence.tips is not None]
        return [TipsTerm(view, config.keypoint_sigma) for view in given]

    def cost(self, at: Posed) -> Float64:
        """Return the sum of squares (C,)."""
        instrument, camera = self._view.renderer.body.instrument, self._view.evidence.camera
        projected = project_tips(instrument, camera, at.seen_from(self._view.view_from_camera)).reshape(-1, 4)
        return np.asarray((self._residuals(projected) ** 2).sum(axis=1))

    def local(self, at: Posed) -> Quadratic:
        """Return the approximation of half of it, by the motion of the tips with pose and joints."""
        instrument, camera = self._view.renderer.body.instrument, self._view.evidence.camera
        seen = at.seen_from(self._view.view_from_camera)
        moving = moving_points(instrument, camera, [self._fixed] * len(at), seen)
        by_tip = np.empty((len(at), 2, 2, moving[0].jacobian.shape[1]))
        by_tip[:, self._fixed.order] = np.stack([each.jacobian for each in moving]).reshape(by_tip.shape)
        projected = np.empty((len(at), 2, 2))
        projected[:, self._fixed.order] = np.stack([each.pixels[::2] for each in moving])
        jacobian = by_tip.reshape(len(at), 4, -1) / self._sigma
        residuals = self._residuals(projected.reshape(-1, 4))
        transposed = jacobian.swapaxes(1, 2)
        return Quadratic(transposed @ jacobian, (transposed @ residuals[:, :, None])[:, :, 0])

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
