"""Run an NLopt optimiser with a fixed number of evaluations, and propagate exceptions of the loss."""

from __future__ import annotations

import contextlib
from collections.abc import Callable

import numpy as np

from dvrk_cmaes.geometry import Float64

_LARGE = 1e12


def run_nlopt(
    algorithm: str,
    loss: Callable[[Float64], Float64],
    start: Float64,
    half_width: Float64,
    evaluations: int,
    seed: int,
    *,
    step: float = 0.5,
    tolerance: float = 0.0,
) -> tuple[Float64, float, int]:
    """Minimise a loss in the box ``start`` +- ``half_width`` with an algorithm of NLopt.

    ``loss`` maps candidates (1, D) to values (1,). Returns the best point evaluated (D,), its loss and the number of
    evaluations. An exception in the loss ends the run and is raised unchanged; NLopt would replace some exceptions by
    others.
    """
    import nlopt

    nlopt.srand(seed + 1)  # per thread; a seed of 0 would use the current time
    optimiser = nlopt.opt(getattr(nlopt, algorithm), len(start))
    optimiser.set_lower_bounds((start - half_width).tolist())
    optimiser.set_upper_bounds((start + half_width).tolist())
    optimiser.set_maxeval(evaluations)
    optimiser.set_initial_step(step)
    if tolerance:
        optimiser.set_xtol_abs(tolerance)
    best, best_loss, count = start.copy(), np.inf, 0
    caught: list[BaseException] = []

    def evaluate(x: Float64, _gradient: Float64) -> float:
        nonlocal best, best_loss, count
        if caught or count >= evaluations:  # some algorithms check their limit only between iterations
            optimiser.force_stop()
            return _LARGE
        point = np.array(x, dtype=np.float64)  # copied, because NLopt reuses the memory of x
        try:
            value = float(loss(point[None])[0])
        except BaseException as error:
            caught.append(error)
            optimiser.force_stop()
            return _LARGE
        count += 1
        if not np.isfinite(value):
            return _LARGE
        if value < best_loss:
            best, best_loss = point, value
        return value

    optimiser.set_min_objective(evaluate)
    with contextlib.suppress(nlopt.RoundoffLimited, nlopt.ForcedStop):  # the best point is recorded in evaluate
        optimiser.optimize(start.tolist())
    if caught:
        raise caught[0]
    return best, float(best_loss), count
