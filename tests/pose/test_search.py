"""The global searches and the direct refinements on a loss with known minimum."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest
from helpers.transforms import lookat_pose

from dvrk_cmaes import InputError
from dvrk_cmaes.geometry import Posed
from dvrk_cmaes.pose.refine.direct import refine_direct
from dvrk_cmaes.pose.search import METHODS, minimise

GOAL = np.array([0.7, -0.4, 1.1])


def bowl(candidates: np.ndarray) -> np.ndarray:
    return ((candidates - GOAL) ** 2).sum(axis=1)


@pytest.mark.parametrize("method", METHODS)
def test_search_approaches_minimum_within_budget(method: str) -> None:
    found = minimise(method, bowl, 3, 1500, seed=1)
    assert found.loss == pytest.approx(float(bowl(found.best[None])[0]))
    assert np.abs(found.best - GOAL).max() < 0.35
    assert found.evaluations <= 1500


@pytest.mark.parametrize("method", METHODS)
def test_same_seed_gives_same_result(method: str) -> None:
    first, second = (minimise(method, bowl, 3, 200, seed=5) for _ in range(2))
    np.testing.assert_array_equal(first.best, second.best)


@pytest.mark.parametrize("method", METHODS)
def test_exception_of_loss_is_propagated(method: str) -> None:
    calls = 0

    def broken(candidates: np.ndarray) -> np.ndarray:
        nonlocal calls
        calls += 1
        if calls > 2:
            raise ZeroDivisionError("on purpose")
        return bowl(candidates)

    with pytest.raises(ZeroDivisionError, match="on purpose"):
        minimise(method, broken, 3, 200, seed=0)


def test_unknown_search_is_refused() -> None:
    with pytest.raises(InputError, match="search: expected one of cmaes"):
        minimise("cma-es", bowl, 3, 10, seed=0)


def test_cmaes_is_imported_at_the_first_search_without_scipy_stats() -> None:
    code = (
        "import sys; import numpy as np; from dvrk_cmaes.pose.search import minimise; "
        "before = 'cmaes' in sys.modules; "
        "minimise('cmaes', lambda x: (x * x).sum(axis=1), 3, 40, seed=0); "
        "print(before, 'cmaes' in sys.modules, 'scipy' in sys.modules); "
        "from scipy import stats; print(stats.norm)"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert run.stdout.split()[:3] == ["False", "True", "False"]


@pytest.mark.parametrize("method", ["coordinate-descent", "bobyqa", "sbplx"])
def test_direct_refinement_reduces_loss(method: str) -> None:
    start, scale = Posed(lookat_pose(0.5, 1.0, 0.7, 0.11), np.array([0.4])), np.array([1e-3] * 3 + [0.05] * 4)
    goal = start.moved(np.linspace(-0.5, 0.5, 7) * scale)

    def cost(at: Posed) -> np.ndarray:
        return ((at.minus(goal) / scale) ** 2).sum(axis=-1)

    best, count = refine_direct(method, cost, start, scale, 500, seed=0)
    assert cost(best[None])[0] < 0.05 * cost(start[None])[0]
    assert count <= 500
