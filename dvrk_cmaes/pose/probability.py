"""Probabilities that a pose is in the true mode, and that its tips are within a distance of the truth.

Each mode has the weight exp(-0.6 score), its score being a negative log-likelihood of outline and readings. The factor
stands for errors that long stretches of a mask's contour share, which scores take for independent. A mode that the
search has not found has the odds (e / 10 mm)^3 against those found, e being the expected error of the tips: where the
outline says little about the pose, a search misses more. The exponent and the 10 mm were fitted to made frames of the
levels medium and hard.

The probability of the tips is that of the right mode times that of tips this near in the right mode, each a logistic
function: of the stated probability of the mode, and of the tips' expected error. The functions are fitted by
`scripts/measure.py estimate --fit`; what they do not know, such as another instrument or camera, is named on the page
on accuracy.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from dvrk_cmaes.geometry import Float64, rotation_angle
from dvrk_cmaes.pose.search.modes import PoseCandidate

SAME_MODE = np.deg2rad(30.0)
"""Largest rotation between two poses of one mode, rad."""

_TEMPERED = 0.6  # of 560 made frames with masks of all kinds, 99.8 % of the probabilities above 0.95 are then right
_MISSED_MM, _MISSED_POWER = 10.0, 3.0  # odds of a mode that was not found
_MODE = 0.0, 0.81  # constant, and factor of -log(1 - probability of the mode)
_TIPS = 1.33, 2.64  # constant, and factor of log(distance / expected error)
_LEAST_DOUBT = 1e-4  # probability of a wrong mode; no smaller one was ever checked


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


def tip_probability(expected_mm: float, within_mm: float, *, of_mode: float = 1.0) -> float:
    """Return the probability that the tips are within ``within_mm`` of their true positions.

    Parameters
    ----------
    expected_mm
        Expected error of the tips in the right mode, mm: of their mean, or of the only tip.
    within_mm
        The distance, mm.
    of_mode
        Stated probability of the mode; 1 where a session's prediction tells it.
    """
    mode = 1.0 if of_mode == 1 else _logistic(_MODE[0] - _MODE[1] * math.log(max(1 - of_mode, _LEAST_DOUBT)))
    nearness = math.log(within_mm / max(expected_mm, 1e-6))
    return mode * _logistic(_TIPS[0] + _TIPS[1] * nearness)


def _logistic(x: float) -> float:
    """Return the logistic function."""
    return 1 / (1 + math.exp(-max(x, -700.0)))
