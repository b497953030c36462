"""Steps on profiles along the outline: they follow the loss of the coverage, and the derivatives of the outline."""

from __future__ import annotations

import numpy as np
import pytest
from dvrk_cmaes.pose.refine.profiles import Profiles, Quadratics, minimise

from dvrk_cmaes.silhouette import OutlinePoints


def edge(offset: float) -> np.ndarray:
    """Give a blurred half plane, covered left of a vertical edge ``offset`` px right of column 20."""
    from scipy.special import ndtr

    return np.tile(ndtr((20 + offset - np.arange(41)) / 1.2), (30, 1)).astype(np.float32)


def profiles(target: np.ndarray, rows: np.ndarray | None = None) -> Profiles:
    """Give profiles of a vertical outline at column 20 whose points move right by the only unknown, px."""
    row = np.arange(30.0) if rows is None else rows
    pixels = np.column_stack([np.full(len(row), 20.0), row])
    normals = np.tile([1.0, 0.0], (len(row), 1))
    none = np.zeros(len(row), dtype=np.intp)
    outline = OutlinePoints(none, none, pixels, normals, np.zeros((len(row), 3)))
    return Profiles.sampled([edge(0) - target], np.ones_like(target), [outline], [np.ones((len(row), 1))], 1.2)


FREE = Quadratics(np.ones(1), np.zeros((1, 1, 1)), np.zeros((1, 1)))


@pytest.mark.parametrize("offset", [-0.4, 0.0, 0.3])
def test_outline_moves_onto_the_edge(offset: float) -> None:
    change = minimise(profiles(edge(offset)), FREE, 0.5, np.zeros(1), 20)
    assert change[0, 0] == pytest.approx(offset, abs=0.05)


def test_robust_loss_follows_the_majority() -> None:
    offset = 0.3
    target = edge(0.0)
    target[:10] = edge(2.5)[:10]  # a third of the outline is off
    target[10:] = edge(offset)[10:]
    robust, squares = (minimise(profiles(target), FREE, c, np.zeros(1), 30)[0, 0] for c in (0.03, 10.0))
    assert robust == pytest.approx(offset, abs=0.05)
    assert squares > 2 * offset


def test_prior_and_damping_hold_back() -> None:
    target = edge(0.5)
    free = minimise(profiles(target), FREE, 0.5, np.zeros(1), 20)[0, 0]
    strong = Quadratics(np.ones(1), np.full((1, 1, 1), 1e3), np.zeros((1, 1)))
    assert abs(minimise(profiles(target), strong, 0.5, np.zeros(1), 20)[0, 0]) < 0.1 * free
    assert minimise(profiles(target), FREE, 0.5, np.ones(1), 20)[0, 0] < 0.7 * free


def test_outlines_of_different_length_are_solved_together() -> None:
    long, short = profiles(edge(0.3)), profiles(edge(-0.2), np.arange(10.0))
    both = Quadratics(np.ones(2), np.zeros((2, 1, 1)), np.zeros((2, 1)))
    together = minimise(Profiles.joined([long, short]), both, 0.5, np.zeros(2), 20)
    alone = [minimise(one, FREE, 0.5, np.zeros(1), 20)[0, 0] for one in (long, short)]
    np.testing.assert_allclose(together[:, 0], alone, atol=1e-3)
