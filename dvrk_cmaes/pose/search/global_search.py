"""The global search in one frame: many candidates scored small, then a search from each of the best that differ."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.config import EstimateConfig
from dvrk_cmaes.evidence.gather import Evidence
from dvrk_cmaes.evidence.joint_prior import Readings
from dvrk_cmaes.geometry import moved
from dvrk_cmaes.pose.parallel import each
from dvrk_cmaes.pose.search import minimise
from dvrk_cmaes.pose.search.modes import best_of_each
from dvrk_cmaes.pose.search.objective import Objective
from dvrk_cmaes.pose.search.starts import draw_seeds
from dvrk_cmaes.silhouette import Renderer

Float64 = NDArray[np.float64]

#: Expected errors of a start: along the root's x, y, z (m), about them (rad).
_POSE_SCALE = np.array([1e-3, 1e-3, 3e-3, np.deg2rad(4), np.deg2rad(4), np.deg2rad(15)])
_JOINT_SCALE = 0.5  # of the readings' spread


@dataclass(frozen=True, eq=False)
class Candidate:
    """A pose (4, 4), its joints (J,) and its loss."""

    camera_from_root: Float64
    joints: Float64
    score: float


def scale_of_change(readings: Readings) -> Float64:
    """Units in which searches measure small changes [t, r, joints], (6 + J,)."""
    return np.concatenate([_POSE_SCALE, _JOINT_SCALE * readings.spread])


def image_size(evidence: Evidence, width: int) -> tuple[int, int]:
    """Width and height of the frame's image averaged down to about ``width`` px."""
    camera = evidence.camera
    shrink = max(1, round(camera.width / width))
    return max(camera.width // shrink, 1), max(camera.height // shrink, 1)


def find_candidates(
    renderer: Renderer, evidence: Evidence, readings: Readings, config: EstimateConfig
) -> tuple[list[Candidate], Objective]:
    """Search one frame: the best candidate of each start and the spares, the best first, and the objective used."""
    rng = np.random.default_rng(config.seed)
    instrument = renderer.body.instrument
    small = renderer.at(*image_size(evidence, config.search.width_px))
    objective = Objective(small, evidence, readings, config.weights, decay=config.decay_px, field=config.distance_field)
    poses, joints, unread = draw_seeds(evidence, instrument, readings, config, rng)
    terms = objective.terms(poses, joints)
    losses = terms.total(config.weights)
    seeds = [Candidate(poses[i], joints[i], float(losses[i])) for i in np.argsort(losses, kind="stable")[:200]]
    seen = np.where(unread, losses - config.weights.readings * terms.readings, np.inf)
    by_sight = [Candidate(poses[i], joints[i], float(seen[i])) for i in np.argsort(seen, kind="stable")[:60]]
    most = config.search.starts + config.search.spares
    apart = best_of_each(seeds, angle=np.deg2rad(20), joint=np.deg2rad(17), most=most)
    starts, spares = apart[: config.search.starts], apart[config.search.starts :]
    spares += best_of_each(by_sight, angle=np.deg2rad(20), joint=np.deg2rad(17), most=config.search.unread_spares)
    scale = scale_of_change(readings)

    def search(start: Candidate, seed: int) -> Candidate:
        def loss(change: Float64) -> Float64:
            step = change * scale
            return objective(moved(start.camera_from_root, step[:, :6]), start.joints + step[:, 6:])

        found = minimise(config.search.method, loss, len(scale), config.search.evaluations, seed)
        if found.loss >= start.score:
            return start
        best = found.best * scale
        return Candidate(moved(start.camera_from_root, best[:6]), start.joints + best[6:], found.loss)

    small.threads = 1  # from here on each start has a thread
    numbered = list(enumerate(starts, start=config.seed))
    found = each(lambda one: search(one[1], one[0]), numbered, config.threads)
    return sorted([*found, *spares], key=lambda c: c.score), objective
