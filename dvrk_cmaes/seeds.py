"""Candidates to start from in one frame: on the axes that the shaft's edges suggest, and some without them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.config import EstimateConfig
from dvrk_cmaes.evidence import Evidence
from dvrk_cmaes.hypotheses import sample_joints, sample_lookat, sample_on_axis
from dvrk_cmaes.instrument import Instrument
from dvrk_cmaes.objective import Readings
from dvrk_cmaes.shaft_edges import ShaftEdges, axis_tilt_error, shaft_axis
from dvrk_cmaes.tips import distal_direction

Float64 = NDArray[np.float64]

_TILT_RANGE = np.deg2rad([3.0, 25.0])


def _on_edges(
    edges: ShaftEdges, evidence: Evidence, instrument: Instrument, count: int, rng: np.random.Generator
) -> Float64:
    """Candidates (count, 4, 4) on the axis of a pair of edges, the wrist near where the mask ends."""
    assert instrument.shaft is not None
    camera = evidence.camera
    direction, point = shaft_axis(edges.planes, instrument.shaft.radius)
    towards = distal_direction(evidence.mask, edges)
    focal, centre = np.array([camera.fx, camera.fy]), np.array([camera.cx, camera.cy])

    def coordinate(pixel: Float64) -> float:
        """Where along the axis its point nearest to a pixel's ray lies, m."""
        ray = np.array([*((pixel - centre) / focal), 1.0])
        across = np.cross(direction, np.cross(ray, direction))
        # The foot on the axis of the line of shortest distance between axis and ray.
        away = np.cross(ray, np.cross(direction, ray))
        return float(-(away @ point) / (away @ direction)) if abs(across @ across) > 1e-12 else 0.0

    middle = coordinate(edges.ends.mean(axis=(0, 1)))
    before, after = (point + (middle + step) * direction for step in (-1e-3, 1e-3))
    shift = (after[:2] / after[2] - before[:2] / before[2]) * focal
    if shift @ towards < 0:
        direction, middle = -direction, -middle
    contour = evidence.contour.ideal
    end = coordinate(contour[np.argsort(contour @ towards)[-5:]].mean(axis=0))
    corners = edges.ends.reshape(-1, 2)
    foot = coordinate(corners[np.argsort(corners @ towards)[-2:]].mean(axis=0))
    # The root link's origin lies between the shaft's end and the tips, in whatever way the wrist is bent.
    nearest = min(foot, end - 0.6 * instrument.reach) - 0.005
    farthest = max(end + 0.003, nearest + 0.01)
    nearest = max(nearest, farthest - 3 * instrument.reach)
    tilt = float(np.clip(axis_tilt_error(edges, camera, instrument.shaft.radius), *_TILT_RANGE))
    return sample_on_axis(count, direction, point, (nearest, farthest), tilt, rng, pivot=middle)


def draw_seeds(
    evidence: Evidence,
    instrument: Instrument,
    readings: Readings,
    config: EstimateConfig,
    rng: np.random.Generator,
) -> tuple[Float64, Float64, NDArray[np.bool_]]:
    """Draw the search's first candidates: poses (N, 4, 4), joints (N, J), and whether these ignore the readings (N,).

    Half of them lie on the likeliest pair of edges, the rest on the other pairs and anywhere in the LookAt space.
    """
    count = config.search.samples
    pairs = evidence.shaft_edges if config.search.use_edges else ()
    free = count if not pairs else round(config.search.free_share * count)
    shares = [count - free] if len(pairs) == 1 else []
    if len(pairs) > 1:
        first = (count - free) * 3 // 5
        others = (count - free - first) // (len(pairs) - 1)
        shares = [count - free - others * (len(pairs) - 1)] + [others] * (len(pairs) - 1)
    poses = [_on_edges(pair, evidence, instrument, n, rng) for pair, n in zip(pairs, shares, strict=True)]
    v, u = np.nonzero(evidence.mask)
    pixels = np.stack([u, v], axis=1).astype(np.float64)
    poses.append(sample_lookat(free, config.lookat, rng, camera=evidence.camera, pixels=pixels))
    joints = sample_joints(readings.values, readings.spread, readings.low, readings.high, count, rng)
    nothing = np.full(len(readings.values), np.nan)
    anything = sample_joints(nothing, readings.spread, readings.low, readings.high, count, rng)
    unread = rng.uniform(size=count) < config.search.unread_share
    joints[unread] = anything[unread]
    return np.concatenate(poses), joints, unread
