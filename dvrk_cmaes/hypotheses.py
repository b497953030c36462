"""Where the search starts: poses of the LookAt space, freely drawn or drawn where two shaft edges put the axis."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dvrk_cmaes.camera import Camera
from dvrk_cmaes.geometry import exp_rotation, frame_along, rotation_about_z, transform

Float64 = NDArray[np.float64]


@dataclass(frozen=True)
class LookAtRange:
    """Limits of LookAt samples: angles in rad, distance in m.

    The shaft points away from the camera plane, so alpha and gamma stay below 90 degrees; the turn about the shaft,
    beta, is free.
    """

    tilt: float = float(np.deg2rad(80))
    near: float = 0.05
    far: float = 0.22


def lookat_pose(alpha: ArrayLike, beta: ArrayLike, gamma: ArrayLike, distance: ArrayLike) -> Float64:
    """LookAt candidates as camera_from_root (..., 4, 4): R = R_y(gamma) R_x(alpha) R_z(beta), t = [0, 0, d]."""
    a, b, g, d = np.broadcast_arrays(*(np.asarray(v, dtype=np.float64) for v in (alpha, beta, gamma, distance)))
    zero = np.zeros_like(a)
    rotation = (
        exp_rotation(np.stack([zero, g, zero], axis=-1))
        @ exp_rotation(np.stack([a, zero, zero], axis=-1))
        @ exp_rotation(np.stack([zero, zero, b], axis=-1))
    )
    return transform(rotation, np.stack([zero, zero, d], axis=-1))


def sample_joints(
    readings: Float64, spread: Float64, low: Float64, high: Float64, count: int, rng: np.random.Generator
) -> Float64:
    """Joint values (count, J): around the readings with their spread, uniform within the limits where unknown (NaN)."""
    near = readings + spread * rng.standard_normal((count, len(readings)))
    free = rng.uniform(low, high, (count, len(readings)))
    return np.asarray(np.where(np.isnan(readings), free, np.clip(near, low, high)))


def sample_lookat(
    count: int, limits: LookAtRange, rng: np.random.Generator, *, camera: Camera, pixels: Float64 | None = None
) -> Float64:
    """LookAt candidates (count, 4, 4) drawn uniformly in the four numbers.

    The paper puts the root on the optical axis. With ``pixels`` (N, 2), the optical axis is first turned to one of
    them, drawn at random: the camera looks at the instrument wherever it is in the image.
    """
    pose = lookat_pose(
        rng.uniform(-limits.tilt, limits.tilt, count),
        rng.uniform(-np.pi, np.pi, count),
        rng.uniform(-limits.tilt, limits.tilt, count),
        rng.uniform(limits.near, limits.far, count),
    )
    if pixels is None:
        return pose
    ray = np.c_[camera.normalise(pixels[rng.integers(len(pixels), size=count)]), np.ones(count)]
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
    """LookAt candidates (count, 4, 4) whose shaft lies on a given axis.

    ``direction`` (3,) is distal, ``point`` (3,) on the axis, m; the root slides between the coordinates ``along``, m,
    and turns freely about the axis. Two edges tell the axis's tilt towards the eye least well: it varies by ``tilt``
    rad (one standard deviation) about the axis's point at coordinate ``pivot``, m.
    """
    slide = rng.uniform(*along, count)
    # Even turns, each in its own slot: no turn is left out by chance.
    turn = (rng.permutation(count) + rng.uniform(size=count)) / count * 2 * np.pi
    centre = point + pivot * direction
    across = np.cross(centre, direction)
    across /= np.linalg.norm(across)
    tilted = exp_rotation(across * (tilt * rng.standard_normal(count))[:, None])
    axis = tilted @ direction
    origin = centre + (slide - pivot)[:, None] * axis
    return transform(frame_along(axis) @ rotation_about_z(turn), origin)


def sample_uniform(count: int, limits: LookAtRange, rng: np.random.Generator, *, camera: Camera) -> Float64:
    """Poses (count, 4, 4) uniform in rotation and in the view, between the limits' distances: the naive alternative."""
    quaternion = rng.standard_normal((count, 4))
    w, x, y, z = (quaternion / np.linalg.norm(quaternion, axis=1, keepdims=True)).T
    sine = np.sqrt(np.maximum(1 - w * w, 1e-16))
    rotation = exp_rotation((2 * np.arctan2(sine, w) / sine)[:, None] * np.stack([x, y, z], axis=1))
    pixels = rng.uniform([0, 0], [camera.width, camera.height], (count, 2))
    depth = rng.uniform(limits.near, limits.far, (count, 1))
    return transform(rotation, np.c_[camera.normalise(pixels), np.ones(count)] * depth)
