"""The lag of a session whose frames' own modes do not tell it: the session is solved at several lags.

Of the whole solutions, that one is taken whose calibration predicts frames best that it was not made of. Errors of
cables and a lag explain much of each other in the frames that are fitted; in frames that are left out, they do not.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np

from dvrk_cmaes.calibration.lag import LagCurve

MOST_LAGS: Final = 3
"""Largest number of lags at which a session is solved, beside none."""

_LIKELY = 1.5  # largest ratio of the misfit at a lag that is tried to the least one
_CLEAR = 2.0  # standard deviations of a mean difference, and ...
_LEAST_GAIN = 0.005  # ... of overlap, by which a lag must predict better than none
_ALIKE = 3.0  # frames near each other in time err alike, so that each counts as one of so many


def lags_to_try(curve: LagCurve | None) -> list[float]:
    """Return the lags, in the curve's unit, at which the frames' modes disagree least, the best first; without zero.

    They are the minima of the curve between its ends that are not much higher than its lowest point.
    """
    if curve is None or len(curve.lags) < 3:
        return []
    misfit = curve.misfit
    inner = np.arange(1, len(misfit) - 1)
    minima = inner[(misfit[inner] <= misfit[inner - 1]) & (misfit[inner] <= misfit[inner + 1])]
    step = float(np.diff(curve.lags).min())
    order = minima[np.argsort(misfit[minima], kind="stable")]
    likely = [k for k in order if misfit[k] <= _LIKELY * misfit.min()]
    return [float(curve.lags[k]) for k in likely if abs(curve.lags[k]) > 0.5 * step][:MOST_LAGS]


def best_predicting(first: Mapping[str, float], others: Sequence[Mapping[str, float]]) -> int | None:
    """Return which of several solutions predicts the frames best, or None if none is clearly better than the first.

    Parameters
    ----------
    first, others
        Overlap of each frame's mask and the silhouette that the other frames predict, by the frame's name.
    """
    gains = []
    for other in others:
        both = sorted(first.keys() & other.keys())
        change = np.array([other[name] - first[name] for name in both])
        error = float(change.std() / np.sqrt(max(len(change) / _ALIKE, 1.0))) if len(change) else np.inf
        gain = float(change.mean()) if len(change) else -np.inf
        gains.append(gain if gain > max(_CLEAR * error, _LEAST_GAIN) else -np.inf)
    best = int(np.argmax(gains)) if gains else 0
    return best if gains and np.isfinite(gains[best]) else None
