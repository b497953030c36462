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
        projected = self._projected(at)
        return np.asarray((((projected - self._paired(projected)) / self._sigma) ** 2).sum(axis=1))

    def local(self, at: Posed) -> Quadratic:
        """Return the approximation of half of it, by central differences of the projected tips."""
        count, steps = len(at), np.repeat(self._steps, (3, 2, 1, at.joints.shape[1]))
        changes = np.concatenate([np.diag(steps), -np.diag(steps)])
        around = at[np.repeat(np.arange(count), len(changes))].moved(np.tile(changes, (count, 1)))
        here = self._projected(at)
        given = self._paired(here)
        both = (self._projected(around).reshape(count, 2, len(steps), 4) - given[:, None, None]) / self._sigma
        jacobian = (both[:, 0] - both[:, 1]) / (2 * steps[:, None])  # (C, D, 4)
        residuals = (here - given) / self._sigma
        return Quadratic(jacobian @ jacobian.swapaxes(1, 2), (jacobian @ residuals[:, :, None])[:, :, 0])

    def _projected(self, at: Posed) -> Float64:
        """Project the tips of C poses of the reference camera, (C, 4) px."""
        instrument, camera = self._view.renderer.body.instrument, self._view.evidence.camera
        return project_tips(instrument, camera, at.seen_from(self._view.view_from_camera)).reshape(-1, 4)

    def _paired(self, projected: Float64) -> Float64:
        """Return the given tips, (C, 4) px, in the order that is nearer to the C projected ones."""
        given = np.stack([self._tips, self._tips[::-1]]).reshape(2, 4)
        return np.asarray(given[((projected[:, None] - given) ** 2).sum(axis=2).argmin(axis=1)])
