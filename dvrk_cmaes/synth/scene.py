"""An instrument before a camera: what rays (Embree) meet of it, and the share of each pixel that it covers.

Rays go through the middles of the pixels, of large images of every second one. Pixels near which what they meet differs
are divided into ``SAMPLES`` x ``SAMPLES`` rays. Only the lens is the camera's; the silhouettes by which poses are found
draw nothing here.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Final

import cv2
import numpy as np
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene
from numpy.typing import NDArray

from dvrk_cmaes.camera import Camera
from dvrk_cmaes.geometry import Bool, Float32, Float64, apply
from dvrk_cmaes.synth.truth import Truth

Faces = NDArray[np.int64]

NEAREST: Final = 1e-3  # m, along the optical axis
NOTHING: Final = -1
"""Index of the triangle or link that a ray meets which meets none."""
SAMPLES: Final = 5
_LARGE: Final = 1500  # px, width from which on every second pixel is looked at first
_MOST_RAYS: Final = 2_000_000  # at a time
_MANY_RAYS: Final = 5_000  # from which on those that meet nothing are sorted out first
_CELLS: Final = 512  # of the plane z = 1, along each side of what the rays cover
_FAR: Final = 1e37  # m, where a ray meets nothing


class Scene:
    """The triangles of an instrument: ``link`` (F,) are the places of the links that they belong to."""

    def __init__(self, truth: Truth) -> None:
        links = truth.instrument.links
        poses = truth.camera_from_root @ truth.instrument.forward(truth.values)
        points = [apply(pose, link.vertices) for pose, link in zip(poses, links, strict=True)]
        before = np.cumsum([0, *map(len, points)])
        self.link = np.repeat(np.arange(len(links)), [len(link.faces) for link in links])
        self.points = np.concatenate(points)
        self.faces = np.concatenate([link.faces + first for link, first in zip(links, before, strict=False)])
        self._outlines = [_seen_in_plane(own, link.faces) for own, link in zip(points, links, strict=True)]
        self._scene = EmbreeScene()
        TriangleMesh(self._scene, self.points.astype(np.float32), self.faces.astype(np.int32))

    def normals(self, face: Faces) -> Float64:
        """Return the outward unit normals (N, 3) of triangles (N,), in the camera's frame."""
        some, place = np.unique(face, return_inverse=True)
        a, b, c = np.swapaxes(self.points[self.faces[some]], 0, 1)
        normals = np.cross(b - a, c - a)
        return np.asarray((normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30))[place])

    def hits(self, rays: Float32) -> tuple[Faces, Float32]:
        """Return for rays (N, 3) with z = 1 the triangle that each meets first, or ``NOTHING``, and its depth, m."""
        face, depth = np.full(len(rays), NOTHING, np.int64), np.full(len(rays), _FAR, np.float32)
        chosen = self._near(rays)
        for part in np.array_split(chosen, max(1, -(-len(chosen) // _MOST_RAYS))):
            found = self._scene.run(np.ascontiguousarray(NEAREST * rays[part]), rays[part], output=True)
            face[part], depth[part] = found["primID"], found["tfar"] + NEAREST
        return face, depth

    def covers(self, rays: Float32) -> Bool:
        """Return for rays (N, 3) with z = 1 whether each meets a triangle, (N,)."""
        found = np.zeros(len(rays), np.bool_)
        chosen = self._near(rays)
        for part in np.array_split(chosen, max(1, -(-len(chosen) // _MOST_RAYS))):
            found[part] = self._scene.run(np.ascontiguousarray(NEAREST * rays[part]), rays[part], query="OCCLUDED") == 0
        return found

    def _near(self, rays: Float32) -> Faces:
        """Return the numbers of the rays in or near a link's convex hull, in the plane z = 1; others meet nothing."""
        if len(rays) < _MANY_RAYS:
            return np.arange(len(rays))
        low, high = ([least(rays[:, k]) for k in range(2)] for least in (np.min, np.max))
        scale = np.float32(_CELLS / np.subtract(high, low).max())
        cells = np.zeros((_CELLS + 1, _CELLS + 1), np.uint8)
        for plane in self._outlines:
            if len(plane):
                cv2.fillConvexPoly(cells, cv2.convexHull(np.rint((plane - low) * scale).astype(np.int32)), 1)
        near = cv2.dilate(cells, np.ones((5, 5), np.uint8))
        columns, rows = ((rays[:, k] - low[k]) * scale for k in range(2))
        return np.flatnonzero(near[rows.astype(np.int32), columns.astype(np.int32)])


def _seen_in_plane(points: Float64, faces: NDArray[np.int32]) -> Float64:
    """Return points (N, 2) of the plane z = 1 whose convex hull holds all of some triangles that is beyond NEAREST."""
    before = points[:, 2] > NEAREST
    edges = faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    a, b = np.swapaxes(points[edges[before[edges[:, 0]] != before[edges[:, 1]]]], 0, 1)
    cut = a + ((NEAREST - a[:, 2]) / (b[:, 2] - a[:, 2]))[:, None] * (b - a)
    corners = np.unique(faces)
    seen = np.concatenate([points[corners[before[corners]]], cut])
    return np.asarray(seen[:, :2] / seen[:, 2:])


def rays_of(camera: Camera, pixels: Float64) -> Float32:
    """Return the rays (N, 3) of pixels (N, 2), points of the camera's frame at z = 1."""
    return np.asarray(np.c_[camera.normalise(pixels), np.ones(len(pixels))], np.float32)


@lru_cache(maxsize=4)
def pixel_rays(camera: Camera, step: int = 1) -> Float32:
    """Return the rays through the middles of every ``step``-th pixel, (H, W, 3); they are not to be changed."""
    v, u = np.mgrid[: camera.height : step, : camera.width : step].astype(np.float64)
    rays = rays_of(camera, np.stack([u.ravel(), v.ravel()], axis=1)).reshape(*u.shape, 3)
    rays.setflags(write=False)
    return rays


@lru_cache(maxsize=4)
def scene_of(truth: Truth) -> Scene:
    """Return the triangles of an instrument; those of the last ones are kept."""
    return Scene(truth)


@lru_cache(maxsize=4)
def _looked(camera: Camera, truth: Truth, step: int = 1) -> tuple[Faces, Float32]:
    """Return the triangle, or ``NOTHING``, and the depth, m, that the middle of every ``step``-th pixel shows."""
    rays = pixel_rays(camera, step)
    face, depth = scene_of(truth).hits(rays.reshape(-1, 3))
    return face.reshape(rays.shape[:2]), depth.reshape(rays.shape[:2])


def links_seen(camera: Camera, truth: Truth) -> NDArray[np.int64]:
    """Return the link (H, W) that is seen in the middle of each pixel, or ``NOTHING``."""
    face, _ = _looked(camera, truth)
    return np.where(face < 0, NOTHING, scene_of(truth).link[face])


def tool_depth(camera: Camera, truth: Truth) -> Float32:
    """Return the depth (H, W) of an instrument in the middle of each pixel, m; infinite where it is not seen."""
    face, depth = _looked(camera, truth)
    return np.where(face == NOTHING, np.float32(np.inf), depth)


def exact_coverage(camera: Camera, truth: Truth) -> Float32:
    """Return the share (H, W) of each pixel that an instrument covers, 0 to 1."""
    step = 2 if camera.width > _LARGE else 1
    there = (_looked(camera, truth, step)[0] >= 0).astype(np.uint8)
    there = there.repeat(step, 0).repeat(step, 1)[: camera.height, : camera.width]
    coverage, around = there.astype(np.float32), np.ones((4 * step - 1, 4 * step - 1), np.uint8)
    rows, columns = np.nonzero(cv2.dilate(there, around) != cv2.erode(there, around))
    if len(rows):
        inner = (np.arange(SAMPLES) + 0.5) / SAMPLES - 0.5
        within = np.stack(np.meshgrid(inner, inner), axis=-1).reshape(-1, 2)
        pixels = np.stack([columns, rows], axis=1)[:, None] + within
        finer = scene_of(truth).covers(rays_of(camera, pixels.reshape(-1, 2)))
        coverage[rows, columns] = finer.reshape(len(rows), -1).mean(axis=1)
    return coverage


def exact_mask(camera: Camera, truth: Truth) -> Bool:
    """Return the mask (H, W) of the pixels that an instrument covers by more than half."""
    return np.asarray(exact_coverage(camera, truth) > 0.5)
