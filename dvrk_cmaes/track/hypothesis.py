"""One hypothesis about the mode of the pose: its state, the readings it is based on, and how it has fitted so far."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.config import TrackConfig
from dvrk_cmaes.geometry import apply, change_between
from dvrk_cmaes.instrument import Instrument
from dvrk_cmaes.track.motion import Anchor, MotionModel
from dvrk_cmaes.track.outline_model import Rim
from dvrk_cmaes.track.rig_outline import RigEvidence, RigOutlines, RigRim
from dvrk_cmaes.track.state import FilterState
from dvrk_cmaes.track.update import Fit, OutlineUpdate

Float64 = NDArray[np.float64]

_SEEN_MOTION = (5e-4, 1e-2, 5e-2)  # m, rad of the shaft and rad of a joint, beyond which two masks differ
_KEPT_FROM_LAST = 0.02  # rad, rotation of the root or of a joint up to which the last image's outline is the first one
_SIGMA_SHARE = 0.05  # of an image's standard deviation in the running one


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """A mode that is followed.

    ``sigma`` px is the running standard deviation of the evidence's edges. ``score`` is the negative log-likelihood of
    all images so far, up to a constant that is the same for all hypotheses. ``relation`` is that to the first one.
    ``rim`` is the outline that was drawn last; None before the first image.
    """

    state: FilterState
    anchor: Anchor
    sigma: float
    score: float = 0.0
    relation: str = ""
    rim: RigRim | None = None


@dataclass(frozen=True, eq=False)
class Located:
    """Pose (4, 4) and joints (J,) of a hypothesis with their covariance (6 + J, 6 + J), and the jaw tips (K, 3) m.

    ``tip_std`` m is the mean over the tips of the norm of their standard deviations; 0 without tips.
    """

    camera_from_root: Float64
    joints: Float64
    covariance: Float64
    tips: Float64
    tip_std: float


class Follower:
    """Carries hypotheses from one image to the next."""

    def __init__(self, config: TrackConfig, motion: MotionModel, model: RigOutlines) -> None:
        self.config = config
        self.motion = motion
        self.model = model
        self._update = OutlineUpdate(config, motion, model)

    @property
    def instrument(self) -> Instrument:
        """The instrument that is followed."""
        return self.model.instrument

    def predicted(self, one: Hypothesis, anchor: Anchor, elapsed: float, lag_std: float) -> tuple[Hypothesis, Float64]:
        """Predict a hypothesis for later readings; returns the transition of its state's error, (D, D), too."""
        state, transition = self.motion.predict(one.state, one.anchor, anchor, elapsed, lag_std)
        return replace(one, state=state, anchor=anchor), transition

    def corrected(self, one: Hypothesis, evidence: RigEvidence) -> tuple[Hypothesis, Fit] | None:
        """Correct a predicted hypothesis by an image; None if that is impossible, as in `OutlineUpdate`."""
        pose, joints = self.motion.pose(one.state, one.anchor)
        rim = self.model.draw_anew(one.rim, pose, joints, _KEPT_FROM_LAST, evidence.views)
        if rim is None:
            return None
        updated = self._update(one.state, one.anchor, evidence, one.sigma, rim)
        if updated is None:
            return None
        fit = updated.fit
        latest = min(max(fit.sigma, self.config.sigma_px), self.config.support_px)
        sigma = (1 - _SIGMA_SHARE) * one.sigma + _SIGMA_SHARE * latest
        return replace(one, state=updated.state, sigma=sigma, score=one.score + fit.cost, rim=updated.rim), fit

    def outlines(self, one: Hypothesis, views: tuple[int, ...]) -> dict[int, tuple[Rim, Float64]]:
        """Return the outline of a hypothesis and its points (N, 2) in those views that show enough of it."""
        pose, joints = self.motion.pose(one.state, one.anchor)
        rim = self.model.draw_anew(one.rim, pose, joints, _KEPT_FROM_LAST, views)
        pixels = None if rim is None else self.model.place(rim, pose, joints)
        if rim is None or pixels is None:
            return {}
        return {view: (rim.parts[view], at) for view, at in rim.split(pixels).items()}

    def located(self, one: Hypothesis) -> Located:
        """Return pose, joints and tips of a hypothesis."""
        pose, joints, loadings = self.motion.linearised(one.state, one.anchor)
        covariance = loadings @ one.state.covariance @ loadings.T
        step = 1e-5
        tips, *bent = self.instrument.ends(joints + step * np.eye(1 + len(joints), len(joints), -1))
        deviations = [
            float(np.sqrt(max(np.trace(jacobian @ covariance @ jacobian.T), 0.0)))
            for jacobian in (
                np.concatenate([np.eye(3), -_cross_matrix(tip), ((moved - tip) / step).T], axis=1)
                for tip, moved in zip(tips, np.stack(bent, axis=1), strict=True)
            )
        ]
        return Located(pose, joints, covariance, apply(pose, tips), float(np.mean(deviations)) if deviations else 0.0)

    def has_moved(self, before: Hypothesis, predicted: Hypothesis) -> bool:
        """Whether the readings moved the instrument so far between two images that their masks must differ."""
        if not predicted.anchor.outer_read:
            return False
        pose, joints = self.motion.pose(before.state, before.anchor)
        moved, bent = self.motion.pose(predicted.state, predicted.anchor)
        change = np.abs(change_between(pose, moved))
        parts = (change[:3], change[3:5], np.abs(bent - joints))
        return any(bool((part > most).any()) for part, most in zip(parts, _SEEN_MOTION, strict=True))

    def fused(self, one: Hypothesis, pose: Float64, joints: Float64, covariance: Float64) -> tuple[Hypothesis, float]:
        """Correct a predicted hypothesis by a pose that was found otherwise.

        Returns the squared deviation, in standard deviations, of that pose from the prediction, too.
        """
        before, bent = self.motion.pose(one.state, one.anchor)
        off = np.concatenate([change_between(before, pose), joints - bent])
        loadings = self.motion.loadings(one.state, one.anchor)
        prior = one.state.covariance
        spread = loadings @ prior @ loadings.T + covariance
        gain = np.linalg.solve(spread, loadings @ prior).T
        after = prior - gain @ loadings @ prior
        state = replace(one.state.changed(gain @ off), covariance=(after + after.T) / 2)
        return replace(one, state=state), float(off @ np.linalg.solve(spread, off))


def _cross_matrix(v: Float64) -> Float64:
    """Return the cross-product matrix (3, 3) of a vector (3,)."""
    return np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])
