"""Probability that the tips are within a distance of the truth.

It is that of the right mode times that of tips this near in the right mode, each a logistic function: of the stated
probability of the mode, and of the tips' expected error. The functions are fitted by `scripts/measure.py
estimate --fit`; what they do not know, such as another instrument or camera, is named on the page on accuracy.
"""

from __future__ import annotations

import math

_MODE = 0.0, 0.81  # constant, and factor of -log(1 - probability of the mode)
_TIPS = 1.33, 2.64  # constant, and factor of log(distance / expected error)
_LEAST_DOUBT = 1e-4  # probability of a wrong mode; no smaller one was ever checked


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
