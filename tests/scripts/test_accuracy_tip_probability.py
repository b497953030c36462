"""The fit of the probability of the tips, and the check of stated ones."""

from __future__ import annotations

import numpy as np
import pytest

from dvrk_cmaes.pose.tip_probability import tip_probability

pytestmark = pytest.mark.usefixtures("scripts_on_path")


def drawn_inputs(count: int) -> np.ndarray:
    """Draw what the probability is computed from, (2, count)."""
    rng = np.random.default_rng(0)
    mode, nearness = rng.uniform(0, 9, count), rng.uniform(-1, 3, count)
    return np.stack([mode, nearness])


def test_constants_are_found_again_from_outcomes() -> None:
    from measure.accuracy.tip_probability import fitted_constants, probability

    constants = (-1.0, 1.5, 0.5, 2.0)
    inputs = drawn_inputs(20000)
    is_near = np.random.default_rng(1).random(20000) < probability(constants, inputs)
    assert fitted_constants(inputs, is_near) == pytest.approx(constants, abs=0.25)


def test_program_states_the_probability_of_its_constants() -> None:
    from measure.accuracy.tip_probability import _START, probability

    inputs = drawn_inputs(20)
    stated = [tip_probability(1.8 * np.exp(-near), 1.8, of_mode=1 - np.exp(-mode)) for mode, near in inputs.T]
    assert stated == pytest.approx(probability(_START, inputs), abs=1e-6)


def test_reliability_is_by_tenths_of_the_stated_probability() -> None:
    from measure.accuracy.tip_probability import reliability_rows, threshold_rows

    stated, is_near = np.array([0.95, 1.0, 0.31, 0.35]), np.array([True, True, False, True])
    low, high = reliability_rows(stated, is_near)
    assert (low["stated"], low["results"], low["near"]) == ([0.3, 0.4], 2, 0.5)
    assert (high["results"], high["near"]) == (2, 1.0)
    first = threshold_rows(stated, np.array([0.5, 2.5, 0.5, 4.0]), np.zeros(4, dtype=bool))[0]
    assert (first["ok"], first["within_2_mm"], first["within_3_mm"], first["ok_of_right"]) == (2, 0.5, 1.0, 0.5)
