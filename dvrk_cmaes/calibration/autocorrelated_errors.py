"""Errors that the frames of a session share because they are near each other in time.

A shadow beside the shaft stays for some tenths of a second, and frames near each other share more than that: what no
joint explains, the readings' errors at one place of the arm, the rest of a segmenter's mistakes. So the errors of
frames within half a second (`SessionConfig.alike_seconds`) count as those of one, however many they are: else the
frames of a recording would outweigh the prior, the more of them are used the more, and the result would be stated
better than it is.

The errors of both sides of the shaft as a whole are nuisance parameters of each frame, which are eliminated. The
standard deviations of `dvrk_cmaes.pose.terms.shared_errors` are of single frames; the fits of a session have a loss
that is less robust against shadows, with 0.2 to 0.6 of these at the true poses of followed recordings.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dvrk_cmaes.geometry import Float64
from dvrk_cmaes.pose.terms.shared_errors import without_last
from dvrk_cmaes.pose.terms.term import Quadratic

CORRELATED_FRAMES = 3.0
"""Frames near each other whose masks err alike: the information of each counts as much less next to its neighbours."""

IN_SESSION = 0.25
"""Factor on the standard deviations of the errors of the shaft's sides in the fits of a session."""

SINGLE = 1.0
"""The same in frames that count as independent although they follow each other closely."""


@dataclass(frozen=True, eq=False)
class CommonErrors:
    """Errors that N frames share: those of frames near each other in time, and that of the lag.

    ``times`` (N,), s, are those of the frames, NaN where unknown. ``by_lag`` (N, D) are the changes of what is
    predicted of the frames by one standard deviation of the lag. Frames within ``alike_seconds`` count as one.
    """

    times: Float64
    by_lag: Float64
    alike_seconds: float = 0.0


def frames_alike(times: Float64, seconds: float) -> Float64:
    """Return the number of frames (N,), itself included, that err like each frame and count as one with it.

    Parameters
    ----------
    times : (N,)
        Times of the frames, s; frames without one (NaN) count by themselves.
    seconds
        Time in which frames err alike.
    """
    known, out = np.isfinite(times), np.ones(len(times))
    in_order, half = np.sort(times[known]), seconds / 2
    first = np.searchsorted(in_order, times[known] - half, side="left")
    out[known] = np.searchsorted(in_order, times[known] + half, side="right") - first
    return out


def without_sides(terms: Quadratic, count: int, scale: float) -> Quadratic:
    """Eliminate the errors of the shaft's sides, the last ``count`` unknowns of terms (N, K + count): to (N, K).

    ``scale`` is the factor on their standard deviations.
    """
    return without_last(terms, np.eye(count) / scale**2)
