"""Global search in one frame: random candidates are scored at low resolution, the best distinct ones optimised.

The optimisers are, by name, CMA-ES, and NLopt's methods without derivatives. CMA-ES runs from all starts side by side:
the populations of a generation are evaluated together, which costs less than one after another, and only the best
starts have another generation, so that most evaluations go to the likely modes. NLopt evaluates one candidate after
another.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable

import numpy as np

from dvrk_cmaes.config import EstimateConfig
from dvrk_cmaes.errors import InputError, nearest_first
from dvrk_cmaes.evidence.gather import Evidence
from dvrk_cmaes.geometry import Float64, Indices, Posed
from dvrk_cmaes.instrument import Instrument
from dvrk_cmaes.joints.prior import Readings
from dvrk_cmaes.pose.search.objective import Objective
from dvrk_cmaes.pose.search.starts import PoseCandidate, draw_starts, first_of_modes, twin_of
from dvrk_cmaes.silhouette import Renderer
from dvrk_cmaes.silhouette.moving_points import moving_points

_POSE_SCALE = np.array([1e-3, 1e-3, 3e-3, np.deg2rad(4), np.deg2rad(4), np.deg2rad(15)])
"""Expected errors of a start: along the root's x, y and z axes, m, and about them, rad."""
_LEAST_AREA = 150.0  # px of a mask in the search's image
_SPREAD_PX, _SPREAD = 1.0, 3.0  # of the first population: px of the search's image, and expected errors at most
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

    Returns what the optimiser found from each start, the best first, and the renderer used. The starts are the best
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
    found = begin.moved(best * scale)
    return [PoseCandidate(found[k], float(least[k])) for k in np.argsort(least, kind="stable")], sized


def _spreads(renderer: Renderer, at: Posed, scale: Float64) -> Float64:
    """Return the covariances (S, D, D) of the first candidates about S starts, in units of ``scale`` (D,).

    They move the outline in the search's image by about ``_SPREAD_PX`` in all directions. Where the outline hardly
    moves, they are limited to ``_SPREAD`` times the expected errors.
    """
    outlines = renderer.outlines(at.pose, at.joints)
    covariances = []
    for outline, moving in zip(
        outlines, moving_points(renderer.body.instrument, renderer.camera, outlines, at), strict=True
    ):
        length = np.maximum(np.linalg.norm(outline.normals, axis=1), 1e-9)
        moved = moving.jacobian * scale
        information = moved.T @ (moved / length[:, None]) / max(float(length.sum()), 1.0)
        widest = np.eye(len(scale)) / _SPREAD**2
        covariances.append(np.linalg.inv(len(scale) / _SPREAD_PX**2 * information + widest))
    return np.stack(covariances)


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
_POPULATION = 10  # candidates of CMA-ES in a generation of a start
_CONTINUING = 0.85  # share of the starts, the best ones, that have another generation
_LEAST = 4  # starts that have another generation
_LEAST_VARIANCE = 1e-8  # along an axis of CMA-ES
_RUN = 20  # evaluations for each parameter of a run by NLopt, of which there are as many as the budget allows


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
    """Search by CMA-ES from all starts at once; equations (eq.) are of Hansen's tutorial, arXiv 1604.00772."""
    count, dimension = covariances.shape[:2]
    population, parents = _POPULATION, _POPULATION // 2
    raw = np.log((population + 1) / 2) - np.log(np.arange(population) + 1.0)  # eq. 49
    mu, mu_of_others = (part.sum() ** 2 / (part**2).sum() for part in (raw[:parents], raw[parents:]))
    c_1 = 2 / ((dimension + 1.3) ** 2 + mu)  # eq. 57
    c_mu = 2 * (mu - 2 + 1 / mu) / ((dimension + 2) ** 2 + mu)  # eq. 58
    negative = min(
        1 + c_1 / c_mu, 1 + 2 * mu_of_others / (mu + 2), (1 - c_1 - c_mu) / (dimension * c_mu)
    )  # eq. 50 to 52
    weights = np.where(raw >= 0, raw / raw[raw > 0].sum(), negative * raw / -raw[raw < 0].sum())  # eq. 53
    c_sigma = (mu + 2) / (dimension + mu + 5)  # eq. 55
    damping = 1 + 2 * max(0.0, np.sqrt((mu - 1) / (dimension + 1)) - 1) + c_sigma
    c_c = (4 + mu / dimension) / (dimension + 4 + 2 * mu / dimension)  # eq. 56
    usual = np.sqrt(dimension) * (1 - 1 / (4 * dimension) + 1 / (21 * dimension**2))  # length of a normal vector

    sizes, size = list[int](), count  # of the starts that have each generation
    while population * (sum(sizes) + size) <= evaluations:
        sizes.append(size)
        size = min(max(int(_CONTINUING * size), _LEAST), size)
    normal, random = np.empty((count, len(sizes), population, dimension)), np.random.RandomState()
    for k in range(count):
        random.seed((seed + k) % SEEDS)
        normal[k] = random.standard_normal(normal.shape[1:])
    mean, c_path, sigma_path = np.zeros((3, count, dimension))
    sigma, covariance = np.ones((count, 1)), covariances.copy()
    best, losses, active = np.zeros((count, dimension)), known.copy(), np.arange(count)
    for generation in range(len(sizes)):
        values, axes = np.linalg.eigh(covariance[active])
        roots = axes * (lengths := np.sqrt(np.maximum(values, _LEAST_VARIANCE))[:, None])
        steps = (roots[:, None] @ normal[active, generation, ..., None])[..., 0]  # eq. 39
        drawn = mean[active, None] + sigma[active, None] * steps  # eq. 40
        found = loss(np.repeat(active, population), drawn.reshape(-1, dimension)).reshape(-1, population)
        ranks = np.argsort(found, axis=1, kind="stable")
        first, lowest = drawn[np.arange(len(active)), ranks[:, 0]], found.min(axis=1)
        better = lowest < losses[active]
        best[active[better]], losses[active[better]] = first[better], lowest[better]
        if generation + 1 == len(sizes):
            break
        kept = np.sort(np.argsort(losses[active], kind="stable")[: sizes[generation + 1]])
        active, axes, lengths, roots = active[kept], axes[kept], lengths[kept], roots[kept]
        steps = np.take_along_axis(steps[kept], ranks[kept, :, None], axis=1)
        step = (steps[:, :parents] * weights[:parents, None]).sum(axis=1)  # eq. 41
        mean[active] += sigma[active] * step  # eq. 42
        inverse_root = axes / lengths @ axes.swapaxes(1, 2)
        turned = np.sqrt(c_sigma * (2 - c_sigma) * mu) * (inverse_root @ step[..., None])[..., 0]
        sigma_path[active] = (1 - c_sigma) * sigma_path[active] + turned  # eq. 43
        length = np.linalg.norm(sigma_path[active], axis=1, keepdims=True)
        sigma[active] *= np.exp(c_sigma / damping * (length / usual - 1))  # eq. 44
        slow = length / np.sqrt(1 - (1 - c_sigma) ** (2 * generation + 4)) < (1.4 + 2 / (dimension + 1)) * usual
        c_path[active] = (1 - c_c) * c_path[active] + slow * np.sqrt(c_c * (2 - c_c) * mu) * step  # eq. 45
        squares = ((inverse_root @ steps.swapaxes(1, 2)) ** 2).sum(axis=1)
        scaled = weights * np.where(weights >= 0, 1, dimension / (squares + _LEAST_VARIANCE))  # eq. 46
        left = 1 + c_1 * (1 - slow) * c_c * (2 - c_c) - c_1 - c_mu * weights.sum()
        one = c_path[active, :, None] * c_path[active, None]
        several = (steps * scaled[..., None]).swapaxes(1, 2) @ steps
        covariance[active] = left[..., None] * (roots @ roots.swapaxes(1, 2)) + c_1 * one + c_mu * several  # eq. 47
    return best, losses
