"""Lags at which a session is solved where its frames' own modes tell none, and the choice between the solutions."""

from __future__ import annotations

import numpy as np

from dvrk_cmaes.calibration.lag_search import LagCurve
from dvrk_cmaes.calibration.solution_trials import best_predicting, lags_to_try

STEP = 1 / 30


def curve(*misfit: float, first: float = -2.0) -> LagCurve:
    """A curve with a misfit at each lag, a step apart, from ``first`` steps on."""
    lags = STEP * (first + np.arange(len(misfit)))
    return LagCurve.of("s", lags, np.array(misfit))


def test_lags_at_which_the_modes_disagree_far_more_than_at_the_best_are_not_tried() -> None:
    assert lags_to_try(curve(3.0, 2.6, 0.9, 2.4, 2.8, 2.2, 2.9)) == []
    np.testing.assert_allclose(lags_to_try(curve(3.0, 2.6, 2.8, 2.4, 0.9, 2.2, 1.8, 2.0)), [2 * STEP])


def test_motion_that_repeats_itself_has_rivals_of_its_lag() -> None:
    periodic = curve(4.0, 3.0, 1.5, 3.5, 4.0, 3.0, 1.55, 3.0, 4.0, 1.43, 3.0, 4.0)
    np.testing.assert_allclose(periodic.rivals, [0.0, 4 * STEP], atol=1e-9)
    assert curve(4.0, 3.0, 1.5, 1.6, 1.55, 1.43, 3.0, 4.0).rivals == []  # one wide minimum
    assert curve(4.0, 3.0, 1.5, 3.5, 4.0, 3.0, 0.9, 3.0).rivals == []


def overlaps(mean: float, *, spread: float = 0.01, frames: int = 36, seed: int = 0) -> dict[str, float]:
    """Overlaps of frames that scatter about a mean."""
    values = mean + spread * np.random.default_rng(seed).normal(size=frames)
    return {f"{i:04d}": float(value) for i, value in enumerate(values)}


def test_the_solution_that_predicts_best_is_taken() -> None:
    trials = [overlaps(0.7, seed=1), overlaps(0.87, seed=2), overlaps(0.75, seed=3)]
    assert best_predicting(overlaps(0.62), trials) == 1


def test_no_lag_is_kept_unless_another_predicts_clearly_better() -> None:
    assert best_predicting(overlaps(0.9), [overlaps(0.903, spread=0.001, seed=1)]) is None
    assert best_predicting(overlaps(0.9, spread=0.1), [overlaps(0.92, spread=0.1, seed=1)]) is None
    assert best_predicting(overlaps(0.9), []) is None
