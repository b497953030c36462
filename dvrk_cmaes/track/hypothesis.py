"""One hypothesis about the mode of the pose: its state, the readings it is based on, and how it has fitted so far."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.config import TrackConfig
from dvrk_cmaes.geometry import Posed, apply
from dvrk_cmaes.instrument import Instrument
from dvrk_cmaes.track.drawn_outline import DrawnOutline
from dvrk_cmaes.track.evidence import Evidence
from dvrk_cmaes.track.motion import Anchor, MotionModel
from dvrk_cmaes.track.outline_model import OutlineModel
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
    ``outline`` is the one that was drawn last; None before the first image.
    """

    state: FilterState
    anchor: Anchor
    sigma: float
    score: float = 0.0
    relation: str = ""
    outline: DrawnOutline | None = None


@dataclass(frozen=True, eq=False)
class Located:
    """Where a hypothesis has the instrument, with the covariance (6 + J, 6 + J), and the jaw tips (K, 3) m.

    ``tip_std`` m is the mean over the tips of the norm of their standard deviations; 0 without tips.
    """

    at: Posed
    covariance: Float64
    tips: Float64
    tip_std: float


class Follower:
    """Carries hypotheses from one image to the next."""

    def __init__(self, config: TrackConfig, motion: MotionModel, model: OutlineModel) -> None:
        self.config = config
        self.motion = motion
        self.model = model
        self._update = OutlineUpdate(config, motion, model)

    @property
    def instrument(self) -> Instrument:
        """The instrument that is followed."""
        return self.model.instrument

    def posed(self, hypothesis: Hypothesis) -> Posed:
        """Return pose and joints of a hypothesis."""
        return self.motion.posed(hypothesis.state, hypothesis.anchor)

    def predicted(
        self, hypothesis: Hypothesis, anchor: Anchor, elapsed: float, lag_std: float
    ) -> tuple[Hypothesis, Float64]:
        """Predict a hypothesis for later readings; returns the transition of its state's error, (D, D), too."""
        state, transition = self.motion.predict(hypothesis.state, hypothesis.anchor, anchor, elapsed, lag_std)
        return replace(hypothesis, state=state, anchor=anchor), transition

    def corrected(self, hypothesis: Hypothesis, evidence: Evidence) -> tuple[Hypothesis, Fit] | None:
        """Correct a predicted hypothesis by an image; None if that is impossible, as in `OutlineUpdate`."""
        outline = self._outline(hypothesis, self.posed(hypothesis), evidence.views)
        if outline is None:
            return None
        updated = self._update(hypothesis.state, hypothesis.anchor, evidence, hypothesis.sigma, outline)
        if updated is None:
            return None
        fit = updated.fit
        latest = min(max(fit.sigma, self.config.sigma_px), self.config.support_px)
        sigma = (1 - _SIGMA_SHARE) * hypothesis.sigma + _SIGMA_SHARE * latest
        score = hypothesis.score + fit.cost
        return replace(hypothesis, state=updated.state, sigma=sigma, score=score, outline=updated.outline), fit

    def outline(self, hypothesis: Hypothesis, views: tuple[int, ...]) -> tuple[DrawnOutline, Float64] | None:
        """Return the outline of a hypothesis and its points (N, 2) in those views that show enough of it, if any."""
        at = self.posed(hypothesis)
        outline = self._outline(hypothesis, at, views)
        pixels = None if outline is None else self.model.place(outline, at)
        return None if outline is None or pixels is None else (outline, pixels)

    def _outline(self, hypothesis: Hypothesis, at: Posed, views: tuple[int, ...]) -> DrawnOutline | None:
        """Return the last outline of a hypothesis, now at a pose, or draw another one if it has turned since."""
        return self.model.draw_anew(hypothesis.outline, at, _KEPT_FROM_LAST, views)

    def located(self, hypothesis: Hypothesis) -> Located:
        """Return pose, joints and tips of a hypothesis."""
        at, loadings = self.motion.linearised(hypothesis.state, hypothesis.anchor)
        covariance = loadings @ hypothesis.state.covariance @ loadings.T
        step, count = 1e-5, len(at.joints)
        tips, *bent = self.instrument.ends(at.joints + step * np.eye(1 + count, count, -1))
        deviations = [
            float(np.sqrt(max(np.trace(jacobian @ covariance @ jacobian.T), 0.0)))
            for jacobian in (
                np.concatenate([np.eye(3), -_cross_matrix(tip), ((moved - tip) / step).T], axis=1)
                for tip, moved in zip(tips, np.stack(bent, axis=1), strict=True)
            )
        ]
        return Located(at, covariance, apply(at.pose, tips), float(np.mean(deviations)) if deviations else 0.0)

    def has_moved(self, before: Hypothesis, predicted: Hypothesis) -> bool:
        """Whether the readings moved the instrument so far between two images that their masks must differ."""
        if not predicted.anchor.outer_read:
            return False
        change = np.abs(self.posed(predicted).minus(self.posed(before)))
        parts = (change[:3], change[3:5], change[6:])
        return any(bool((part > most).any()) for part, most in zip(parts, _SEEN_MOTION, strict=True))

    def fused(self, hypothesis: Hypothesis, measured: Posed, covariance: Float64) -> tuple[Hypothesis, float]:
        """Correct a predicted hypothesis by a pose that was found otherwise, with its covariance (6 + J, 6 + J).

        Returns the squared deviation, in standard deviations, of that pose from the prediction, too.
        """
        off = measured.minus(self.posed(hypothesis))
        loadings = self.motion.loadings(hypothesis.state, hypothesis.anchor)
        prior = hypothesis.state.covariance
        spread = loadings @ prior @ loadings.T + covariance
        gain = np.linalg.solve(spread, loadings @ prior).T
        after = prior - gain @ loadings @ prior
        state = replace(hypothesis.state.changed(gain @ off), covariance=(after + after.T) / 2)
        return replace(hypothesis, state=state), float(off @ np.linalg.solve(spread, off))


def _cross_matrix(v: Float64) -> Float64:
    """Return the cross-product matrix (3, 3) of a vector (3,)."""
    return np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])
