"""CMA-ES and NLopt's global methods by name."""

from __future__ import annotations

import functools
import importlib.util
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.errors import InputError, nearest_first
from dvrk_cmaes.pose.search.nlopt_run import run_nlopt

Float64 = NDArray[np.float64]
Loss = Callable[[Float64], Float64]
"""Losses (n,) of candidates (n, D)."""

NLOPT_GLOBAL = {"crs2": "GN_CRS2_LM", "esch": "GN_ESCH", "isres": "GN_ISRES", "direct-l": "GN_DIRECT_L"}
METHODS = ("cmaes", *NLOPT_GLOBAL)
"""Names of the global searches."""

POPULATION = 16
BOX = 3.0
"""Half width of the search box, in units of the start's scale."""


@dataclass(frozen=True, eq=False)
class Found:
    """Best candidate (D,) of a search, its loss, and how many were evaluated."""

    best: Float64
    loss: float
    evaluations: int


def minimise(method: str, loss: Loss, dimension: int, evaluations: int, seed: int) -> Found:
    """Search the box [-3, 3]^D around a start at 0, whose coordinates are in units of their expected error.

    Raises `InputError` for an unknown method.
    """
    if method == "cmaes":
        return _cmaes(loss, dimension, evaluations, seed)
    if method in NLOPT_GLOBAL:
        best, value, count = run_nlopt(
            NLOPT_GLOBAL[method], loss, np.zeros(dimension), BOX * np.ones(dimension), evaluations, seed
        )
        return Found(best, value, count)
    raise InputError(f"search: expected one of {', '.join(nearest_first(method, METHODS))}, got {method!r}")


@functools.cache
def _cma_class() -> Any:
    """Class CMA of the package cmaes.

    Taken from its own module: the package's first lines import all its variants, and with them half a second of
    SciPy's statistics.
    """
    package = importlib.util.find_spec("cmaes")
    places = [] if package is None else [Path(place) / "_cma.py" for place in package.submodule_search_locations or ()]
    for place in places:
        spec = importlib.util.spec_from_file_location("dvrk_cmaes.pose.search._cma", place)
        if place.is_file() and spec is not None and spec.loader is not None:
            module = importlib.util.module_from_spec(spec)
            spec.loader.exec_module(module)
            return module.CMA
    from cmaes import CMA

    return CMA


def _cmaes(loss: Loss, dimension: int, evaluations: int, seed: int) -> Found:
    bounds = np.tile([-BOX, BOX], (dimension, 1)).astype(np.float64)
    optimiser = _cma_class()(
        mean=np.zeros(dimension), sigma=0.6, bounds=bounds, seed=seed, population_size=POPULATION, n_max_resampling=10
    )
    start = np.zeros((1, dimension))
    best, best_loss = start[0], float(loss(start)[0])
    count = 1
    while count + POPULATION <= evaluations and not optimiser.should_stop():
        candidates = np.stack([optimiser.ask() for _ in range(POPULATION)])
        values = loss(candidates)
        count += POPULATION
        lowest = int(np.argmin(values))
        if values[lowest] < best_loss:
            best, best_loss = candidates[lowest], float(values[lowest])
        optimiser.tell([(x, float(v)) for x, v in zip(candidates, values, strict=True)])
    return Found(best, best_loss, count)
