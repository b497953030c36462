"""Global search in one frame: random candidates are scored at low resolution, the best distinct ones optimised."""

from __future__ import annotations

import numpy as np

from dvrk_cmaes.config import EstimateConfig
from dvrk_cmaes.evidence.gather import Evidence
from dvrk_cmaes.geometry import Float64, Indices, Posed
from dvrk_cmaes.joints.prior import Readings
from dvrk_cmaes.pose.search import minimise_each
from dvrk_cmaes.pose.search.modes import PoseCandidate, first_of_modes
from dvrk_cmaes.pose.search.objective import Objective
from dvrk_cmaes.pose.search.screening import screened, screening_size
from dvrk_cmaes.pose.search.starts import draw_starts
from dvrk_cmaes.silhouette import Body, Renderer
from dvrk_cmaes.silhouette.prepare import decimated_body

_POSE_SCALE = np.array([1e-3, 1e-3, 3e-3, np.deg2rad(4), np.deg2rad(4), np.deg2rad(15)])
"""Expected errors of a start: along the root's x, y and z axes, m, and about them, rad."""
_LEAST_AREA = 150.0  # px of a mask in the search's image
_RANKED, _RANKED_BY_IMAGE = 200, 60  # best candidates among which distinct ones are chosen
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
) -> tuple[list[PoseCandidate], list[Renderer]]:
    """Search one frame for candidate poses.

    Returns the candidates and the renderers used. The candidates are the results of the optimiser from each start, then
    the best of those drawn without readings, ranked without the readings term, then further distinct candidates that
    scored best (the spares); each of these groups is sorted by loss.
    """
    rng = np.random.default_rng(config.seed)
    search = config.search

    def objective(body: Body, size: tuple[int, int]) -> Objective:
        sized = Renderer(body, renderer.camera, threads=renderer.threads).at(*size)
        return Objective(sized, evidence, readings, config.weights, decay=config.decay_px, field=config.distance_field)

    size = search_size(evidence, search.width_px)
    fine = objective(renderer.body, size)
    coarse = []
    if search.screened < search.samples and (smaller := screening_size(evidence, size, search)) is not None:
        coarse.append(objective(decimated_body(renderer.body, search.screen_detail_m), smaller))
    drawn, unread = draw_starts(evidence, renderer.body.instrument, readings, config, rng)
    scored = screened(coarse, fine, drawn, unread, search.screened)
    most = search.starts + search.spares
    distinct = _distinct(scored.at, scored.losses, _RANKED, most)
    starts, spares = distinct[: search.starts], distinct[search.starts :]
    unread_spares = _distinct(scored.at, scored.by_image, _RANKED_BY_IMAGE, search.unread_spares)
    scale = scale_of_change(readings)

    begin = Posed.stacked([start.at for start in starts])

    def loss(index: Indices, change: Float64) -> Float64:
        return fine.cost(begin[index].moved(change * scale))

    known = [start.score for start in starts]
    least = minimise_each(search.method, loss, known, len(scale), search.evaluations, config.seed)
    searched = [
        start if found.loss >= start.score else PoseCandidate(start.at.moved(found.best * scale), found.loss)
        for start, found in zip(starts, least, strict=True)
    ]
    found = [*sorted(searched, key=lambda candidate: candidate.score), *unread_spares, *spares]
    return found, [each.renderer for each in (*coarse, fine)]


def _distinct(at: Posed, losses: Float64, ranked: int, most: int) -> list[PoseCandidate]:
    """Return at most ``most`` distinct candidates among the best ``ranked``, the best first."""
    best = np.argsort(losses, kind="stable")[:ranked]
    best = best[np.isfinite(losses[best])]
    kept = best[first_of_modes(at[best], angle=np.deg2rad(20), joint=np.deg2rad(17), most=most)]
    return [PoseCandidate(at[i], float(losses[i])) for i in kept]
