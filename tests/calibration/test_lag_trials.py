"""Lags at which a session is solved where its frames' own modes tell none, and the choice between the solutions."""

from __future__ import annotations

import numpy as np

from dvrk_cmaes.calibration.lag import LagCurve
from dvrk_cmaes.calibration.session_trials import Overlaps, best_predicting

STEP = 1 / 30


def curve(*misfit: float, first: float = -2.0) -> LagCurve:
    """A curve with a misfit at each lag, a step apart, from ``first`` steps on."""
    lags = STEP * (first + np.arange(len(misfit)))
    return LagCurve.of("s", lags, np.array(misfit))


def test_lags_at_which_the_modes_disagree_far_more_than_at_the_best_are_not_tried() -> None:
    assert curve(3.0, 2.6, 0.9, 2.4, 2.8, 2.2, 2.9).to_try == []
    np.testing.assert_allclose(curve(3.0, 2.6, 2.8, 2.4, 0.9, 2.2, 1.8, 2.0).to_try, [2 * STEP])


def overlaps(mean: float, *, spread: float = 0.01, frames: int = 36, seed: int = 0) -> Overlaps:
    """Overlaps of frames that scatter about a mean."""
    values = mean + spread * np.random.default_rng(seed).normal(size=frames)
    return {(0, f"{i:04d}"): float(value) for i, value in enumerate(values)}


def test_the_solution_that_predicts_best_is_taken() -> None:
    trials = [overlaps(0.7, seed=1), overlaps(0.87, seed=2), overlaps(0.75, seed=3)]
    assert best_predicting(overlaps(0.62), trials) == 1


def test_no_lag_is_kept_unless_another_predicts_clearly_better() -> None:
    assert best_predicting(overlaps(0.9), [overlaps(0.903, spread=0.001, seed=1)]) is None
    assert best_predicting(overlaps(0.9, spread=0.1), [overlaps(0.92, spread=0.1, seed=1)]) is None
    assert best_predicting(overlaps(0.9), []) is None
