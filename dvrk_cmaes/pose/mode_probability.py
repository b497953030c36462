"""Probability that the pose found is in the true mode.

Each mode has the weight exp(-0.6 score), its score being a negative log-likelihood of outline and readings. The factor
stands for errors that long stretches of a mask's contour share, which scores take for independent. A mode that the
search has not found has the odds (e / 10 mm)^3 against those found, e being the expected error of the tips: where the
outline says little about the pose, a search misses more. The exponent and the 10 mm were fitted to made frames of the
levels medium and hard.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dvrk_cmaes.geometry import Float64, rotation_angle
from dvrk_cmaes.pose.search.modes import PoseCandidate

SAME_MODE = np.deg2rad(30.0)
"""Largest rotation between two poses of one mode, rad."""

_TEMPERED = 0.6  # of 560 made frames with masks of all kinds, 99.8 % of the probabilities above 0.95 are then right
_MISSED_MM, _MISSED_POWER = 10.0, 3.0  # odds of a mode that was not found


def mode_weights(modes: Sequence[PoseCandidate]) -> Float64:
    """Return the share of each mode (M,) in the posterior probability of all that were found."""
    scores = np.array([mode.score for mode in modes])
    weights = np.exp(-_TEMPERED * (scores - scores.min()))
    return np.asarray(weights / weights.sum())


def mode_probability(modes: Sequence[PoseCandidate], expected_mm: float) -> float:
    """Return the probability that the first mode is within 30 degrees of the truth.

    ``expected_mm`` is the expected error of the tips if it is.
    """
    best = modes[0].at.pose
    same = [float(rotation_angle(best, mode.at.pose)) < SAME_MODE for mode in modes]
    share = float(mode_weights(modes)[same].sum())
    missed = (expected_mm / _MISSED_MM) ** _MISSED_POWER
    return float(share / (1 + missed))
