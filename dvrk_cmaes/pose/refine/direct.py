"""Local refinement on the full loss without analytic derivatives: the paper's coordinate descent, and NLopt.

The paper alternates gradient steps in rotation and in translation, with Gaussian perturbations. Here the gradient is
computed by central differences of the loss, which is continuous in the pose; all candidates of a step are evaluated
together.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from dvrk_cmaes.errors import InputError, nearest_first
from dvrk_cmaes.geometry import Float64, Posed
from dvrk_cmaes.pose.search.nlopt_run import run_nlopt

Loss = Callable[[Float64], Float64]

_NLOPT_LOCAL = {"bobyqa": "LN_BOBYQA", "sbplx": "LN_SBPLX"}


def refine_direct(
    method: str, cost: Callable[[Posed], Float64], start: Posed, scale: Float64, evaluations: int, seed: int
) -> tuple[Posed, int]:
    """Minimise the cost (C,) of C poses near one; parameters are small changes in units of their expected error.

    ``scale`` (6 + J,) are these units. Returns the best pose and the number of evaluations. Raises `InputError` for an
    unknown method.
    """

    def loss(change: Float64) -> Float64:
        return cost(start.moved(change * scale))

    change, _, count = _minimise(method, loss, len(scale), evaluations, seed)
    return start.moved(change * scale), count


def _minimise(method: str, loss: Loss, dimension: int, evaluations: int, seed: int) -> tuple[Float64, float, int]:
    """Minimise a loss near 0; returns the best change (D,), its loss and the number of evaluations."""
    if method in _NLOPT_LOCAL:
        return run_nlopt(
            _NLOPT_LOCAL[method],
            loss,
            np.zeros(dimension),
            3.0 * np.ones(dimension),
            evaluations,
            seed,
            step=0.3,
            tolerance=1e-4,
        )
    if method == "coordinate-descent":
        return _coordinate_descent(loss, dimension, evaluations, seed)
    known = ("gauss-newton", "coordinate-descent", *_NLOPT_LOCAL)
    raise InputError(f"refine: expected one of {', '.join(nearest_first(method, known))}, got {method!r}")


def _coordinate_descent(loss: Loss, dimension: int, evaluations: int, seed: int) -> tuple[Float64, float, int]:
    """Alternate gradient steps in rotation with the joints and in translation; accept those that reduce the loss."""
    rng = np.random.default_rng(seed)
    blocks = [np.r_[3:dimension], np.r_[0:3]]
    x = np.zeros(dimension)
    best, best_loss, count = x, float(loss(x[None])[0]), 1
    step = np.array([0.3, 0.3])
    turn = 0
    while True:
        block = blocks[turn % 2]
        probe = np.zeros((2 * len(block), dimension))
        probe[np.arange(len(block)), block] = 0.02
        probe[len(block) + np.arange(len(block)), block] = -0.02
        trials = 4
        if count + len(probe) + trials > evaluations:
            return best, best_loss, count
        values = loss(best + probe)
        gradient = np.zeros(dimension)
        gradient[block] = (values[: len(block)] - values[len(block) :]) / 0.04
        length = float(np.linalg.norm(gradient))
        direction = -gradient / length if length > 0 else gradient
        reach = step[turn % 2] * np.array([1.0, 0.5, 0.25, 0.125])
        noise = np.zeros((trials, dimension))
        noise[:, block] = 0.1 * reach[:, None] * rng.standard_normal((trials, len(block)))
        candidates = best + reach[:, None] * direction + noise
        values = loss(candidates)
        count += len(probe) + trials
        lowest = int(np.argmin(values))
        if values[lowest] < best_loss:
            best, best_loss = candidates[lowest], float(values[lowest])
            step[turn % 2] = min(2 * reach[lowest], 1.0)
        else:
            step[turn % 2] = max(step[turn % 2] / 4, 1e-4)
        turn += 1
