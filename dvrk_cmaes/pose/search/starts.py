"""Random candidate poses of the global search, and the selection of modes, distinct local optima of the pose.

Candidates are on the axes given by the shaft's edges, and in the LookAt space.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import ArrayLike

from dvrk_cmaes.camera import Camera
from dvrk_cmaes.config import EstimateConfig, LookAtRange
from dvrk_cmaes.evidence.gather import Evidence
from dvrk_cmaes.evidence.jaw_tips import distal_direction
from dvrk_cmaes.evidence.shaft_edges import ShaftEdges, axis_tilt_error, shaft_axis
from dvrk_cmaes.geometry import (
    Bool,
    Float64,
    Posed,
    cross,
    exp_rotation,
    frame_along,
    rotation_about_z,
    rotation_angle,
    transform,
)
from dvrk_cmaes.instrument import Instrument
from dvrk_cmaes.joints.prior import Readings

_WIDEST = np.array([0.9, 2.2])
"""Half width of a mask at its widest place, as a multiple of that of the shaft at the root's distance.

In 200 made frames of all levels, 0.04 to 0.4 m away, it was 0.99 to 2.8, and 1.05 to 2.0 in 96 %.
"""
_LIKELY_SHARE = 0.75  # of the LookAt candidates whose distance follows from the mask's width
_TILT_RANGE = np.deg2rad([3.0, 25.0])  # of the standard deviation of the tilt of candidates on an axis


def lookat_pose(alpha: ArrayLike, beta: ArrayLike, gamma: ArrayLike, distance: ArrayLike) -> Float64:
    """Compute LookAt poses camera_from_root (..., 4, 4): R = R_y(gamma) R_x(alpha) R_z(beta), t = [0, 0, d]."""
    about_x, about_y = (np.multiply.outer(angle, axis) for angle, axis in ((alpha, [1.0, 0, 0]), (gamma, [0, 1.0, 0])))
    rotation = exp_rotation(about_y) @ exp_rotation(about_x) @ rotation_about_z(np.asarray(beta, dtype=np.float64))
    return transform(rotation, np.multiply.outer(distance, [0.0, 0.0, 1.0]))


def sample_joints(readings: Readings, uniform: Bool, rng: np.random.Generator) -> Float64:
    """Draw joint values (N, J), rad, of N candidates: normal about the readings, and clipped to the limits.

    They are uniform in the limits where there is no reading, and in candidates that are ``uniform`` (N,).
    """
    size = len(uniform), len(readings.values)
    near = np.clip(readings.values + readings.sigma * rng.standard_normal(size), readings.low, readings.high)
    free = rng.uniform(readings.low, readings.high, size)
    return np.asarray(np.where(np.isnan(readings.values) | uniform[:, None], free, near))


def likely_distances(evidence: Evidence, instrument: Instrument) -> Float64 | None:
    """Return between which distances (2,), m, the root lies, by the mask's width; None without a shaft to compare."""
    if instrument.shaft is None:
        return None
    focal = np.sqrt(evidence.camera.fx * evidence.camera.fy)
    return np.asarray(_WIDEST * focal * instrument.shaft.radius / evidence.half_width)


def sample_distances(count: int, limits: LookAtRange, likely: Float64 | None, rng: np.random.Generator) -> Float64:
    """Draw distances (count,), m, uniform in their logarithm, most of them in the ``likely`` part of the limits.

    A silhouette changes with the ratio of distances, so that the candidates for near and for far tools are as dense.
    """
    low, high = np.full(count, np.log(limits.near)), np.full(count, np.log(limits.far))
    if likely is not None and likely[0] < limits.far and likely[1] > limits.near:
        most = np.arange(count) < _LIKELY_SHARE * count
        low[most] = np.log(max(likely[0], limits.near))
        high[most] = np.log(min(likely[1], limits.far))
    return np.exp(rng.uniform(low, high))


def sample_lookat(
    distances: Float64, limits: LookAtRange, rng: np.random.Generator, *, camera: Camera, mask: Bool | None = None
) -> Float64:
    """Draw LookAt candidates (N, 4, 4) at some ``distances`` (N,), m, uniform in the three angles.

    As in the paper, the root lies on the optical axis. With a ``mask`` (H, W), each candidate is then rotated about the
    camera centre so that its root projects to one of the mask's pixels, drawn at random.
    """
    count = len(distances)
    pose = lookat_pose(
        rng.uniform(-limits.tilt, limits.tilt, count),
        rng.uniform(-np.pi, np.pi, count),
        rng.uniform(-limits.tilt, limits.tilt, count),
        distances,
    )
    if mask is None:
        return pose
    shown = np.flatnonzero(mask)
    v, u = np.divmod(shown[rng.integers(len(shown), size=count)], mask.shape[1])
    ray = np.c_[camera.normalise(np.stack([u, v], axis=1).astype(np.float64)), np.ones(count)]
    towards = ray / np.linalg.norm(ray, axis=1, keepdims=True)
    axis = np.cross([0.0, 0.0, 1.0], towards)
    sine = np.linalg.norm(axis, axis=1, keepdims=True)
    turn = axis / np.maximum(sine, 1e-12) * np.arctan2(sine, towards[:, 2:])
    return np.asarray(transform(exp_rotation(turn), np.zeros((count, 3))) @ pose)


def sample_on_axis(
    count: int,
    direction: Float64,
    point: Float64,
    along: tuple[float, float],
    tilt: float,
    rng: np.random.Generator,
    *,
    pivot: float,
) -> Float64:
    """Draw candidates (count, 4, 4) whose shaft lies on a given axis.

    The unit vector ``direction`` (3,) points distally; ``point`` (3,), m, lies on the axis. The position of the root on
    the axis is uniform between the coordinates ``along``, m, and its rotation about the axis uniform. The tilt of the
    axis towards the camera, which the two edges determine worst, is normal with standard deviation ``tilt``, rad, about
    the axis's point at coordinate ``pivot``, m.
    """
    slide = rng.uniform(*along, count)
    # Stratified sampling of the rotation about the axis: one value in each of ``count`` equal intervals.
    turn = (rng.permutation(count) + rng.uniform(size=count)) / count * 2 * np.pi
    centre = point + pivot * direction
    across = cross(centre, direction)
    across /= np.linalg.norm(across)
    tilted = exp_rotation(across * (tilt * rng.standard_normal(count))[:, None])
    axis = tilted @ direction
    origin = centre + (slide - pivot)[:, None] * axis
    return transform(frame_along(axis) @ rotation_about_z(turn), origin)


def _on_edges(
    edges: ShaftEdges, evidence: Evidence, instrument: Instrument, count: int, rng: np.random.Generator
) -> Float64:
    """Draw candidates (count, 4, 4) on the axis given by a pair of edges, with the wrist near the mask's distal end.

    Where it is not sure which end is the distal one, half of the candidates are at either end.
    """
    towards, sure = distal_direction(evidence.mask, edges, evidence.contour, evidence.camera)
    ends = [(towards, count)] if sure else [(towards, count - count // 2), (-towards, count // 2)]
    return np.concatenate([_towards(edges, each, evidence, instrument, number, rng) for each, number in ends])


def _towards(
    edges: ShaftEdges,
    towards: Float64,
    evidence: Evidence,
    instrument: Instrument,
    count: int,
    rng: np.random.Generator,
) -> Float64:
    """Draw candidates as `_on_edges`, with the jaws in the direction ``towards`` (2,) of the undistorted image."""
    assert instrument.shaft is not None
    camera = evidence.camera
    direction, point = shaft_axis(edges.planes, instrument.shaft.radius)
    focal, centre = np.array([camera.fx, camera.fy]), np.array([camera.cx, camera.cy])

    def coordinate(pixel: Float64) -> float:
        """Return the coordinate along the axis, m, of its point nearest to a pixel's ray."""
        ray = np.array([*((pixel - centre) / focal), 1.0])
        across = cross(direction, cross(ray, direction))
        # The foot, on the axis, of the common perpendicular of axis and ray.
        away = cross(ray, cross(direction, ray))
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
    # The root link's origin lies between the shaft's end and the tips for all wrist angles.
    nearest = min(foot, end - 0.6 * instrument.reach) - 0.005
    farthest = max(end + 0.003, nearest + 0.01)
    nearest = max(nearest, farthest - 3 * instrument.reach)
    tilt = float(np.clip(axis_tilt_error(edges, camera, instrument.shaft.radius), *_TILT_RANGE))
    return sample_on_axis(count, direction, point, (nearest, farthest), tilt, rng, pivot=middle)


def draw_starts(
    evidence: Evidence, instrument: Instrument, readings: Readings, config: EstimateConfig, rng: np.random.Generator
) -> tuple[Posed, Bool]:
    """Draw the N candidates of the search, and whether their joints ignore the readings, (N,).

    A fraction ``free_share`` is drawn in the LookAt space. Of the others, 3/5 lie on the best supported pair of edges
    and the rest on the other pairs, in equal numbers; all lie on the only pair if there is one, and all in the LookAt
    space if there is none.
    """
    count = config.search.samples
    pairs = evidence.shaft_edges if config.search.use_edges else ()
    free = count if not pairs else round(config.search.free_share * count)
    others = (count - free) * 2 // 5 // max(len(pairs) - 1, 1)
    shares = [count - free - others * (len(pairs) - 1), *[others] * (len(pairs) - 1)][: len(pairs)]
    poses = [_on_edges(pair, evidence, instrument, n, rng) for pair, n in zip(pairs, shares, strict=True)]
    distances = sample_distances(free, config.lookat, likely_distances(evidence, instrument), rng)
    poses.append(sample_lookat(distances, config.lookat, rng, camera=evidence.camera, mask=evidence.mask))
    uniform = rng.uniform(size=count) < config.search.uniform_joints_share
    return Posed(np.concatenate(poses), sample_joints(readings, uniform, rng)), uniform


@dataclass(frozen=True, eq=False)
class PoseCandidate:
    """One pose with its joints, and its ``score``: a loss or negative log-likelihood, the lower the better."""

    at: Posed
    score: float


C = TypeVar("C", bound=PoseCandidate)


_ANGLE, _JOINT = float(np.deg2rad(15)), float(np.deg2rad(25))  # between poses of the same mode, at most


_TWIN_ANGLE = np.deg2rad(40)  # between a mode and the mirror twin of another that count as the same


def are_distinct(a: Posed, b: Posed) -> Bool:
    """Return whether poses differ by more than 15 degrees in rotation or more than 25 degrees in any joint, (...).

    ``a`` is one pose, ``b`` may be several.
    """
    turned = rotation_angle(a.pose, b.pose) > _ANGLE
    return np.asarray(turned | (np.abs(b.joints - a.joints).max(axis=-1, initial=0.0) > _JOINT))


def twin_of(instrument: Instrument, at: Posed) -> Posed:
    """Return the mirror twin of a pose."""
    return Posed(*instrument.twin(at.pose, at.joints))


def is_twin(instrument: Instrument, a: Posed, b: Posed) -> bool:
    """Return whether two poses are in modes that are mirror twins of each other."""
    return bool(rotation_angle(twin_of(instrument, a).pose, b.pose) < _TWIN_ANGLE)


def best_per_mode(candidates: Sequence[C], *, most: int | None = None, mirrored: Instrument | None = None) -> list[C]:
    """Select the best candidate of each mode, sorted by score, at most ``most``; modes are as in `first_of_modes`."""
    ordered = sorted(candidates, key=lambda candidate: candidate.score)
    at = Posed.stacked([candidate.at for candidate in ordered])
    return [ordered[k] for k in first_of_modes(at, most=most, mirrored=mirrored)]


def first_of_modes(
    at: Posed,
    *,
    angle: float = _ANGLE,
    joint: float = _JOINT,
    most: int | None = None,
    mirrored: Instrument | None = None,
) -> list[int]:
    """Return which of C poses are of none of the modes before them, at most ``most``.

    Poses are of the same mode if they are not distinct by the thresholds ``angle`` and ``joint``, rad. If the
    instrument is given as ``mirrored`` and has a mirror twin, poses and their twins are of the same mode.
    """
    kept, left = list[int](), np.arange(len(at))
    each = [at] if mirrored is None or not mirrored.has_twin else [at, twin_of(mirrored, at)]
    rotations = [one.pose[:, :3, :3].reshape(-1, 9) for one in each]
    while len(left) and len(kept) != most:
        kept.append(int(left[0]))
        for one, turned in zip(each, rotations, strict=True):
            traces = (rotations[0] @ turned[kept[-1]])[left]  # of the rotations between both
            close = np.flatnonzero(~(traces < 1 + 2 * np.cos(angle)))  # few
            off = np.abs(at.joints[left[close]] - one.joints[kept[-1]])
            left = np.delete(left, close[(off <= joint).all(axis=1)])
    return kept
