"""The probability that the tips are within a distance of the truth."""

from __future__ import annotations

from itertools import pairwise

import pytest

from dvrk_cmaes.pose.probability import tip_probability


def test_it_falls_with_the_expected_error() -> None:
    found = [tip_probability(error, 1.8) for error in (0.05, 0.3, 1.0, 1.8, 4.0, 40.0)]
    assert all(a > b for a, b in pairwise(found))
    assert found[0] == pytest.approx(1, abs=0.01)
    assert found[-1] == pytest.approx(0, abs=0.01)


def test_it_falls_with_the_doubt_of_the_mode() -> None:
    found = [tip_probability(0.3, 1.8, of_mode=mode) for mode in (1.0, 0.99, 0.9, 0.6, 0.3)]
    assert all(a >= b for a, b in pairwise(found))
    assert found[-1] < 0.6 < found[2]


def test_extreme_inputs_have_a_probability() -> None:
    assert tip_probability(0.0, 1.8) == 1
    assert tip_probability(1e300, 1.8, of_mode=0.0) == pytest.approx(0)
