"""The optimisers of the global search by name: CMA-ES and the global methods of NLopt."""

from __future__ import annotations

import sys
import threading
from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from dvrk_cmaes.errors import InputError, nearest_first
from dvrk_cmaes.geometry import Float64, Indices
from dvrk_cmaes.pose.search.nlopt_run import run_nlopt

Loss = Callable[[Float64], Float64]
"""A function of candidates (n, D) that returns their losses (n,)."""

NLOPT_GLOBAL = {"crs2": "GN_CRS2_LM", "esch": "GN_ESCH", "isres": "GN_ISRES", "direct-l": "GN_DIRECT_L"}
METHODS = ("cmaes", *NLOPT_GLOBAL)
"""Names of the optimisers."""

LossOfStarts = Callable[[Indices, Float64], Float64]
"""A function of the index (n,) of a start, and of candidates (n, D) beside that start, that returns the losses (n,)."""
_Search = Generator[Float64, Float64, "Found"]
"""A search that gives candidates (n, D), takes their losses (n,), and returns what it found."""

SEEDS = 2**32
"""Number of different seeds."""
POPULATION = 16
"""Population size of CMA-ES."""
_SPREAD = 0.6  # standard deviation of its first population, in units of the expected error of the start
BOX = 3.0
"""Half the side of the search box, in units of the expected error of the start."""


_importing = threading.Lock()
_STATISTICS = "scipy.stats"


@dataclass(frozen=True, eq=False)
class Found:
    """Best candidate (D,) of a search, its loss, and the number of evaluations."""

    best: Float64
    loss: float
    evaluations: int


def minimise(method: str, loss: Loss, dimension: int, evaluations: int, seed: int) -> Found:
    """Minimise a loss in the box [-3, 3]^D around the start 0; parameters are in units of their expected error.

    Raises `InputError` for an unknown method.
    """
    if method == "cmaes":
        return _together([_cmaes(None, dimension, evaluations, seed)], lambda _, candidates: loss(candidates))[0]
    if method in NLOPT_GLOBAL:
        best, value, count = run_nlopt(
            NLOPT_GLOBAL[method], loss, np.zeros(dimension), BOX * np.ones(dimension), evaluations, seed
        )
        return Found(best, value, count)
    raise InputError(f"search: expected one of {', '.join(nearest_first(method, METHODS))}, got {method!r}")


def minimise_each(
    method: str, loss: LossOfStarts, starts: Sequence[float], dimension: int, evaluations: int, seed: int
) -> list[Found]:
    """Minimise a loss as `minimise` does, from each of several starts whose losses are known.

    The seed of a start is ``seed`` plus its index, modulo `SEEDS`. The populations of all starts are evaluated
    together, which costs less than one after another: most of the time of a small population is that of calls.
    """
    if method == "cmaes":
        searches = [_cmaes(known, dimension, evaluations, (seed + k) % SEEDS) for k, known in enumerate(starts)]
        return _together(searches, loss)

    def alone(start: int) -> Found:
        def loss_of_start(candidates: Float64) -> Float64:
            return loss(np.full(len(candidates), start), candidates)

        return minimise(method, loss_of_start, dimension, evaluations, (seed + start) % SEEDS)

    return [alone(start) for start in range(len(starts))]


def _together(searches: Sequence[_Search], loss: LossOfStarts) -> list[Found]:
    """Run several searches side by side; the candidates that they give are evaluated together."""
    found: dict[int, Found] = {}
    given: dict[int, Float64] = {}

    def advance(number: int, losses: Float64 | None) -> None:
        try:
            search = searches[number]
            given[number] = next(search) if losses is None else search.send(losses)
        except StopIteration as stop:
            given.pop(number, None)
            found[number] = stop.value

    for number in range(len(searches)):
        advance(number, None)
    while given:
        numbers, counts = list(given), [len(candidates) for candidates in given.values()]
        values = loss(np.repeat(numbers, counts), np.concatenate(list(given.values())))
        for number, of_search in zip(numbers, np.split(values, np.cumsum(counts)[:-1]), strict=True):
            advance(number, of_search)
    return [found[number] for number in range(len(searches))]


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


def _cmaes(known: float | None, dimension: int, evaluations: int, seed: int) -> _Search:
    """Search by CMA-ES from 0, whose loss may be known."""
    bounds = np.tile([-BOX, BOX], (dimension, 1)).astype(np.float64)
    optimiser = _cma_class()(
        mean=np.zeros(dimension),
        sigma=_SPREAD,
        bounds=bounds,
        seed=seed,
        population_size=POPULATION,
        n_max_resampling=10,
    )
    start = np.zeros((1, dimension))
    best, best_loss = start[0], float((yield start)[0]) if known is None else known
    count = 1
    while count + POPULATION <= evaluations:
        if count == 1:  # the first population, as the optimiser would draw it, but all at once
            drawn = _SPREAD * np.random.default_rng(seed).standard_normal((POPULATION, dimension))
            candidates = np.clip(drawn, -BOX, BOX)
        else:
            candidates = np.stack([optimiser.ask() for _ in range(POPULATION)])
        values = yield candidates
        count += POPULATION
        lowest = int(np.argmin(values))
        if values[lowest] < best_loss:
            best, best_loss = candidates[lowest], float(values[lowest])
        if count + POPULATION > evaluations:
            break  # the distribution is not needed any more
        optimiser.tell([(x, float(v)) for x, v in zip(candidates, values, strict=True)])
        if optimiser.should_stop():
            break
    return Found(best, best_loss, count)
