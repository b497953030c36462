"""The optimisers of the global search by name: CMA-ES, and NLopt's methods without derivatives.

CMA-ES runs from all starts side by side: the populations of a generation are evaluated together, which costs less than
one after another, and only the best starts have another generation, so that most evaluations go to the likely modes.
NLopt evaluates one candidate after another.
"""

from __future__ import annotations

import contextlib
import sys
import threading
from collections.abc import Callable
from typing import Any

import numpy as np

from dvrk_cmaes.errors import InputError, nearest_first
from dvrk_cmaes.geometry import Float64, Indices

NLOPT = {
    "direct-l": "GN_DIRECT_L",
    "bobyqa": "LN_BOBYQA",
    "sbplx": "LN_SBPLX",
}
METHODS = ("cmaes", *NLOPT)
"""Names of the optimisers."""

LossOfStarts = Callable[[Indices, Float64], Float64]
"""A function of the index (n,) of a start, and of candidates (n, D) beside that start, that returns the losses (n,)."""

SEEDS = 2**32
"""Number of different seeds."""
BOX = 3.0
"""Half the side of the box of NLopt's methods, in units of the expected error of a start."""
_STEP = 0.5  # first step of NLopt's methods, in the same units
_LARGE = 1e12  # loss in place of one that is not finite
_POPULATION = 10  # candidates of CMA-ES in a generation of a start
_CONTINUING = 0.85  # share of the starts, the best ones, that have another generation
_LEAST = 4  # starts that have another generation
_RUN = 20  # evaluations for each parameter of a run by NLopt, of which there are as many as the budget allows

_importing = threading.Lock()
_STATISTICS = "scipy.stats"


def minimise_each(
    method: str, loss: LossOfStarts, known: Float64, covariances: Float64, evaluations: int, seed: int
) -> tuple[Float64, Float64]:
    """Minimise a loss from each of S starts 0, the best first, whose losses are known.

    Returns the best candidates (S, D) that were found from the starts, and their losses (S,). Parameters are in units
    of their expected error; ``covariances`` (S, D, D) are those of the first candidates of CMA-ES. At most
    ``evaluations`` candidates are evaluated in all; the seed of a start is ``seed`` plus its index, modulo `SEEDS`.
    Raises `InputError` for an unknown method.
    """
    dimension = covariances.shape[-1]
    if method == "cmaes":
        return _cmaes(loss, known, covariances, evaluations, seed)
    if method not in NLOPT:
        raise InputError(f"search: expected one of {', '.join(nearest_first(method, METHODS))}, got {method!r}")
    best, losses = np.zeros((len(known), dimension)), known.copy()
    runs = min(max(evaluations // (_RUN * dimension), 1), len(known))
    for start in range(runs):

        def of_start(candidates: Float64, start: int = start) -> Float64:
            return loss(np.full(len(candidates), start), candidates)

        found, value = _nlopt(NLOPT[method], of_start, dimension, evaluations // runs, seed + start)
        if value < losses[start]:
            best[start], losses[start] = found, value
    return best, losses


def _nlopt(
    algorithm: str, loss: Callable[[Float64], Float64], dimension: int, evaluations: int, seed: int
) -> tuple[Float64, float]:
    """Minimise a loss of candidates (1, D) from 0 in the box; returns the best candidate (D,) and its loss."""
    import nlopt

    nlopt.srand(seed + 1)  # per thread; a seed of 0 would use the current time
    optimiser = nlopt.opt(getattr(nlopt, algorithm), dimension)
    optimiser.set_lower_bounds([-BOX] * dimension)
    optimiser.set_upper_bounds([BOX] * dimension)
    optimiser.set_maxeval(evaluations)
    optimiser.set_initial_step(_STEP)
    best, least = np.zeros(dimension), np.inf

    def evaluate(x: Float64, _gradient: Float64) -> float:
        nonlocal best, least
        value = float(loss(x[None])[0])
        if value < least:
            best, least = np.array(x, dtype=np.float64), value  # copied, because NLopt reuses the memory of x
        return value if np.isfinite(value) else _LARGE

    optimiser.set_min_objective(evaluate)
    with contextlib.suppress(nlopt.RoundoffLimited):  # the best point is recorded in evaluate
        optimiser.optimize([0.0] * dimension)
    return best, least


def _cmaes(
    loss: LossOfStarts, known: Float64, covariances: Float64, evaluations: int, seed: int
) -> tuple[Float64, Float64]:
    """Search by CMA-ES from all starts."""
    cma, dimension = _cma_class(), covariances.shape[-1]
    optimisers = [
        cma(
            mean=np.zeros(dimension),
            sigma=1.0,
            seed=(seed + k) % SEEDS,
            population_size=_POPULATION,
            cov=covariance,
        )
        for k, covariance in enumerate(covariances)
    ]
    best, losses, left = np.zeros((len(known), dimension)), known.copy(), evaluations
    active = np.arange(len(known))
    while len(active) and (left := left - _POPULATION * len(active)) >= 0:
        drawn = np.array([[optimisers[k].ask() for _ in range(_POPULATION)] for k in active])
        values = loss(np.repeat(active, _POPULATION), drawn.reshape(-1, dimension)).reshape(-1, _POPULATION)
        lowest = drawn[np.arange(len(active)), values.argmin(axis=1)], values.min(axis=1)
        better = lowest[1] < losses[active]
        best[active[better]], losses[active[better]] = lowest[0][better], lowest[1][better]
        continuing = np.sort(np.argsort(losses[active], kind="stable")[: max(int(_CONTINUING * len(active)), _LEAST)])
        if left < _POPULATION * len(continuing):
            break
        for k, candidates, of_candidates in zip(active[continuing], drawn[continuing], values[continuing], strict=True):
            optimisers[k].tell(list(zip(candidates, of_candidates.tolist(), strict=True)))
        active = np.array([k for k in active[continuing] if not optimisers[k].should_stop()], dtype=np.intp)
    return best, losses


def _cma_class() -> Any:
    """Import the class CMA, without importing scipy.stats.

    The package cmaes works without SciPy. It imports scipy.stats, if it can, for variants of CMA-ES that are not used
    here, which takes half a second and 65 MB. Where no other thread could import SciPy meanwhile, all of it is left
    out, which takes 2 % of a whole command.
    """
    with _importing:
        names = [_STATISTICS] if "cmaes" not in sys.modules and _STATISTICS not in sys.modules else []
        if names and "scipy" not in sys.modules and threading.active_count() == 1:
            names.append("scipy")
        for name in names:
            sys.modules[name] = None  # type: ignore[assignment]  # its import fails from here on
        try:
            from cmaes import CMA
        finally:
            for name in names:
                del sys.modules[name]
    return CMA
