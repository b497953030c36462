"""Global search in one frame: random candidates are scored at low resolution, the best distinct ones optimised.

The optimisers are, by name, CMA-ES, and NLopt's methods without derivatives. CMA-ES runs from all starts side by side:
the populations of a generation are evaluated together, which costs less than one after another, and only the best
starts have another generation, so that most evaluations go to the likely modes. NLopt evaluates one candidate after
another.
"""

from __future__ import annotations

import contextlib
import sys
import threading
from collections.abc import Callable
from typing import Any

import numpy as np

from dvrk_cmaes.config import EstimateConfig
from dvrk_cmaes.errors import InputError, nearest_first
from dvrk_cmaes.evidence.gather import Evidence
from dvrk_cmaes.geometry import Float64, Indices, Posed
from dvrk_cmaes.instrument import Instrument
from dvrk_cmaes.joints.prior import Readings
from dvrk_cmaes.pose.search.objective import Objective
from dvrk_cmaes.pose.search.starts import PoseCandidate, best_per_mode, draw_starts, first_of_modes, twin_of
from dvrk_cmaes.silhouette import Renderer
from dvrk_cmaes.silhouette.moving_points import moving_points
from dvrk_cmaes.silhouette.prepare import body_by

_POSE_SCALE = np.array([1e-3, 1e-3, 3e-3, np.deg2rad(4), np.deg2rad(4), np.deg2rad(15)])
"""Expected errors of a start: along the root's x, y and z axes, m, and about them, rad."""
_LEAST_AREA = 150.0  # px of a mask in the search's image
_SPREAD_PX, _SPREAD = 1.5, 3.0  # of the first population: px of the search's image, and expected errors at most
_MODES, _LEGIBLE = 12, 200.0  # best modes that the search returns; px of a mask there, below which it returns all
_DISTINCT = float(np.deg2rad(20)), float(np.deg2rad(17))  # rotation, or a joint, by which starts differ
_JOINT_SCALE = 0.5  # expected error of a start's joints, in standard deviations of the readings


def scale_of_change(readings: Readings) -> Float64:
    """Return the units of the optimisers' parameters: expected errors of the changes [t, r, joints], (6 + J,)."""
    return np.concatenate([_POSE_SCALE, _JOINT_SCALE * readings.sigma])


def search_size(evidence: Evidence, width: int) -> tuple[int, int]:
    """Return width and height, px, of the search's image: ``width`` px wide, or up to twice that for a small mask.

    It is larger where nothing of the instrument, or of the background, would show.
    """
    camera = evidence.camera
    coarsest, finest = (max(1, round(camera.width / each)) for each in (width, 2 * width))
    legible = int(np.sqrt(np.count_nonzero(evidence.mask) / _LEAST_AREA))
    shrink = min(max(legible, finest), coarsest)
    sizes = ((max(camera.width // by, 1), max(camera.height // by, 1)) for by in range(shrink, 0, -1))
    return next(size for size in sizes if evidence.shows_both(*size))


def find_candidates(
    renderer: Renderer, evidence: Evidence, readings: Readings, config: EstimateConfig
) -> tuple[list[PoseCandidate], Renderer]:
    """Search one frame for candidate poses.

    Returns the best modes that the optimiser found, the best first, and the renderer used. The starts are the best
    distinct candidates drawn; a quarter of them are the best of those drawn without readings, by the loss without the
    readings' term, so that the outline can contradict wrong readings. Of a pose and its mirror twin, which have nearly
    the same silhouette, only the one nearer to the readings is searched.
    """
    search, instrument = config.search, renderer.body.instrument
    sized = renderer.at(*search_size(evidence, search.width_px))
    objective = Objective(sized, evidence, readings, config)
    drawn, uniform = draw_starts(evidence, instrument, readings, config, np.random.default_rng(config.seed))
    if instrument.has_twin:
        drawn = _towards_readings(instrument, readings, drawn)
    terms = objective.terms(drawn)
    losses = terms.total(config.weights)
    by_image = np.where(uniform, losses - config.weights.readings * terms.readings, np.inf)
    of_uniform = search.starts // 4
    chosen = _distinct(instrument, drawn, losses, search.starts - of_uniform)
    chosen += _distinct(instrument, drawn, by_image, of_uniform)
    starts = np.array(sorted(set(chosen), key=lambda k: losses[k]))
    begin, scale = drawn[starts], scale_of_change(readings)

    def loss(index: Indices, change: Float64) -> Float64:
        return objective.cost(begin[index].moved(change * scale))

    spreads = _spreads(sized, begin, scale)
    best, least = minimise_each(search.method, loss, losses[starts], spreads, search.evaluations, config.seed)
    at = begin.moved(best * scale)
    found = [PoseCandidate(at[k], value) for k, value in enumerate(least.tolist())]
    shown = float(evidence.at_size(sized.camera.width, sized.camera.height)[0].sum())
    return best_per_mode(found, most=_MODES if shown > _LEGIBLE else None, mirrored=instrument), sized


def _spreads(renderer: Renderer, at: Posed, scale: Float64) -> Float64:
    """Return the covariances (S, D, D) of the first candidates about S starts, in units of ``scale`` (D,).

    They move the outline in the search's image by about ``_SPREAD_PX`` in all directions. Where the outline hardly
    moves, they are limited to ``_SPREAD`` times the expected errors.
    """
    counting = Renderer(body_by(renderer.body, "count"), renderer.camera, threads=renderer.threads)
    outlines = counting.outlines(at.pose, at.joints)
    informations = []
    each_moving = moving_points(renderer.body.instrument, renderer.camera, outlines, at)
    for outline, moving in zip(outlines, each_moving, strict=True):
        length = np.maximum(np.linalg.norm(outline.normals, axis=1), 1e-9)
        moved = moving.jacobian * scale
        informations.append(moved.T @ (moved / length[:, None]) / max(float(length.sum()), 1.0))
    wide = np.eye(len(scale)) / _SPREAD**2
    return np.asarray(np.linalg.inv(len(scale) / _SPREAD_PX**2 * np.stack(informations) + wide))


def _towards_readings(instrument: Instrument, readings: Readings, at: Posed) -> Posed:
    """Return N poses, or their mirror twins where these are nearer to the readings."""
    twins = twin_of(instrument, at)
    nearer = readings.cost(twins.joints) < readings.cost(at.joints)
    return Posed(
        np.where(nearer[:, None, None], twins.pose, at.pose), np.where(nearer[:, None], twins.joints, at.joints)
    )


def _distinct(instrument: Instrument, at: Posed, losses: Float64, most: int) -> list[int]:
    """Return the indices of at most ``most`` distinct poses with finite losses, the best first."""
    ranked = np.argsort(losses, kind="stable")
    ranked = ranked[np.isfinite(losses[ranked])]
    angle, joint = _DISTINCT
    kept = first_of_modes(at[ranked], angle=angle, joint=joint, most=most, mirrored=instrument)
    return [int(k) for k in ranked[kept]]


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
_POPULATION = 8  # candidates of CMA-ES in a generation of a start
_CONTINUING = 0.5  # share of the starts, the best ones, that have another generation
_LEAST = 12  # starts that have another generation
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
