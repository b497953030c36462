"""Correction of the predicted state by the evidence of one image: iterated Kalman update on the outline."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.config import TrackConfig
from dvrk_cmaes.joints.prior import LIMIT_SIGMA
from dvrk_cmaes.track.evidence import EdgeDistances
from dvrk_cmaes.track.motion import Anchor, MotionModel
from dvrk_cmaes.track.outline_model import Projected
from dvrk_cmaes.track.rig_outline import RigEvidence, RigOutlines, RigRim
from dvrk_cmaes.track.state import FilterState

Float64 = NDArray[np.float64]

_STILL_PX = 0.05  # largest motion of an outline's point up to which a correction is the last
_KEPT_WITHIN_IMAGE = 0.01  # rad, rotation of the root or of a joint up to which an outline is not drawn again
_NORMAL_MEDIAN = 1.4826  # standard deviations of a normal distribution for each median of its absolute values
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
    rim: RigRim


class OutlineUpdate:
    """Kalman update of the state by signed distances along the outline.

    The outline is drawn up to ``track.draws`` times, as long as the steps still turn the instrument noticeably; between
    two drawings its points move with the instrument. Steps end where they hardly move the outline any more.
    """

    def __init__(self, config: TrackConfig, motion: MotionModel, model: RigOutlines) -> None:
        self._config = config
        self._motion = motion
        self._model = model
        limits = model.instrument.limits
        self._low, self._high = limits[:, 0].copy(), limits[:, 1].copy()
        if "jaw" in model.instrument.joint_names:
            self._low[model.instrument.joint_index("jaw")] = 0.0  # jaws do not pass through each other

    def __call__(
        self,
        prior: FilterState,
        anchor: Anchor,
        evidence: RigEvidence,
        sigma: float,
        rim: RigRim,
    ) -> Updated | None:
        """Correct a predicted state.

        ``anchor`` has the readings, ``sigma`` px is the standard deviation of the evidence, ``rim`` the outline of the
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
                drawn = self._model.draw_anew(rim, *self._motion.pose(state, anchor), _KEPT_WITHIN_IMAGE, rim.views)
                if drawn is None:
                    return None
                rim, spread = drawn, solved.spread
            reach = each.reach
            for _ in range(each.steps):
                pose, joints, loadings = self._motion.linearised(state, anchor)
                seen = self._model.project(rim, pose, joints)
                if seen is None:
                    return None
                edges = evidence.distances(seen.pixels, rim, reach)
                here = _Linearised(seen, edges, rim.lengths, joints, loadings, prior.covariance @ loadings.T)
                solved = self._solve(here, off, sigma, spread, reach)
                state, off = state.changed(solved.state_change - off), solved.state_change
                if solved.moved < _STILL_PX:
                    break
        assert solved is not None
        pose, joints = self._motion.pose(state, anchor)
        if max((self._low - joints).max(), (joints - self._high).max()) > _FARTHEST_BEYOND * LIMIT_SIGMA:
            return None
        pixels = self._model.place(rim, pose, joints)
        if pixels is None:
            return None
        edges = evidence.distances(pixels, rim, reach)
        cost = 0.5 * (solved.deviation + self._deviation_of_edges(edges, sigma, rim.lengths))
        fit = self._fit(edges, rim, evidence.unexplained(pixels, rim, int(2 * self._config.support_px)), cost)
        return Updated(replace(state, covariance=solved.posterior(prior.covariance)), fit, rim)

    def _solve(self, here: _Linearised, before: Float64, sigma: float, spread: Float64 | None, reach: float) -> _Solved:
        """Correct the state that is ``before`` (D,) from the prediction.

        ``spread`` (6 + J, 6 + J) is the covariance of pose and joints so far, None for that of the prediction.
        """
        c, jacobian, count = self._config, here.seen.jacobian, len(here.loadings)
        own = here.loadings @ here.towards
        expected = np.einsum("nd,nd->n", jacobian @ (own if spread is None else spread), jacobian)
        width = c.outlier_sigmas**2 * (sigma**2 + np.minimum(expected, reach**2))
        weight = here.lengths * here.edges.found / (sigma**2 + here.edges.variance)
        weight /= c.correlation_px * c.frame_correlation * (1 + here.edges.distance**2 / width) ** 2
        weighted = jacobian.T * weight
        information, slope = weighted @ jacobian, weighted @ here.edges.distance
        below, above = np.minimum(here.joints - self._low, 0), np.maximum(here.joints - self._high, 0)
        information[range(6, count), range(6, count)] += ((below < 0) | (above > 0)) / LIMIT_SIGMA**2
        slope[6:] += (below + above) / LIMIT_SIGMA**2
        system = np.eye(count) + own @ information
        start = here.loadings @ before
        change = np.linalg.solve(system, own @ (information @ start - slope))
        force = information @ (start - change) - slope
        moved = float(np.abs(jacobian @ (change - start)).max())
        return _Solved(here.towards, own, information, system, force, moved)

    def _deviation_of_edges(self, edges: EdgeDistances, sigma: float, lengths: Float64) -> float:
        """Return the sum of the squared deviations of edges from the outline, each bounded, with their correlation."""
        c = self._config
        ratio = (edges.distance / (c.outlier_sigmas * sigma)) ** 2
        trust = sigma**2 / (sigma**2 + edges.variance)
        bounded = c.outlier_sigmas**2 * np.where(edges.found, trust * ratio / (1 + ratio), 1.0)
        return float(bounded @ lengths) / (c.correlation_px * c.frame_correlation)

    def _fit(self, edges: EdgeDistances, rim: RigRim, unexplained: Mapping[int, float], cost: float) -> Fit:
        """Summarise the distances at the corrected pose."""
        near = edges.found & (np.abs(edges.distance) < self._config.support_px)
        total = float(rim.lengths.sum())
        supported = float(rim.lengths[near].sum()) / total
        typical = float(np.median(np.abs(edges.distance[near]))) if near.any() else self._config.support_px
        sigma = _NORMAL_MEDIAN * typical
        lengths, within = rim.split(rim.lengths), rim.split(near)
        of_views = {
            view: (float(length[within[view]].sum()) / float(length.sum()), unexplained[view])
            for view, length in lengths.items()
        }
        return Fit(supported, float(np.mean(list(unexplained.values()))), total, sigma, cost, of_views)


@dataclass(frozen=True, eq=False)
class _Linearised:
    """The outline at one state, and the edges near it.

    ``joints`` (J,) and ``loadings`` (6 + J, D) are those of the state, ``lengths`` (N,) px of outline. ``towards``
    (D, 6 + J) is the prediction's covariance of the state with pose and joints.
    """

    seen: Projected
    edges: EdgeDistances
    lengths: Float64
    joints: Float64
    loadings: Float64
    towards: Float64


@dataclass(frozen=True, eq=False)
class _Solved:
    """Solution of a linearised update, for the M = 6 + J changes of pose and joints.

    ``towards`` (D, M) and ``own`` (M, M) are the prediction's covariance of the state with them, and of them;
    ``information`` (M, M) is that of the edges, ``system`` (M, M) the identity plus ``own @ information``. ``force``
    (M,) are the weighted distances at the solution, ``moved`` px is the largest motion of a point by this solution.
    """

    towards: Float64
    own: Float64
    information: Float64
    system: Float64
    force: Float64
    moved: float

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
        found = prior - self.towards @ self.information @ np.linalg.solve(self.system, self.towards.T)
        return np.asarray((found + found.T) / 2)
