"""Steps on profiles along the outline: they follow the loss of the coverage."""

from __future__ import annotations

import numpy as np
import pytest

from dvrk_cmaes import _kernel
from dvrk_cmaes.pose.refine.gauss_newton import minimise
from dvrk_cmaes.pose.terms.profiles import Profiles, density
from dvrk_cmaes.pose.terms.sized_view import REACH, blur_filter
from dvrk_cmaes.pose.terms.term import Quadratic


def edge(offset: float, rows: int = 30) -> np.ndarray:
    """Give a half plane, covered left of a vertical edge ``offset`` px right of column 20."""
    return np.tile(np.clip(20.5 + offset - np.arange(41), 0, 1), (rows, 1)).astype(np.float32)


def profiles(target: np.ndarray, cauchy: float = 0.5) -> Profiles:
    """Give profiles of a vertical outline at column 20, whose points move right by 1000 px per m of the pose."""
    rows = len(target)
    corners = np.array([[-200.0, -200], [20, -200], [20, 200], [-200, 200]]) - [20, (rows - 1) / 2]
    plate = np.column_stack([corners, np.full(4, 100.0)]) / 1000
    mesh = _kernel.Mesh([(plate, np.array([[0, 1, 2], [0, 2, 3]], dtype=np.int32))])
    camera = _kernel.Camera(41, rows, 100.0, 100.0, 20.0, (rows - 1) / 2, "plumb_bob", (), np.inf)
    mask = _kernel.Target(target, np.ones_like(target), blur_filter(1.2), REACH)
    here, no_joints = np.eye(4)[None], np.zeros((1, 0, 1, 4, 4))
    (drawn,) = mesh.compare(camera, mask, here, here[None], no_joints, here[None], 1, [cauchy], 1, None)
    assert len(drawn.pixels) == rows
    return Profiles([drawn], [1.0], density(1.2), cauchy)


ONE = np.ones(1)
HELD = np.diag([0.0, *[1e12] * 5])
"""Information (6, 6) that keeps the pose as it is but for its motion to the right."""
FREE = Quadratic(HELD[None], np.zeros((1, 6)))


def found(at: Profiles, prior: Quadratic = FREE, damping: np.ndarray = 0 * ONE, iterations: int = 20) -> float:
    """Give by how much the outline moves, px."""
    return float(1e3 * minimise(at, ONE, prior, damping, iterations)[0, 0])


@pytest.mark.parametrize("offset", [-0.4, 0.0, 0.3])
def test_outline_moves_onto_the_edge(offset: float) -> None:
    assert found(profiles(edge(offset))) == pytest.approx(offset, abs=0.05)


def test_robust_loss_follows_the_majority() -> None:
    offset = 0.3
    target = edge(0.0)
    target[:10] = edge(2.5)[:10]  # a third of the outline is off
    target[10:] = edge(offset)[10:]
    robust, squares = (found(profiles(target, cauchy=width), iterations=30) for width in (0.03, 10.0))
    assert robust == pytest.approx(offset, abs=0.05)
    assert squares > 2 * offset


def test_prior_and_damping_hold_back() -> None:
    at = profiles(edge(0.5))
    free = found(at)
    strong = Quadratic(HELD[None] + 1e9 * np.eye(6), np.zeros((1, 6)))
    assert abs(found(at, strong)) < 0.1 * free
    assert found(at, damping=ONE) < 0.7 * free


def test_what_nothing_tells_stays_without_damping() -> None:
    blind = Quadratic(np.diag([4.0, 0.0])[None], np.array([[2.0, 0.0]]))
    np.testing.assert_allclose(minimise(blind, ONE, Quadratic.zero(1, 2), None, 1), [[-0.5, 0.0]], atol=1e-8)
