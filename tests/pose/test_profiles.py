"""Steps on profiles along the outline: they follow the loss of the coverage."""

from __future__ import annotations

import numpy as np
import pytest

from dvrk_cmaes.pose.refine.gauss_newton import minimise
from dvrk_cmaes.pose.terms.profiles import Profiles
from dvrk_cmaes.pose.terms.term import Quadratic
from dvrk_cmaes.silhouette import OutlinePoints


def edge(offset: float) -> np.ndarray:
    """Give a blurred half plane, covered left of a vertical edge ``offset`` px right of column 20."""
    from scipy.special import ndtr

    return np.tile(ndtr((20 + offset - np.arange(41)) / 1.2), (30, 1)).astype(np.float32)


def profiles(target: np.ndarray, rows: np.ndarray | None = None, cauchy: float = 0.5) -> Profiles:
    """Give profiles of a vertical outline at column 20 whose points move right by the only unknown, px."""
    row = np.arange(30.0) if rows is None else rows
    pixels = np.column_stack([np.full(len(row), 20.0), row])
    normals = np.tile([1.0, 0.0], (len(row), 1))
    none = np.zeros(len(row), dtype=np.intp)
    outline = OutlinePoints(none, pixels, normals, np.zeros((len(row), 3)))
    jacobian = np.ones((len(row), 1))
    return Profiles.sampled([edge(0)], target, np.ones_like(target), [outline], [jacobian], 1.2, cauchy)


FREE = Quadratic.zero(1, 1)
ONE = np.ones(1)


@pytest.mark.parametrize("offset", [-0.4, 0.0, 0.3])
def test_outline_moves_onto_the_edge(offset: float) -> None:
    change = minimise(profiles(edge(offset)), ONE, FREE, np.zeros(1), 20)
    assert change[0, 0] == pytest.approx(offset, abs=0.05)


def test_robust_loss_follows_the_majority() -> None:
    offset = 0.3
    target = edge(0.0)
    target[:10] = edge(2.5)[:10]  # a third of the outline is off
    target[10:] = edge(offset)[10:]
    robust, squares = (
        minimise(profiles(target, cauchy=width), ONE, FREE, np.zeros(1), 30)[0, 0] for width in (0.03, 10.0)
    )
    assert robust == pytest.approx(offset, abs=0.05)
    assert squares > 2 * offset


def test_prior_and_damping_hold_back() -> None:
    at = profiles(edge(0.5))
    free = minimise(at, ONE, FREE, np.zeros(1), 20)[0, 0]
    strong = Quadratic(np.full((1, 1, 1), 1e3), np.zeros((1, 1)))
    assert abs(minimise(at, ONE, strong, np.zeros(1), 20)[0, 0]) < 0.1 * free
    assert minimise(at, ONE, FREE, np.ones(1), 20)[0, 0] < 0.7 * free


def test_what_nothing_tells_stays_without_damping() -> None:
    blind = Quadratic(np.diag([4.0, 0.0])[None], np.array([[2.0, 0.0]]))
    np.testing.assert_allclose(minimise(blind, ONE, Quadratic.zero(1, 2), None, 1), [[-0.5, 0.0]], atol=1e-8)


def test_outlines_of_different_length_are_solved_together() -> None:
    long, short = profiles(edge(0.3)), profiles(edge(-0.2), np.arange(10.0))
    together = minimise(Profiles.joined([long, short]), np.ones(2), Quadratic.zero(2, 1), np.zeros(2), 20)
    alone = [minimise(each, ONE, FREE, np.zeros(1), 20)[0, 0] for each in (long, short)]
    np.testing.assert_allclose(together[:, 0], alone, atol=1e-3)
