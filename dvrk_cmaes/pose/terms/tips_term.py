"""Jaw tips that were given in a view as a term."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.config import OutlineConfig
from dvrk_cmaes.geometry import Posed
from dvrk_cmaes.pose.search.objective import project_tips
from dvrk_cmaes.pose.terms.term import Quadratic, Term
from dvrk_cmaes.pose.views import FrameView

Float64 = NDArray[np.float64]


class TipsTerm(Term):
    """Distances of the projected jaw tips from those given in a ``view``; each is paired with the nearer one.

    ``config`` has their standard deviation, px, and the steps of the central differences, which are larger where images
    are drawn at 1 / ``shrink`` of their size.
    """

    def __init__(self, view: FrameView, config: OutlineConfig, shrink: int = 1) -> None:
        assert view.evidence.tips is not None
        self._view = view
        self._tips = view.evidence.tips
        self._sigma = config.keypoint_sigma
        steps = np.array([config.translation_step, config.swing_step, config.turn_step, config.joint_step])
        self._steps = steps * [shrink, shrink, min(shrink, 3), min(shrink, 3)]

    @staticmethod
    def of_views(views: Sequence[FrameView], config: OutlineConfig, shrink: int = 1) -> list[TipsTerm]:
        """Return a term for each view in which tips were given."""
        given = [view for view in views if view.evidence.tips_given and view.evidence.tips is not None]
        return [TipsTerm(view, config, shrink) for view in given]

    def cost(self, at: Posed) -> Float64:
        """Return the sum of squares (C,)."""
        residuals = self._residuals(at.seen_from(self._view.view_from_camera), at)
        return np.asarray((residuals**2).sum(axis=1))

    def local(self, at: Posed) -> Quadratic:
        """Return the approximation of half of it, by central differences of the projected tips."""
        joints = at.joints.shape[1]
        steps = np.repeat(self._steps, (3, 2, 1, joints))
        ahead, behind = (
            np.stack([self._residuals(self._moved(at, change), at) for change in sign * np.diag(steps)], axis=1)
            for sign in (1.0, -1.0)
        )
        jacobian = (ahead - behind) / (2 * steps[:, None])  # (C, D, 4)
        here = self._residuals(at.seen_from(self._view.view_from_camera), at)
        return Quadratic(jacobian @ jacobian.swapaxes(1, 2), (jacobian @ here[:, :, None])[:, :, 0])

    def _moved(self, at: Posed, change: Float64) -> Posed:
        """Return C poses in the view's camera after one change (6 + J,)."""
        return at.moved(np.tile(change, (len(at), 1))).seen_from(self._view.view_from_camera)

    def _residuals(self, seen: Posed, paired: Posed) -> Float64:
        """Compute projected less given tips, in standard deviations, (C, 4), for C poses in the view's camera.

        The tips are paired as is better for the C poses ``paired``, which are in the reference camera.
        """
        instrument, camera = self._view.renderer.body.instrument, self._view.evidence.camera
        at = paired.seen_from(self._view.view_from_camera)
        before = project_tips(instrument, camera, at)
        straight, crossed = (((before - tips) ** 2).sum(axis=(1, 2)) for tips in (self._tips, self._tips[::-1]))
        given = np.where((straight <= crossed)[:, None, None], self._tips, self._tips[::-1])
        projected = project_tips(instrument, camera, seen)
        return np.asarray((projected - given).reshape(-1, 4) / self._sigma)
