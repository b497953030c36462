"""Correction of the predicted state by the evidence of one time, of one or more views: iterated Kalman update."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.config import TrackConfig
from dvrk_cmaes.evidence.joint_prior import LIMIT_SIGMA
from dvrk_cmaes.track.motion import Anchor, MotionModel
from dvrk_cmaes.track.rig_outline import RigEvidence, RigOutlines, RigRim
from dvrk_cmaes.track.state import FilterState

Float64 = NDArray[np.float64]

_KEPT_WITHIN_IMAGE = 0.01  # rad, rotation of the root or of a joint up to which an outline is not drawn again
_FARTHEST_BEYOND = 4.0  # standard deviations of a joint's limit


@dataclass(frozen=True, eq=False)
class Fit:
    """Agreement of an outline with the evidence.

    ``supported`` is the share of the outline in the image that has an edge within reach, ``unexplained`` the share of
    the evidence's edge that has no outline within reach, the mean of all views; ``of_views`` has both by index of the
    view. ``length`` the px of outline that counted, ``sigma`` px the
    standard deviation of the supported points' distances. ``cost`` is half the sum of the squared deviations from
    prediction and evidence, with the logarithm of the normalisation: a negative log-likelihood.
    """

    supported: float
    unexplained: float
    length: float
    sigma: float
    cost: float
    of_views: Mapping[int, tuple[float, float]]


@dataclass(frozen=True, eq=False)
class Updated:
    """The state after an image, how well it fits, and the outline that was drawn last."""

    state: FilterState
    fit: Fit
    rim: RigRim


class OutlineUpdate:
    """Kalman update of the state by signed distances along the outline.

    The outline is drawn up to ``track.draws`` times, as long as the steps still turn the instrument noticeably; between
    two drawings its points move with the instrument.
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

        ``anchor`` has the readings, ``sigma`` px is the standard deviation of the evidence, ``rim`` the
        outline of the predicted pose. Returns None if the corrected pose has no outline in the image, or its joints
        are far beyond their limits.
        """
        c, eye = self._config, np.eye(prior.layout.size)
        state, spread_of = prior, prior.covariance
        off: Float64 = np.zeros(prior.layout.size)
        reach = c.reach_px
        for draw, each in enumerate(evidence.passes(c)):
            reach = each.reach
            if draw:
                drawn = self._model.draw_anew(rim, *self._motion.pose(state, anchor), _KEPT_WITHIN_IMAGE, rim.views)
                if drawn is None:
                    return None
                rim = drawn
            for _ in range(each.steps):
                found = self._linearised(state, anchor, evidence, rim, sigma, spread_of, reach)
                if found is None:
                    return None
                information, slope = found
                system = eye + prior.covariance @ information
                step = np.asarray(np.linalg.solve(system, -prior.covariance @ slope - off), dtype=np.float64)
                state, off = state.changed(step), np.asarray(off + step, dtype=np.float64)
            spread_of = np.asarray(np.linalg.solve(system, prior.covariance), dtype=np.float64)
        pose, joints = self._motion.pose(state, anchor)
        if max((self._low - joints).max(), (joints - self._high).max()) > _FARTHEST_BEYOND * LIMIT_SIGMA:
            return None
        pixels = self._model.place(rim, pose, joints)
        if pixels is None:
            return None
        covariance = (spread_of + spread_of.T) / 2
        residuals = self._residuals(pixels, rim, evidence, sigma, c.outlier_sigmas * sigma, reach)
        cost = 0.5 * (residuals.cost + self._deviation(off, prior.covariance) + float(np.linalg.slogdet(system)[1]))
        return Updated(replace(state, covariance=covariance), self._fit(residuals, evidence, rim, cost), rim)

    @staticmethod
    def _deviation(off: Float64, covariance: Float64) -> float:
        """Compute the squared deviation from a prediction whose covariance may be singular."""
        scale = np.sqrt(np.diag(covariance)) + 1e-12
        scaled = covariance / np.outer(scale, scale) + 1e-9 * np.eye(len(scale))
        return float((off / scale) @ np.linalg.solve(scaled, off / scale))

    def _linearised(
        self,
        state: FilterState,
        anchor: Anchor,
        evidence: RigEvidence,
        rim: RigRim,
        sigma: float,
        covariance: Float64,
        reach: float,
    ) -> tuple[Float64, Float64] | None:
        """Return information (D, D) and slope (D,) of the evidence at a state."""
        c = self._config
        pose, joints, loadings = self._motion.linearised(state, anchor)
        seen = self._model.project(rim, pose, joints)
        if seen is None:
            return None
        effect = seen.jacobian @ loadings
        expected = np.einsum("nd,nd->n", effect @ covariance, effect)
        width = c.outlier_sigmas * np.sqrt(sigma**2 + np.minimum(expected, reach**2))
        residuals = self._residuals(seen.pixels, rim, evidence, sigma, width, reach)
        weight = residuals.weight * rim.lengths / (sigma**2 * c.correlation_px * c.frame_correlation)
        information = seen.jacobian.T @ (seen.jacobian * weight[:, None])
        slope = seen.jacobian.T @ (residuals.distance * weight)
        low, high = self._low - joints, joints - self._high
        information[6:, 6:] += np.diag(((low > 0) | (high > 0)) / LIMIT_SIGMA**2)
        slope[6:] += (np.maximum(high, 0) - np.maximum(low, 0)) / LIMIT_SIGMA**2
        return loadings.T @ information @ loadings, loadings.T @ slope

    def _residuals(
        self,
        pixels: Float64,
        rim: RigRim,
        evidence: RigEvidence,
        sigma: float,
        width: Float64 | float,
        reach: float,
    ) -> _Residuals:
        """Measure the distances of points (N, 2); ``width`` px, (N,) or one for all, is the scale of robust weights."""
        c = self._config
        edges = evidence.distances(pixels, rim, reach)
        ratio = (edges.distance / width) ** 2
        trust = sigma**2 / (sigma**2 + edges.variance)
        weight = np.where(edges.found, trust / (1 + ratio) ** 2, 0.0)
        bounded = np.square(width / sigma) * np.where(edges.found, trust * ratio / (1 + ratio), 1.0)
        cost = float((bounded * rim.lengths).sum()) / (c.correlation_px * c.frame_correlation)
        return _Residuals(pixels, edges.distance, weight, edges.found, cost)

    def _fit(self, residuals: _Residuals, evidence: RigEvidence, rim: RigRim, cost: float) -> Fit:
        """Summarise residuals at the corrected pose."""
        c = self._config
        near = residuals.found & (np.abs(residuals.distance) < c.support_px)
        total = float(rim.lengths.sum())
        supported = float(rim.lengths[near].sum()) / total
        unexplained = evidence.unexplained(residuals.pixels, rim, int(2 * c.support_px))
        lengths, within = rim.split(rim.lengths), rim.split(near)
        of_views = {
            view: (float(length[within[view]].sum()) / float(length.sum()), unexplained[view])
            for view, length in lengths.items()
        }
        sigma = float(np.sqrt(np.mean(residuals.distance[near] ** 2))) if near.any() else c.support_px
        return Fit(supported, float(np.mean(list(unexplained.values()))), total, sigma, cost, of_views)


@dataclass(frozen=True, eq=False)
class _Residuals:
    """Points (N, 2), their distances (N,) px, robust weights (N,), whether an edge was found (N,), and the cost."""

    pixels: Float64
    distance: Float64
    weight: Float64
    found: NDArray[np.bool_]
    cost: float
