"""Instruments before a camera: what rays (Embree) meet of them, and the share of each pixel that each covers.

Rays go through the middles of the pixels, of large images of every second one. Pixels near which what they meet differs
are divided into ``SAMPLES`` x ``SAMPLES`` rays. Only the lens is the camera's; the silhouettes by which poses are found
draw nothing here.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Final, Protocol

import cv2
import numpy as np
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene
from numpy.typing import NDArray

from dvrk_cmaes.camera import Camera
from dvrk_cmaes.geometry import Float32, Float64, apply
from dvrk_cmaes.instrument import Instrument

Faces = NDArray[np.int64]

NEAREST: Final = 1e-3  # m, along the optical axis
NOTHING: Final = -1
"""Index of the triangle or link that a ray meets which meets none."""
SAMPLES: Final = 5
_LARGE: Final = 1500  # px, width from which on every second pixel is looked at first
_MOST_RAYS: Final = 2_000_000  # at a time
_MANY_RAYS: Final = 50_000  # from which on those that meet nothing are sorted out first
_CELLS: Final = 512  # of the plane z = 1, along each side of what the rays cover
_FAR: Final = 1e37  # m, where a ray meets nothing


class Placed(Protocol):
    """An instrument in a frame: ``camera_from_root`` (4, 4), m, and joint values (J,)."""

    @property
    def instrument(self) -> Instrument:
        """The instrument."""

    @property
    def camera_from_root(self) -> Float64:
        """Pose (4, 4) of the root in the camera's frame."""

    @property
    def values(self) -> Float64:
        """Joint values (J,)."""


class Scene:
    """The triangles of some instruments: ``tool`` and ``link`` (F,) are the places of those that they belong to."""

    def __init__(self, tools: Sequence[Placed]) -> None:
        self.tools = tools
        points, faces, owner, before = [], [], [], 0
        for number, own in enumerate(tools):
            poses = own.camera_from_root @ own.instrument.forward(own.values)
            for index, (link, camera_from_link) in enumerate(zip(own.instrument.links, poses, strict=True)):
                points.append(apply(camera_from_link, link.vertices))
                faces.append(link.faces + before)
                owner.append(np.tile([[number], [index]], len(link.faces)))
                before += len(link.vertices)
        self.tool, self.link = np.concatenate(owner, axis=1)
        self.points, self.faces = np.concatenate(points), np.concatenate(faces)
        of_link = self.tool * (1 + self.link.max()) + self.link
        self._outlines = [_seen_in_plane(self.points, self.faces[of_link == each]) for each in np.unique(of_link)]
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


def _seen_in_plane(points: Float64, faces: Faces) -> Float64:
    """Return points (N, 2) of the plane z = 1 whose convex hull holds all of some triangles that is beyond NEAREST."""
    before = points[:, 2] > NEAREST
    edges = faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    a, b = np.swapaxes(points[edges[before[edges[:, 0]] != before[edges[:, 1]]]], 0, 1)
    cut = a + ((NEAREST - a[:, 2]) / (b[:, 2] - a[:, 2]))[:, None] * (b - a)
    corners = np.unique(faces)
    seen = np.concatenate([points[corners[before[corners]]], cut])
    return np.asarray(seen[:, :2] / seen[:, 2:])


@dataclass(frozen=True, eq=False)
class Seen:
    """What a camera sees of T tools.

    coverage : (T, H, W), share of each pixel that each covers. rays : (H', W', 3), through the middles of every
    ``step``-th pixel. face, depth : (H', W'), triangle of ``scene`` that each meets, or ``NOTHING``, and its depth, m.
    """

    scene: Scene
    coverage: Float32
    rays: Float32
    step: int
    face: Faces
    depth: Float32

    def whole(self, values: NDArray[Any]) -> NDArray[Any]:
        """Return values (H', W') of the rays at the size of the image, (H, W)."""
        height, width = self.coverage.shape[1:]
        return values if self.step == 1 else values.repeat(self.step, 0).repeat(self.step, 1)[:height, :width]


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


def links_seen(camera: Camera, tool: Placed) -> NDArray[np.int64]:
    """Return the link (H, W) that is seen in the middle of each pixel, or ``NOTHING``."""
    scene, rays = Scene([tool]), pixel_rays(camera)
    face, _ = scene.hits(rays.reshape(-1, 3))
    return np.where(face < 0, NOTHING, scene.link[face]).reshape(rays.shape[:2])


def see(camera: Camera, tools: Sequence[Placed]) -> Seen:
    """Look at instruments, of which the nearer hides the farther."""
    scene, step = Scene(tools), 2 if camera.width > _LARGE else 1
    rays = pixel_rays(camera, step)
    hit, far = scene.hits(rays.reshape(-1, 3))
    face, depth = hit.reshape(rays.shape[:2]), far.reshape(rays.shape[:2])
    seen = Seen(scene, np.empty((len(tools), camera.height, camera.width), np.float32), rays, step, face, depth)
    tool = seen.whole(np.where(face < 0, NOTHING, scene.tool[face]))
    for number, coverage in enumerate(seen.coverage):
        coverage[:] = tool == number
    around, codes = np.ones((4 * step - 1, 4 * step - 1), np.uint8), (tool + 1).astype(np.uint8)
    rows, columns = np.nonzero(cv2.dilate(codes, around) != cv2.erode(codes, around))
    if len(rows):
        inner = (np.arange(SAMPLES) + 0.5) / SAMPLES - 0.5
        within = np.stack(np.meshgrid(inner, inner), axis=-1).reshape(-1, 2)
        pixels = np.stack([columns, rows], axis=1)[:, None] + within
        finer, _ = scene.hits(rays_of(camera, pixels.reshape(-1, 2)))
        of_tool = np.where(finer < 0, NOTHING, scene.tool[finer]).reshape(len(rows), -1)
        for number, coverage in enumerate(seen.coverage):
            coverage[rows, columns] = (of_tool == number).mean(axis=1)
    return seen
