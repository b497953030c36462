"""Derivatives of the positions of outline points, which are fixed on the instrument, by small changes of the pose."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.camera import Camera
from dvrk_cmaes.instrument import Instrument
from dvrk_cmaes.silhouette import OutlinePoints

Float64 = NDArray[np.float64]

_STEP = 1e-5  # rad, of central differences of the joints
_LENS_STEP = 1e-4  # of central differences of the distortion, in normalised coordinates
_NEAREST = 1e-3  # m, least depth of a point


def outline_jacobians(
    instrument: Instrument, camera: Camera, outlines: Sequence[OutlinePoints], poses: Float64, joints: Float64
) -> list[Float64]:
    """Compute the Jacobian (N, 6 + J) of the outline points of each of C poses (C, 4, 4) with joints (C, J).

    It is the derivative, by each small change [t, r, joints], of the points' displacements along their normals, times
    the length of outline that each represents.
    """
    in_root, by_joints = _in_root(instrument, outlines, joints)
    ends = np.cumsum([0, *(len(outline.points) for outline in outlines)])
    parts = [slice(begin, end) for begin, end in pairwise(ends)]
    seen = np.empty_like(in_root)
    for pose, part in zip(poses, parts, strict=True):
        np.matmul(in_root[part], pose[:3, :3].T, out=seen[part])
        seen[part] += pose[:3, 3]
    normals = np.concatenate([outline.normals for outline in outlines])
    slope = _along_normals(camera, seen, normals)
    in_axes = np.empty_like(slope)
    for pose, part in zip(poses, parts, strict=True):
        np.matmul(slope[part], pose[:3, :3], out=in_axes[part])
    jacobian = np.empty((len(in_root), 6 + joints.shape[1]))
    jacobian[:, :3] = in_axes
    (x, y, z), (a, b, c) = in_root.T, in_axes.T
    jacobian[:, 3], jacobian[:, 4], jacobian[:, 5] = y * c - z * b, z * a - x * c, x * b - y * a
    np.einsum("njk,nk->nj", by_joints, in_axes, out=jacobian[:, 6:])
    return np.split(jacobian, ends[1:-1])


def _in_root(instrument: Instrument, outlines: Sequence[OutlinePoints], joints: Float64) -> tuple[Float64, Float64]:
    """Return the N points of all outlines in the root's frame, (N, 3), and their derivatives by the joints, (N, J, 3).

    The points of an outline are sorted by link.
    """
    count = joints.shape[1]
    change = _STEP * np.concatenate([np.zeros((1, count)), np.eye(count), -np.eye(count)])
    root_from_link = instrument.forward(joints[:, None] + change)[..., :3, :]
    by_joint = (root_from_link[:, 1 : 1 + count] - root_from_link[:, 1 + count :]) / (2 * _STEP)
    both = np.concatenate([root_from_link[:, :1], by_joint], axis=1)  # (C, 1 + J, L, 3, 4)
    columns = np.ascontiguousarray(both.transpose(0, 2, 4, 1, 3)).reshape(len(joints), both.shape[2], 4, -1)
    found = np.empty((sum(len(outline.points) for outline in outlines), columns.shape[-1]))
    begin = 0
    for outline, of_links in zip(outlines, columns, strict=True):
        edges = np.searchsorted(outline.link, np.arange(len(of_links) + 1))
        for link, matrix in enumerate(of_links):
            part = slice(begin + edges[link], begin + edges[link + 1])
            np.matmul(outline.points[edges[link] : edges[link + 1]], matrix[:3], out=found[part])
            found[part] += matrix[3]
        begin += len(outline.points)
    return found[:, :3], found[:, 3:].reshape(-1, count, 3)


def _along_normals(camera: Camera, points: Float64, normals: Float64) -> Float64:
    """Return the gradients (N, 3), px/m, of the displacements along (N, 2) normals of the images of N points.

    The displacements are functions of the positions of the ``points`` (N, 3) in the camera's frame, m.
    """
    depth = np.maximum(points[:, 2:], _NEAREST)
    xy = points[:, :2] / depth
    along = normals * [camera.fx, camera.fy]
    if not camera.is_pinhole:
        step = _LENS_STEP * np.eye(2)[:, None]
        bending = (camera.distort(xy + step) - camera.distort(xy - step)) / (2 * _LENS_STEP)
        along = np.einsum("anu,nu->na", bending, along)
    return np.asarray(np.column_stack([along, -(along * xy).sum(axis=1)]) / depth)
