"""Elimination of frames' own unknowns: what is left is their sum of squares at its minimum over these."""

from __future__ import annotations

import numpy as np
import pytest

from dvrk_cmaes.pose.refine.elimination import Eliminated, eliminate
from dvrk_cmaes.pose.terms.term import Quadratic

FRAMES, OWN = 4, 6
EXPECTED = np.random.default_rng(1).standard_normal((FRAMES, OWN))
SHARED = np.array([0.4, -0.2, 0.7])

pytestmark = pytest.mark.parametrize("further", [0, 3])


def made_terms(further: int) -> tuple[Quadratic, np.ndarray]:
    """Give terms (N, D + E) of made sums of squares, and the information (N, D, D) about what is expected."""
    rng = np.random.default_rng(further)
    residuals = rng.standard_normal((FRAMES, OWN + further + 2, OWN + further))
    expected = rng.standard_normal((FRAMES, OWN + 1, OWN))
    terms = Quadratic(np.swapaxes(residuals, 1, 2) @ residuals, rng.standard_normal((FRAMES, OWN + further)))
    return terms, np.swapaxes(expected, 1, 2) @ expected


def cost(terms: Quadratic, information: np.ndarray, own: np.ndarray, expected: np.ndarray, shared: np.ndarray) -> float:
    """Give half of all frames' sums of squares at own unknowns (N, D)."""
    both = np.concatenate([own, np.tile(shared, (FRAMES, 1))], axis=1)
    of_terms = 0.5 * np.einsum("ni,nij,nj->", both, terms.information, both) + (terms.slope * both).sum()
    return float(of_terms + 0.5 * np.einsum("ni,nij,nj->", own - expected, information, own - expected))


def eliminated(further: int, change: np.ndarray | None = None) -> Eliminated:
    """Eliminate the own unknowns after a change (D + E,) of what is expected of each frame and of the shared ones."""
    change = np.zeros(OWN + further) if change is None else change
    terms, information = made_terms(further)
    return eliminate(terms, EXPECTED + change[:OWN], information, SHARED[:further] + change[OWN:])


def least(further: int, change: np.ndarray) -> float:
    """Give the sum of half the frames' sums of squares at its minimum, after a change (D + E,)."""
    terms, information = made_terms(further)
    own = eliminated(further, change).own
    return cost(terms, information, own, EXPECTED + change[:OWN], SHARED[:further] + change[OWN:])


def test_own_unknowns_are_where_the_sum_of_squares_is_least(further: int) -> None:
    terms, information = made_terms(further)
    found = eliminated(further)
    at = cost(terms, information, found.own, EXPECTED, SHARED[:further])
    for change in np.random.default_rng(2).standard_normal((20, FRAMES, OWN)):
        assert cost(terms, information, found.own + 0.1 * change, EXPECTED, SHARED[:further]) > at


def test_slope_is_the_gradient_of_the_least_sum_of_squares(further: int) -> None:
    step = 1e-5 * np.eye(OWN + further)
    gradient = [(least(further, change) - least(further, -change)) / 2e-5 for change in step]
    np.testing.assert_allclose(eliminated(further).left.slope.sum(axis=0), gradient, rtol=1e-6, atol=1e-6)


def test_information_and_gain_are_the_derivatives_of_slope_and_own_unknowns(further: int) -> None:
    found = eliminated(further)
    for k, change in enumerate(np.eye(OWN + further)):
        after = eliminated(further, change)
        np.testing.assert_allclose(found.left.information[:, :, k], after.left.slope - found.left.slope, atol=1e-9)
        np.testing.assert_allclose(found.gain[:, :, k], after.own - found.own, atol=1e-9)
    np.testing.assert_allclose(found.left.information, np.swapaxes(found.left.information, 1, 2), atol=1e-9)


def test_without_expectation_the_terms_alone_decide(further: int) -> None:
    terms, information = made_terms(further)
    found = eliminate(terms, EXPECTED, np.zeros_like(information), SHARED[:further])
    covariance = np.linalg.inv(terms.information)[:, OWN:, OWN:]
    np.testing.assert_allclose(found.left.information[:, OWN:, OWN:], np.linalg.inv(covariance), atol=1e-9)
    np.testing.assert_array_equal(found.left.information[:, :OWN], 0)
