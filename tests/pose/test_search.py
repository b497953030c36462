"""The global searches and the direct refinements on a loss with known minimum."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest
from helpers.transforms import lookat_pose

from dvrk_cmaes import Body, Camera, InputError
from dvrk_cmaes.evidence.gather import gather_evidence
from dvrk_cmaes.geometry import Posed
from dvrk_cmaes.pose.refine.direct import refine_direct
from dvrk_cmaes.pose.search import METHODS, minimise, minimise_each
from dvrk_cmaes.pose.search.global_search import search_size

CAMERA = Camera(640, 480, 800.0, 800.0, 319.5, 239.5)
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


@pytest.mark.parametrize(("side", "expected"), [(240, (80, 60)), (70, (128, 96)), (8, (160, 120))])
def test_small_masks_are_searched_in_larger_images(bundled_body: Body, side: int, expected: tuple[int, int]) -> None:
    mask = np.zeros((480, 640), dtype=np.bool_)
    mask[100 : 100 + side, 200 : 200 + side] = True
    evidence = gather_evidence(mask, CAMERA, bundled_body.instrument)
    assert search_size(evidence, 80) == expected


@pytest.mark.parametrize("method", METHODS)
def test_starts_searched_together_find_what_each_finds_alone(method: str) -> None:
    shifts = np.array([[0.0, 0.0, 0.0], [0.3, -0.2, 0.4], [-1.0, 0.5, 0.2]])
    known = bowl(shifts)
    calls = 0

    def of_starts(start: np.ndarray, candidates: np.ndarray) -> np.ndarray:
        nonlocal calls
        calls += 1
        return bowl(shifts[start] + candidates)

    together = minimise_each(method, of_starts, known.tolist(), 3, 100, seed=4)
    counted = calls
    assert len(together) == 3
    for number, found in enumerate(together):
        alone = minimise(method, lambda x, by=shifts[number]: bowl(by + x), 3, 100, seed=4 + number)
        np.testing.assert_array_equal(found.best, alone.best)
        assert found.loss == pytest.approx(alone.loss)
    if method == "cmaes":
        assert counted == (100 - 1) // 16  # populations of 16 of all starts; the starts themselves are known
    assert minimise_each(method, of_starts, [], 3, 100, seed=4) == []
