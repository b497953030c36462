"""Figures of many errors: percentiles, and the share of intervals that contain the truth."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.stats import beta, chi2

from dvrk_cmaes.geometry import rotation_angle

Float64 = NDArray[np.float64]

RIGHT_MODE_DEG = 30.0  # largest rotation error of a pose in the right mode


def percentiles(values: Sequence[float], at: Sequence[float] = (50, 90, 100)) -> list[float]:
    """Return percentiles of errors, to three decimals."""
    return [round(float(np.percentile(values, share)), 3) for share in at]


def base_errors(found: Float64, true: Float64) -> tuple[float, float]:
    """Return the errors of a camera_from_base (4, 4): rotation, deg, and origin, mm."""
    return float(np.degrees(rotation_angle(found, true))), float(1e3 * np.linalg.norm(found[:3, 3] - true[:3, 3]))


def share_interval(held: int, count: int, confidence: float = 0.95) -> tuple[float, float]:
    """Return the Clopper-Pearson confidence interval of a share, from ``held`` successes in ``count`` trials."""
    tail = (1 - confidence) / 2
    low = float(beta.ppf(tail, held, count - held + 1)) if held else 0.0
    high = float(beta.ppf(1 - tail, held + 1, count - held)) if held < count else 1.0
    return low, high


def held_share(squared: Float64, freedom: int, interval: float) -> dict[str, float]:
    """Return the share of intervals of a probability that contain the truth, and its 95 % confidence interval.

    ``squared`` (N,) are squared Mahalanobis distances from the truth, with ``freedom`` degrees of freedom.
    """
    held = int((squared <= chi2.ppf(interval, freedom)).sum())
    low, high = share_interval(held, len(squared))
    return {"held": held / len(squared), "from": low, "to": high}


def median_z(squared: Float64, freedom: int) -> dict[str, float]:
    """Return the ratio of the median of the error to the expected median; 1 if the covariances are right."""
    return {"median_z": float(np.sqrt(np.median(squared) / chi2.median(freedom)))}


def interval_figures(squared: Float64, freedom: int, interval: float) -> dict[str, float]:
    """Return `held_share`, the root mean square of the error in standard deviations, and `median_z`.

    The root mean square is 1, too, if the covariances are right.
    """
    rms = {"rms_z": float(np.sqrt(squared.mean() / freedom))}
    return held_share(squared, freedom, interval) | rms | median_z(squared, freedom)
