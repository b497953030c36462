"""Fit of the stated probability that the tips are within a distance of the truth, and how often it is right.

A result's probability of the mode and its expected error go into the two logistic functions of
`dvrk_cmaes.pose.tip_probability`. Their four constants are those that make the outcomes of given frames most likely.
Frames that set them must not be the ones that check them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize
from scipy.special import expit

from dvrk_cmaes.config import EstimateConfig
from dvrk_cmaes.instrument import Instrument
from measure.accuracy.errors import frame_errors
from measure.cases import Run

Float64 = NDArray[np.float64]
Bool = NDArray[np.bool_]

_START: Final = (0.0, 0.81, 1.33, 2.64)
_PRIOR: Final = 0.02  # weight of the squares of the constants, which few frames do not determine
_BINS: Final = 10


def inputs_of(runs: Sequence[Run], config: EstimateConfig) -> Float64:
    """Return what the probability is computed from, (2, N): -log(1 - mode), log(limit / error)."""
    rows = []
    for run in runs:
        error, of_mode = run.result.expected_error, run.result.mode_probability
        assert error is not None
        doubt = max(1 - (1.0 if of_mode is None else of_mode), 1e-4)
        rows.append((-np.log(doubt), np.log(config.trust.tip_mm / error.of_tips_mm)))
    return np.array(rows).T


def probability(constants: Sequence[float], inputs: Float64) -> Float64:
    """Return the probabilities (N,) of some inputs (2, N), as `dvrk_cmaes.pose.tip_probability.tip_probability`."""
    a, b, c, d = constants
    return np.asarray(expit(a + b * inputs[0]) * expit(c + d * inputs[1]))


def fitted_constants(inputs: Float64, is_near: Bool) -> list[float]:
    """Return the four constants for which the outcomes (N,) of inputs (2, N) are most likely."""

    def cost(constants: Float64) -> float:
        p = np.clip(probability(constants.tolist(), inputs), 1e-9, 1 - 1e-9)
        return float(-np.log(np.where(is_near, p, 1 - p)).sum() + _PRIOR * (constants**2).sum())

    found = minimize(cost, _START, method="Nelder-Mead", options={"maxiter": 8000, "fatol": 1e-6, "xatol": 1e-4})
    return [round(float(value), 2) for value in found.x]


def reliability_rows(stated: Float64, is_near: Bool) -> list[dict[str, Any]]:
    """Return in ten bins of the stated probability how many results there are, and what share is near the truth."""
    bins = np.minimum((stated * _BINS).astype(int), _BINS - 1)
    return [
        {
            "stated": [k / _BINS, (k + 1) / _BINS],
            "results": int((bins == k).sum()),
            "mean_stated": float(stated[bins == k].mean()),
            "near": float(is_near[bins == k].mean()),
        }
        for k in range(_BINS)
        if (bins == k).any()
    ]


def threshold_rows(stated: Float64, tip_mm: Float64, other_doubts: Bool) -> list[dict[str, Any]]:
    """Return for some least probabilities which share of the ok results is right, and of the right ones is ok."""
    rows = []
    for least in (0.8, 0.85, 0.9, 0.95):
        ok, right = (stated >= least) & ~other_doubts, tip_mm < 2.0
        rows.append(
            {
                "least": least,
                "ok": int(ok.sum()),
                "within_2_mm": float(right[ok].mean()) if ok.any() else None,
                "within_3_mm": float((tip_mm[ok] < 3.0).mean()) if ok.any() else None,
                "ok_of_right": float(ok[right].mean()) if right.any() else None,
            }
        )
    return rows


def tip_probability_report(
    instrument: Instrument, runs: Sequence[Run], config: EstimateConfig
) -> dict[str, list[Mapping[str, Any]]]:
    """Report the constants that fit some runs best, how right the stated probabilities of these are, and limits."""
    posed = [run for run in runs if not run.failed and (run.case.truth is None or run.case.truth.visible >= 0.5)]
    tip_mm = np.array([frame_errors(instrument, run)["tip_mm"] for run in posed])
    inputs, is_near = inputs_of(posed, config), tip_mm < config.trust.tip_mm
    stated = np.array([run.result.tip_probability or 0.0 for run in posed])
    doubts = ("tips not accurate", "mode in doubt", "tips in doubt")  # those that the probability stands for
    others = np.array([any(not reason.startswith(doubts) for reason in run.result.reasons) for run in posed])
    names = ("mode", "mode_slope", "tips", "tips_slope")
    return {
        "constants that fit these frames": [dict(zip(names, fitted_constants(inputs, is_near), strict=True))],
        "stated probability and share near the truth": list(reliability_rows(stated, is_near)),
        "least probability of an ok result": list(threshold_rows(stated, tip_mm, others)),
    }
