"""Global search in one frame: random candidates are scored at low resolution, the best distinct ones optimised."""

from __future__ import annotations

import numpy as np

from dvrk_cmaes.config import EstimateConfig
from dvrk_cmaes.evidence.gather import Evidence
from dvrk_cmaes.geometry import Float64, Indices, Posed
from dvrk_cmaes.instrument import Instrument
from dvrk_cmaes.joints.prior import Readings
from dvrk_cmaes.pose.search import minimise_each
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
