"""The global searches on a loss with known minimum."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable

import numpy as np
import pytest

from dvrk_cmaes import InputError
from dvrk_cmaes.pose.search import METHODS, minimise_each

GOAL = np.array([0.7, -0.4, 1.1])


def bowl(candidates: np.ndarray) -> np.ndarray:
    return ((candidates - GOAL) ** 2).sum(axis=1)


def minimise(
    method: str, loss: Callable[[np.ndarray], np.ndarray], evaluations: int, seed: int
) -> tuple[np.ndarray, float]:
    known, spread = loss(np.zeros((1, 3))), np.eye(3)[None]
    best, losses = minimise_each(method, lambda _, candidates: loss(candidates), known, spread, evaluations, seed)
    return best[0], float(losses[0])


@pytest.mark.parametrize("method", METHODS)
def test_search_approaches_minimum_within_budget(method: str) -> None:
    counted = 0

    def loss(candidates: np.ndarray) -> np.ndarray:
        nonlocal counted
        counted += len(candidates)
        return bowl(candidates)

    best, least = minimise(method, loss, 1500, seed=1)
    assert least == pytest.approx(float(bowl(best[None])[0]))
    assert np.abs(best - GOAL).max() < 0.35
    assert counted <= 1501


@pytest.mark.parametrize("method", METHODS)
def test_same_seed_gives_same_result(method: str) -> None:
    first, second = (minimise(method, bowl, 200, seed=5) for _ in range(2))
    np.testing.assert_array_equal(first[0], second[0])


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
        minimise(method, broken, 200, seed=0)


def test_unknown_search_is_refused() -> None:
    with pytest.raises(InputError, match="search: expected one of cmaes"):
        minimise("cma-es", bowl, 10, seed=0)


def test_cmaes_is_imported_at_the_first_search_without_scipy_stats() -> None:
    code = (
        "import sys; import numpy as np; from dvrk_cmaes.pose.search import minimise_each; "
        "before = 'cmaes' in sys.modules; "
        "minimise_each('cmaes', lambda _, x: (x * x).sum(axis=1), np.ones(1), np.eye(3)[None], 40, seed=0); "
        "print(before, 'cmaes' in sys.modules, 'scipy' in sys.modules); "
        "from scipy import stats; print(stats.norm)"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert run.stdout.split()[:3] == ["False", "True", "False"]


def test_populations_of_all_starts_are_evaluated_together_and_the_best_starts_go_on() -> None:
    near = np.array([[0.3, -0.2, 0.4], [0.0, 0.0, 0.0], [0.1, 0.2, 0.0], [0.5, 0.0, 0.9], [0.2, -0.3, 0.8]])
    shifts = np.concatenate([near, [[-9.0, 0.5, 0.2]]])
    asked = []

    def of_starts(start: np.ndarray, candidates: np.ndarray) -> np.ndarray:
        asked.append(start)
        return bowl(shifts[start] + candidates)

    best, losses = minimise_each("cmaes", of_starts, bowl(shifts), np.stack([np.eye(3)] * 6), 600, seed=4)
    assert set(asked[0]) == {*range(6)}
    assert 5 not in asked[-1]
    assert len({*asked[-1]}) == 4
    assert sum(map(len, asked)) <= 600
    np.testing.assert_allclose(losses, bowl(shifts + best))
    assert losses.min() < 0.02
    assert len(minimise_each("cmaes", of_starts, np.empty(0), np.empty((0, 3, 3)), 100, seed=4)[0]) == 0
