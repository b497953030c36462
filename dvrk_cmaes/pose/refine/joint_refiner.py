"""Refinement of poses on the masks of several views of one frame: their terms are summed.

Small changes are in the root's own axes, which are the same in every view, so information and slope of the views add up
without a change of coordinates. The masks of one frame come from one segmenter: the variance of the contours' errors is
estimated from the residuals of all views together. With a variance of its own, the view that happens to fit best would
have nearly all the weight.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.config import OutlineConfig
from dvrk_cmaes.evidence.joint_prior import Readings
from dvrk_cmaes.geometry import moved
from dvrk_cmaes.pose.refine.outline import OutlineFit, OutlineRefiner, OutlineTerms
from dvrk_cmaes.pose.refine.priors import PosePrior
from dvrk_cmaes.pose.views import FrameView, without_readings
from dvrk_cmaes.silhouette import Renderer

Float64 = NDArray[np.float64]

_DAMPING = (1e-4, 1e-2, 1e4)  # least, first and largest of the Levenberg-Marquardt steps
_SMALL_GAIN = 0.1  # of the tolerance


@dataclass(eq=False)
class _State:
    """State of the refinement of one pose: its terms in each view, and the last derivatives that were computed."""

    pose: Float64
    joints: Float64
    terms: list[OutlineTerms]
    information: Float64
    slope: Float64
    damping: float = _DAMPING[1]
    finished: bool = False

    def step(self) -> Float64:
        """Compute a damped Gauss-Newton step, (6 + J,)."""
        damped = self.information + self.damping * np.diag(np.diag(self.information) + 1e-9)
        return np.asarray(-np.linalg.solve(damped, self.slope), dtype=np.float64)


class JointRefiner:
    """Refines poses on the masks of several views; poses are in the reference camera.

    ``views`` are the refiner of each view and its ``view_from_camera`` (4, 4). The readings are priors of the first
    one's refiner only. ``tolerance`` is the step, in standard deviations, below which a pose is converged.
    """

    def __init__(self, views: Sequence[tuple[OutlineRefiner, Float64]], *, tolerance: float, iterations: int) -> None:
        self.views = tuple(views)
        self._tolerance = tolerance
        self._iterations = iterations
        self._noise: float | None = None

    @staticmethod
    def of_views(
        views: Sequence[FrameView],
        renderers: Sequence[Renderer],
        readings: Readings,
        settings: Sequence[OutlineConfig],
        *,
        shrinks: Sequence[int],
        expected: PosePrior | None = None,
    ) -> JointRefiner:
        """Make the refiner of views that are drawn at 1 / ``shrinks`` of their sizes by ``renderers``.

        ``readings`` and the prior ``expected`` of the pose, which is in the reference camera, count once. ``settings``
        are those of each view; of the first are the tolerance and the number of iterations.
        """
        refiners = []
        for k, (view, renderer, shrink) in enumerate(zip(views, renderers, shrinks, strict=True)):
            own = readings if k == 0 else without_readings(readings)
            prior = None
            if k == 0 and expected is not None:
                prior = replace(expected, camera_from_root=view.view_from_camera @ expected.camera_from_root)
            refiner = OutlineRefiner(renderer, view.evidence, own, settings[k], shrink=shrink, expected=prior)
            refiners.append((refiner, view.view_from_camera))
        tolerance = settings[0].tolerance * (1 if shrinks[0] == 1 else 4)
        iterations = 2 * settings[0].iterations  # each is one step, those of a single view are several
        return JointRefiner(refiners, tolerance=tolerance, iterations=iterations)

    def set_noise_at(self, pose: Float64, joints: Float64) -> None:
        """Estimate the contours' errors from the residuals at a pose (4, 4) and joints (J,), for all following fits.

        Otherwise they are estimated from the residuals of each fit, to which a prior of the pose contributes.
        """
        (terms,) = self._terms(pose[None], joints[None], None, derivatives=False)
        self._noise = _mean_residual([term.residual for term in terms], terms)

    def with_views(self, views: Sequence[tuple[OutlineRefiner, Float64]]) -> JointRefiner:
        """Return a refiner of other views with the same settings."""
        return JointRefiner(views, tolerance=self._tolerance, iterations=self._iterations)

    @property
    def silhouettes(self) -> int:
        """Number of silhouettes rendered so far."""
        return sum(refiner.silhouettes for refiner, _ in self.views)

    @property
    def rays(self) -> int:
        """Number of rays traced so far."""
        return sum(refiner.rays for refiner, _ in self.views)

    def assess(self, pose: Float64, joints: Float64) -> OutlineFit:
        """Score one pose (4, 4) and its joints (J,) without refining them."""
        return self.refine_all(pose[None], joints[None], iterations=0)[0]

    def refine_all(
        self,
        poses: Float64,
        joints: Float64,
        *,
        iterations: int | None = None,
        cauchy: float | None = None,
        share: float = 1.0,
        least: int = 1,
    ) -> list[OutlineFit]:
        """Refine poses (C, 4, 4) and their joints (C, J); arguments as in `OutlineRefiner`."""
        most = self._iterations if iterations is None else iterations
        starts = zip(poses, joints, self._terms(poses, joints, cauchy), strict=True)
        states = [_State(pose, joint, terms, *self._summed(terms)) for pose, joint, terms in starts]
        kept = float(len(states))
        for left in reversed(range(most)):
            best = sorted(states, key=lambda state: self._score(state.terms, [term.loss for term in state.terms]))
            active = [state for state in best[: max(round(kept), least)] if not state.finished]
            if not active:
                break
            kept *= share
            steps = np.stack([state.step() for state in active])
            at = moved(np.stack([s.pose for s in active]), steps[:, :6]), np.stack([s.joints for s in active])
            trials = self._terms(at[0], at[1] + steps[:, 6:], cauchy, derivatives=left > 0)
            for state, pose, step, terms in zip(active, at[0], steps, trials, strict=True):
                self._accept(state, pose, state.joints + step[6:], step, terms, derivatives=left > 0)
        return [self._fit(state) for state in states]

    def _terms(
        self, poses: Float64, joints: Float64, cauchy: float | None, *, derivatives: bool = True
    ) -> list[list[OutlineTerms]]:
        """Compute the terms of all views at each of C poses."""
        found = [
            refiner.terms(view_from_camera @ poses, joints, cauchy=cauchy, derivatives=derivatives)
            for refiner, view_from_camera in self.views
        ]
        return [list(terms) for terms in zip(*found, strict=True)]

    def _accept(
        self,
        state: _State,
        pose: Float64,
        joints: Float64,
        step: Float64,
        terms: list[OutlineTerms],
        *,
        derivatives: bool,
    ) -> None:
        """Move a state to a trial pose if that lowers the cost; otherwise increase its damping."""
        scales = self._scales(state.terms)
        triples = zip(scales, state.terms, terms, strict=True)
        gain = sum(scale * (old.loss - new.loss) + old.prior - new.prior for scale, old, new in triples)
        if gain <= 0:
            state.damping *= 8
            state.finished = state.damping > _DAMPING[2]
            return
        small = step @ state.information @ step < self._tolerance**2 * len(step)
        state.finished = bool(small or gain < _SMALL_GAIN * self._tolerance)
        state.pose, state.joints, state.terms = pose, joints, terms
        state.damping = max(state.damping / 8, _DAMPING[0])
        if derivatives:
            state.information, state.slope = self._summed(terms)

    def _scales(self, terms: Sequence[OutlineTerms]) -> list[float]:
        """Return the factor of each view from sums of squares of coverage to sums of squares in standard deviations."""
        mean = _mean_residual([term.loss for term in terms], terms) if self._noise is None else self._noise
        return [term.count / (term.length * mean) for term in terms]

    def _summed(self, terms: Sequence[OutlineTerms]) -> tuple[Float64, Float64]:
        """Sum the information and the slope of the outlines and priors of all views."""
        pairs = list(zip(self._scales(terms), terms, strict=True))
        information = np.sum([scale * term.outline[0] + term.priors[0] for scale, term in pairs], axis=0)
        slope = np.sum([scale * term.outline[1] + term.priors[1] for scale, term in pairs], axis=0)
        return information, slope

    def _score(self, terms: Sequence[OutlineTerms], residuals: Sequence[float]) -> float:
        """Return the negative log-likelihood of all views and of the priors, up to a constant."""
        prior = 0.5 * sum(term.prior for term in terms)
        if self._noise is not None:
            pairs = zip(self._scales(terms), residuals, strict=True)
            return 0.5 * sum(scale * residual for scale, residual in pairs) + prior
        count = sum(term.count for term in terms)
        return 0.5 * count * float(np.log(_mean_residual(residuals, terms))) + prior

    def _fit(self, state: _State) -> OutlineFit:
        """Return the fit of a state, scored with the configuration's Cauchy loss."""
        residuals = [term.residual for term in state.terms]
        score, prior = self._score(state.terms, residuals), 0.5 * sum(term.prior for term in state.terms)
        return OutlineFit(state.pose, state.joints, score, score - prior, sum(residuals), state.information)


def _mean_residual(residuals: Sequence[float], terms: Sequence[OutlineTerms]) -> float:
    """Return the sum of squares per px of contour, over all views, at least that of exact masks."""
    return max(sum(residuals), sum(term.least for term in terms)) / sum(term.length for term in terms)
