"""Derivatives of the positions of outline points, which are fixed on the instrument, by small changes of the pose."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.camera import Camera
from dvrk_cmaes.instrument import Instrument
from dvrk_cmaes.silhouette import OutlinePoints

Float64 = NDArray[np.float64]

_STEP = 1e-5  # m and rad, of central differences
_NEAREST = 1e-3  # m, least depth of a point


def outline_jacobians(
    instrument: Instrument, camera: Camera, outlines: Sequence[OutlinePoints], poses: Float64, joints: Float64
) -> list[Float64]:
    """Compute the Jacobian (N, 6 + J) of the outline points of each of C poses (C, 4, 4) with joints (C, J).

    It is the derivative, by each small change [t, r, joints], of the points' displacements along their normals, times
    the length of outline that each represents.
    """
    count = joints.shape[1]
    owner = np.repeat(np.arange(len(poses)), [len(outline.points) for outline in outlines])
    link, points, normals = (
        np.concatenate([getattr(outline, name) for outline in outlines]) for name in ("link", "points", "normals")
    )
    points = np.column_stack([points, np.ones(len(points))])
    change = _STEP * np.concatenate([np.zeros((1, count)), np.eye(count), -np.eye(count)])
    root_from_link = instrument.forward(joints[:, None] + change)[..., :3, :]
    bending = (root_from_link[:, 1 : 1 + count] - root_from_link[:, 1 + count :]) / (2 * _STEP)
    in_root = np.einsum("nij,nj->ni", root_from_link[owner, 0, link], points)
    rotation = poses[owner, :3, :3]
    seen = np.einsum("nij,nj->ni", rotation, in_root) + poses[owner, :3, 3]
    seen[:, 2] = np.maximum(seen[:, 2], _NEAREST)
    step = _STEP * np.eye(3)[:, None]
    pixels = camera.project(np.concatenate([seen + step, seen - step]))
    # how far a point moves along its normal when it moves in the camera, (3, N), then along the root's axes, (N, 3)
    slope = np.einsum("anu,nu->an", (pixels[:3] - pixels[3:]) / (2 * _STEP), normals)
    in_axes = np.einsum("nij,in->nj", rotation, slope)
    of_links = (in_axes[:, :, None] * points[:, None]).reshape(-1, 12, 1)
    of_joints = bending[owner, :, link].reshape(-1, count, 12) @ of_links
    jacobian = np.concatenate([in_axes, np.cross(in_root, in_axes), of_joints[..., 0]], axis=1)
    ends = np.cumsum([len(outline.points) for outline in outlines])
    return np.split(jacobian, ends[:-1])
