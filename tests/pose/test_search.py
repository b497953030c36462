"""The optimisers of the search."""

from __future__ import annotations

import cmaes
import numpy as np

from dvrk_cmaes.geometry import Float64, Indices
from dvrk_cmaes.pose.search.global_search import minimise_each


def test_each_start_is_optimised_as_by_the_package_cmaes() -> None:
    """With four starts all have each generation."""
    rng = np.random.default_rng(5)
    roots, targets = rng.normal(size=(4, 9, 9)), rng.normal(size=(4, 9))
    covariances = roots @ roots.swapaxes(1, 2) / 9 + 0.05 * np.eye(9)

    def loss(start: Indices, x: Float64) -> Float64:
        return np.asarray(((x - targets[start]) ** 2).sum(axis=1) + np.abs(x).sum(axis=1))

    found, losses = minimise_each("cmaes", loss, np.full(4, np.inf), covariances, 4 * 10 * 12, seed=7)
    for k in range(4):
        cma = cmaes.CMA(mean=np.zeros(9), sigma=1.0, seed=7 + k, population_size=10, cov=covariances[k].copy())
        seen = list[tuple[Float64, float]]()
        for _ in range(12):
            drawn = [cma.ask() for _ in range(10)]
            told = list(zip(drawn, loss(np.full(10, k), np.array(drawn)).tolist(), strict=True))
            seen += told
            cma.tell(told)
        best, least = min(seen, key=lambda one: one[1])
        np.testing.assert_allclose(found[k], best, rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(losses[k], least, rtol=1e-9)
