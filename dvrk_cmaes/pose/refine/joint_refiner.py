"""Refinement of poses on the masks of several views of one frame: their terms are summed.

The steps are those of `OutlineRefiner`, on the profiles of the outlines of all views together. Small changes are in the
root's own axes, which are the same in every view, so information and slope of the views add up without a change of
coordinates. The masks of one frame come from one segmenter: the variance of the contours' errors is estimated from the
residuals of all views together. With a variance of its own, the view that happens to fit best would have nearly all the
weight.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.config import OutlineConfig
from dvrk_cmaes.geometry import moved
from dvrk_cmaes.joints.prior import Readings
from dvrk_cmaes.pose.refine.outline import OutlineFit, OutlineRefiner, OutlineTerms
from dvrk_cmaes.pose.refine.priors import PosePrior
from dvrk_cmaes.pose.refine.profiles import Profiles, Quadratics, minimise
from dvrk_cmaes.pose.refine.selection import ALL, Selection
from dvrk_cmaes.pose.views import FrameView, without_readings
from dvrk_cmaes.silhouette import Renderer

Float64 = NDArray[np.float64]

_DAMPING = (1e-4, 1e-2, 10.0)  # least, first and largest of the Levenberg-Marquardt steps
_SMALL_GAIN = 0.1  # of the tolerance


@dataclass(eq=False)
class _State:
    """State of the refinement of one pose: its terms in each view, and the last derivatives that were computed."""

    pose: Float64
    joints: Float64
    terms: list[OutlineTerms]
    profiles: Profiles = field(init=False)
    quadratics: Quadratics = field(init=False)
    information: Float64 = field(init=False)
    damping: float = _DAMPING[1]
    moved: bool = True
    finished: bool = False


class JointRefiner:
    """Refines poses on the masks of several views; poses are in the reference camera.

    ``views`` are the refiner of each view and its ``view_from_camera`` (4, 4). The readings are priors of the first
    one's refiner only. ``settings`` are the first view's. ``noise`` is as in `OutlineRefiner`, of all views together.
    """

    def __init__(self, views: Sequence[tuple[OutlineRefiner, Float64]], settings: OutlineConfig) -> None:
        self.views = tuple(views)
        self._settings = settings
        self.noise: float | None = None

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
        are those of each view; of the first are the width of the loss, the tolerance and the number of iterations.
        """
        refiners = []
        for k, (view, renderer, shrink) in enumerate(zip(views, renderers, shrinks, strict=True)):
            own = readings if k == 0 else without_readings(readings)
            prior = None
            if k == 0 and expected is not None:
                prior = replace(expected, camera_from_root=view.view_from_camera @ expected.camera_from_root)
            refiner = OutlineRefiner(renderer, view.evidence, own, settings[k], shrink=shrink, expected=prior)
            refiners.append((refiner, view.view_from_camera))
        return JointRefiner(refiners, settings[0])

    def set_noise_at(self, pose: Float64, joints: Float64) -> None:
        """Estimate the contours' errors from the residuals at a pose (4, 4) and joints (J,), for all following fits.

        Otherwise they are estimated from the residuals of each fit, to which a prior of the pose contributes.
        """
        (terms,) = self._terms(pose[None], joints[None], None, outlines=False)
        self.noise = _mean_residual([term.residual for term in terms], terms)

    def with_views(self, views: Sequence[tuple[OutlineRefiner, Float64]]) -> JointRefiner:
        """Return a refiner of other views with the same settings."""
        return JointRefiner(views, self._settings)

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
        selection: Selection = ALL,
    ) -> list[OutlineFit]:
        """Refine poses (C, 4, 4) and their joints (C, J); arguments as in `OutlineRefiner`."""
        most = self._settings.iterations if iterations is None else iterations
        starts = zip(poses, joints, self._terms(poses, joints, cauchy), strict=True)
        states = [_State(pose, joint, terms) for pose, joint, terms in starts]
        self._linearise(states, cauchy)
        kept = float(len(states))
        for left in reversed(range(most)):
            scores = [self._score(state.terms, [term.loss for term in state.terms]) for state in states]
            priors = [0.5 * sum(term.prior for term in state.terms) for state in states]
            outline_scores = [score - prior for score, prior in zip(scores, priors, strict=True)]
            chosen = [states[i] for i in selection.continuing(scores, outline_scores, kept)]
            active = [state for state in chosen if not state.finished]
            if not active:
                break
            self._linearise([state for state in active if state.moved], cauchy)
            self._advance(active, cauchy, last=left == 0)
            kept *= selection.share
        return [self._fit(state) for state in states]

    def _terms(
        self, poses: Float64, joints: Float64, cauchy: float | None, *, outlines: bool = True
    ) -> list[list[OutlineTerms]]:
        """Compute the terms of all views at each of C poses."""
        found = [
            refiner.terms(view_from_camera @ poses, joints, cauchy=cauchy, outlines=outlines)
            for refiner, view_from_camera in self.views
        ]
        return [list(terms) for terms in zip(*found, strict=True)]

    def _width(self, cauchy: float | None) -> float:
        return self._settings.cauchy if cauchy is None else cauchy

    def _linearise(self, states: Sequence[_State], cauchy: float | None) -> None:
        """Compute the profiles, priors and information of states at their poses, summed over all views."""
        if not states:
            return
        poses, joints = np.stack([s.pose for s in states]), np.stack([s.joints for s in states])
        found = []
        for k, (refiner, view_from_camera) in enumerate(self.views):
            images = [state.terms[k].image for state in states]
            outlines = [outline for state in states if (outline := state.terms[k].outline) is not None]
            seen = view_from_camera @ poses
            found.append(refiner.derivatives(images, outlines, seen, joints, cauchy=self._width(cauchy)))
        for state, *views in zip(states, *found, strict=True):
            scales = self._scales(state.terms)
            prior = np.sum([view.prior_information for view in views], axis=0)
            slope = np.sum([view.prior_slope for view in views], axis=0)
            outline = np.sum([scale * view.information for scale, view in zip(scales, views, strict=True)], axis=0)
            state.profiles = Profiles.of_views(
                [view.profiles for view in views], [scale / scales[0] for scale in scales]
            )
            state.quadratics = Quadratics(np.array(scales[:1]), prior[None], slope[None])
            state.information, state.moved = outline + prior, False

    def _advance(self, states: Sequence[_State], cauchy: float | None, *, last: bool) -> None:
        """Take one step from each state; it is kept if it lowers the cost. After the ``last`` no outline is needed."""
        steps = minimise(
            Profiles.joined([state.profiles for state in states]),
            Quadratics.joined([state.quadratics for state in states]),
            self._width(cauchy),
            np.array([state.damping for state in states]),
            self.views[0][0].inner_steps,
        )
        poses = moved(np.stack([state.pose for state in states]), steps[:, :6])
        joints = np.stack([state.joints for state in states]) + steps[:, 6:]
        trials = self._terms(poses, joints, cauchy, outlines=not last)
        for state, pose, joint, step, terms in zip(states, poses, joints, steps, trials, strict=True):
            self._accept(state, pose, joint, step, terms)

    def _accept(self, state: _State, pose: Float64, joints: Float64, step: Float64, terms: list[OutlineTerms]) -> None:
        """Move a state to a trial pose if that lowers the cost; otherwise increase its damping."""
        triples = zip(self._scales(state.terms), state.terms, terms, strict=True)
        gain = sum(scale * (old.loss - new.loss) + old.prior - new.prior for scale, old, new in triples)
        tolerance = self.views[0][0].tolerance
        small = bool(step @ state.information @ step < tolerance**2 * len(step))
        if gain <= 0:
            state.damping *= 8
            state.finished = small or state.damping > _DAMPING[2]
            return
        state.finished = small or gain < _SMALL_GAIN * tolerance
        state.pose, state.joints, state.terms, state.moved = pose, joints, terms, True
        state.damping = max(state.damping / 8, _DAMPING[0])

    def _scales(self, terms: Sequence[OutlineTerms]) -> list[float]:
        """Return the factor of each view from sums of squares of coverage to sums of squares in standard deviations."""
        mean = _mean_residual([term.loss for term in terms], terms) if self.noise is None else self.noise
        return [term.count / (term.length * mean) for term in terms]

    def _score(self, terms: Sequence[OutlineTerms], residuals: Sequence[float]) -> float:
        """Return the negative log-likelihood of all views and of the priors, up to a constant."""
        prior = 0.5 * sum(term.prior for term in terms)
        if self.noise is not None:
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
