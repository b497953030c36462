"""Correction of the predicted state by the evidence of one image: iterated Kalman update on the outline."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.config import TrackConfig
from dvrk_cmaes.evidence.quantiles import NORMAL_MEDIAN
from dvrk_cmaes.geometry import Posed
from dvrk_cmaes.joints.prior import LIMIT_SIGMA, Readings
from dvrk_cmaes.pose.terms.readings_term import ReadingsTerm
from dvrk_cmaes.pose.terms.term import Quadratic
from dvrk_cmaes.track.drawn_outline import DrawnOutline
from dvrk_cmaes.track.edges import EdgeDistances
from dvrk_cmaes.track.evidence import Evidence
from dvrk_cmaes.track.motion import Anchor, MotionModel
from dvrk_cmaes.track.outline_model import OutlineModel
from dvrk_cmaes.track.state import FilterState

Float64 = NDArray[np.float64]

_STILL_PX = 0.05  # largest motion of an outline's point up to which a correction is the last
_KEPT_WITHIN_IMAGE = 0.01  # rad, rotation of the root or of a joint up to which an outline is not drawn again
_FARTHEST_BEYOND = 4.0  # standard deviations of a joint's limit


@dataclass(frozen=True, eq=False)
class Fit:
    """Agreement of an outline with the evidence.

    ``supported`` is the share of the outline in the image that has an edge within reach, ``unexplained`` the share of
    the evidence's edge that has no outline within reach, the mean of all views; ``of_views`` has both by index of the
    view. ``length`` is the px of outline that counted, ``sigma`` px the robust standard deviation of the supported
    points' distances. ``cost`` is half the sum of the squared deviations from prediction and evidence, with the
    logarithm of the normalisation: a negative log-likelihood.
    """

    supported: float
    unexplained: float
    length: float
    sigma: float
    cost: float
    of_views: Mapping[int, tuple[float, float]]

    @property
    def agreement(self) -> float:
        """Share of the outline that is supported less that of the edge that is unexplained."""
        return self.supported - self.unexplained


@dataclass(frozen=True, eq=False)
class Updated:
    """The state after an image, how well it fits, and the outline that was drawn last."""

    state: FilterState
    fit: Fit
    outline: DrawnOutline


class OutlineUpdate:
    """Kalman update of the state by signed distances along the outline.

    The outline is drawn up to ``track.draws`` times, as long as the steps still turn the instrument noticeably; between
    two drawings its points move with the instrument. Steps end where they hardly move the outline any more.
    """

    def __init__(self, config: TrackConfig, motion: MotionModel, model: OutlineModel) -> None:
        self._config = config
        self._motion = motion
        self._model = model
        self._limits = ReadingsTerm(Readings.none(model.instrument))

    def __call__(
        self,
        prior: FilterState,
        anchor: Anchor,
        evidence: Evidence,
        sigma: float,
        outline: DrawnOutline,
    ) -> Updated | None:
        """Correct a predicted state.

        ``anchor`` has the readings, ``sigma`` px is the standard deviation of the evidence, ``outline`` that of the
        predicted pose. Returns None if the corrected pose has no outline in the image, or its joints are far beyond
        their limits.
        """
        state, off = prior, np.zeros(prior.layout.size)
        spread: Float64 | None = None
        solved: _Solved | None = None
        reach = 0.0
        for each in evidence.passes(self._config):
            if solved is not None:
                if solved.moved < _STILL_PX and each.reach == reach:
                    break
                at = self._motion.posed(state, anchor)
                drawn = self._model.draw_anew(outline, at, _KEPT_WITHIN_IMAGE, outline.views)
                if drawn is None:
                    return None
                outline, spread = drawn, solved.spread
            reach = each.reach
            for _ in range(each.steps):
                at, loadings = self._motion.linearised(state, anchor)
                seen = self._model.move(outline, at)
                if seen is None:
                    return None
                edges = evidence.distances(seen.pixels, outline, reach)
                towards = prior.covariance @ loadings.T
                own = loadings @ towards
                expected = _variances(seen.jacobian, own if spread is None else spread)
                weights = self._weights(edges, outline.lengths, sigma, expected, reach)
                limits = self._limits.local(Posed(at.pose[None], at.joints[None]))
                near = _of_edges(seen.jacobian, edges.distance, weights) + limits
                solved = _Solved.of(near, towards, own, loadings @ off, seen.jacobian)
                state, off = state.changed(solved.state_change - off), solved.state_change
                if solved.moved < _STILL_PX:
                    break
        assert solved is not None
        at = self._motion.posed(state, anchor)
        low, high = self._limits.readings.low, self._limits.readings.high
        beyond = np.maximum(low - at.joints, at.joints - high).max()
        pixels = self._model.place(outline, at) if beyond <= _FARTHEST_BEYOND * LIMIT_SIGMA else None
        if pixels is None:
            return None
        edges = evidence.distances(pixels, outline, reach)
        cost = 0.5 * (solved.deviation + self._deviation_of_edges(edges, sigma, outline.lengths))
        unexplained = evidence.unexplained(pixels, outline, int(2 * self._config.support_px))
        fit = self._fit(edges, outline, unexplained, cost)
        return Updated(replace(state, covariance=solved.posterior(prior.covariance)), fit, outline)

    def _weights(
        self, edges: EdgeDistances, lengths: Float64, sigma: float, expected: Float64, reach: float
    ) -> Float64:
        """Return the weights (N,), 1/px^2, of the distances from edges, less for those that are unexpectedly long.

        ``lengths`` (N,) px is the outline that each represents, ``expected`` (N,) px^2 the variance of its distance by
        that of the pose.
        """
        c = self._config
        width = c.outlier_sigmas**2 * (sigma**2 + np.minimum(expected, reach**2))
        weights = lengths * edges.found / (sigma**2 + edges.variance)
        weights /= c.correlation_px * c.frame_correlation * (1 + edges.distance**2 / width) ** 2
        return np.asarray(weights)

    def _deviation_of_edges(self, edges: EdgeDistances, sigma: float, lengths: Float64) -> float:
        """Return the sum of the squared deviations of edges from the outline, each bounded, with their correlation."""
        c = self._config
        ratio = (edges.distance / (c.outlier_sigmas * sigma)) ** 2
        trust = sigma**2 / (sigma**2 + edges.variance)
        bounded = c.outlier_sigmas**2 * np.where(edges.found, trust * ratio / (1 + ratio), 1.0)
        return float(bounded @ lengths) / (c.correlation_px * c.frame_correlation)

    def _fit(self, edges: EdgeDistances, outline: DrawnOutline, unexplained: Mapping[int, float], cost: float) -> Fit:
        """Summarise the distances at the corrected pose."""
        near = edges.found & (np.abs(edges.distance) < self._config.support_px)
        total = float(outline.lengths.sum())
        supported = float(outline.lengths[near].sum()) / total
        typical = float(np.median(np.abs(edges.distance[near]))) if near.any() else self._config.support_px
        lengths, within = outline.split(outline.lengths), outline.split(near)
        of_views = {
            view: (float(length[within[view]].sum()) / float(length.sum()), unexplained[view])
            for view, length in lengths.items()
        }
        missing = float(np.mean(list(unexplained.values())))
        return Fit(supported, missing, total, NORMAL_MEDIAN * typical, cost, of_views)


def _variances(jacobian: Float64, covariance: Float64) -> Float64:
    """Return the variances (N,) of values by that of M unknowns, (M, M), of which they have a Jacobian (N, M)."""
    return np.asarray(np.einsum("nd,nd->n", jacobian @ covariance, jacobian))


def _of_edges(jacobian: Float64, distance: Float64, weights: Float64) -> Quadratic:
    """Return the approximation of half the sum of squared distances (N,) with weights, given their Jacobian (N, M)."""
    weighted = jacobian.T * weights
    return Quadratic((weighted @ jacobian)[None], (weighted @ distance)[None])


@dataclass(frozen=True, eq=False)
class _Solved:
    """Solution of a linearised update, for the M = 6 + J changes of pose and joints.

    ``towards`` (D, M) and ``own`` (M, M) are the prediction's covariance of the state with them, and of them;
    ``information`` (M, M) is that of the evidence, ``system`` (M, M) the identity plus ``own @ information``. ``force``
    (M,) are the weighted distances at the solution, ``moved`` px is the largest motion of a point by this solution.
    """

    towards: Float64
    own: Float64
    information: Float64
    system: Float64
    force: Float64
    moved: float

    @staticmethod
    def of(evidence: Quadratic, towards: Float64, own: Float64, before: Float64, jacobian: Float64) -> _Solved:
        """Solve for the change of pose and joints from the prediction, given the one ``before`` (M,).

        ``evidence`` is the approximation there of half its sum of squares, ``jacobian`` (N, M) that of the points.
        """
        information, slope = evidence.information[0], evidence.slope[0]
        system = np.eye(len(slope)) + own @ information
        change = np.linalg.solve(system, own @ (information @ before - slope))
        force = information @ (before - change) - slope
        moved = float(np.abs(jacobian @ (change - before)).max())
        return _Solved(towards, own, information, system, force, moved)

    @property
    def state_change(self) -> Float64:
        """Change of the state from the prediction, (D,)."""
        return np.asarray(self.towards @ self.force)

    @property
    def spread(self) -> Float64:
        """Covariance of pose and joints given the edges, (M, M)."""
        return np.asarray(np.linalg.solve(self.system, self.own))

    @property
    def deviation(self) -> float:
        """Squared deviation from the prediction, and the logarithm of the ratio of the covariances' determinants."""
        return float(self.force @ self.own @ self.force) + float(np.linalg.slogdet(self.system)[1])

    def posterior(self, prior: Float64) -> Float64:
        """Return the covariance (D, D) of the state given the edges."""
        covariance = prior - self.towards @ self.information @ np.linalg.solve(self.system, self.towards.T)
        return np.asarray((covariance + covariance.T) / 2)
