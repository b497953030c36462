"""Ray tracing of an instrument's links: link index, depth and surface normal at each pixel.

One ray a pixel is traced against the full meshes; it is slower than the silhouette renderer of
`dvrk_cmaes.silhouette` and used for synthetic images only.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene
from numpy.typing import NDArray

from dvrk_cmaes.camera import Camera
from dvrk_cmaes.geometry import Bool, Float32, Float64, apply
from dvrk_cmaes.instrument import Instrument
from dvrk_cmaes.silhouette import NEAR, Body, Renderer
from dvrk_cmaes.silhouette.prepare import prepare

NOTHING = -1
"""Link index of a pixel that sees no link."""
_SCENES = 4
"""Scenes that are kept, which take 10 ms to build: a frame's mask and its image show the same, for each eye and arm."""


@dataclass(frozen=True, eq=False)
class LinkView:
    """Links seen along rays (...), such as those of an image's pixels (H, W).

    Depth, normal and direction are zero where no link is seen.
    """

    link: NDArray[np.int32]
    """Index of the link, or ``NOTHING``."""
    depth: Float32
    """z in the camera's frame, m."""
    normal: Float32
    """Outward unit normal in the camera's frame, (..., 3)."""
    direction: Float32
    """Unit vector of the ray in the camera's frame, (..., 3)."""


@lru_cache(maxsize=4)
def pixel_rays(camera: Camera) -> Float32:
    """Return the rays through the pixels' centres, (H, W, 3): points of the camera's frame at z = 1; not to be changed.

    Those of the last few cameras are kept, because the frames of a session share theirs.
    """
    v, u = np.mgrid[: camera.height, : camera.width]
    pixels = np.stack([u.ravel(), v.ravel()], axis=1).astype(np.float64)
    rays = np.c_[camera.normalise(pixels), np.ones(len(pixels))].astype(np.float32)
    rays = rays.reshape(camera.height, camera.width, 3)
    rays.setflags(write=False)
    return np.asarray(rays, np.float32)


def trace_links(instrument: Instrument, camera: Camera, camera_from_root: Float64, joints: Float64) -> LinkView:
    """Trace a ray through the centre of every pixel in and beside the silhouette at a pose (4, 4) and joints (J,)."""
    (mask,) = Renderer(prepare(instrument), camera, threads=1).masks(camera_from_root[None], joints[None])
    beside = cv2.dilate(mask.view(np.uint8), np.ones((5, 5), np.uint8)) > 0
    return _traced(_Surface.of(instrument, camera_from_root, joints), pixel_rays(camera), beside)


def links_at(body: Body, camera: Camera, camera_from_root: Float64, joints: Float64, where: Bool) -> NDArray[np.int32]:
    """Return the index (H, W) of the link that is seen at the pixels ``where`` (H, W); ``NOTHING`` at the others."""
    links = np.full(where.shape, NOTHING, dtype=np.int32)
    poses = camera_from_root @ body.instrument.forward(joints)
    links[where] = body.scenes.depths(poses, pixel_rays(camera)[where].astype(np.float64))[1]
    return links


def window_of_links(
    instrument: Instrument, camera: Camera, camera_from_root: Float64, joints: Float64, links: Sequence[int]
) -> Bool:
    """Return a window (H, W) of the image outside which none of these links can be seen, given by their indices."""
    poses = camera_from_root @ instrument.forward(joints)
    points = [apply(poses[k], instrument.links[k].vertices) for k in links]
    return _window(camera, np.concatenate(points)) if points else np.zeros((camera.height, camera.width), np.bool_)


def trace_rays(instrument: Instrument, rays: Float32, camera_from_root: Float64, joints: Float64) -> LinkView:
    """Trace rays (..., 3) from the camera's origin, as of `pixel_rays`, for a pose (4, 4) and joints (J,)."""
    surface = _Surface.of(instrument, camera_from_root, joints)
    return _traced(surface, rays, np.ones(rays.shape[:-1], dtype=np.bool_))


@dataclass(frozen=True, eq=False)
class _Surface:
    """The triangles of all links at a pose."""

    points: Float64
    """The vertices (V, 3) in the camera's frame, m."""
    faces: NDArray[np.int32]
    """Indices (F, 3) of the triangles' corners."""
    owner: NDArray[np.int32]
    """Index (F,) of the link of each triangle."""

    @classmethod
    def of(cls, instrument: Instrument, camera_from_root: Float64, joints: Float64) -> _Surface:
        """Place the links by ``camera_from_root`` (4, 4) and joints (J,)."""
        poses = camera_from_root @ instrument.forward(joints)
        points, faces, owner, before = [], [], [], 0
        for k, (link, pose) in enumerate(zip(instrument.links, poses, strict=True)):
            points.append(apply(pose, link.vertices))
            faces.append((link.faces + before).astype(np.int32))
            owner.append(np.full(len(link.faces), k, dtype=np.int32))
            before += len(link.vertices)
        return cls(np.concatenate(points), np.concatenate(faces), np.concatenate(owner))

    def normals(self, faces: NDArray[np.integer]) -> Float64:
        """Return the unit normals (N, 3) of some triangles (N,)."""
        some, place = np.unique(faces, return_inverse=True)
        corners = self.points[self.faces[some]]
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        return np.asarray((normals / np.linalg.norm(normals, axis=1, keepdims=True))[place])

    def scene(self) -> EmbreeScene:
        """Return a scene of the triangles."""
        return _scene(self.points.astype(np.float32).tobytes(), self.faces.tobytes())


def _traced(surface: _Surface, rays: Float32, inside: Bool) -> LinkView:
    """Trace the rays (..., 3) for which ``inside`` (...) is true; the others see nothing."""
    traced = np.ascontiguousarray(rays[inside])
    hits = surface.scene().run(np.ascontiguousarray(NEAR * traced), traced, output=True)
    hit = hits["primID"] != NOTHING
    face, towards = hits["primID"][hit], traced[hit]
    seen = np.zeros(inside.shape, dtype=np.bool_)
    seen[inside] = hit
    view = LinkView(
        link=np.full(inside.shape, NOTHING, dtype=np.int32),
        depth=np.zeros(inside.shape, dtype=np.float32),
        normal=np.zeros((*inside.shape, 3), dtype=np.float32),
        direction=np.zeros((*inside.shape, 3), dtype=np.float32),
    )
    view.link[seen] = surface.owner[face]
    view.depth[seen] = hits["tfar"][hit] + NEAR
    view.normal[seen] = surface.normals(face)
    view.direction[seen] = towards / np.linalg.norm(towards, axis=-1, keepdims=True)
    return view


@lru_cache(maxsize=_SCENES)
def _scene(points: bytes, faces: bytes) -> EmbreeScene:
    """Return a scene of triangles between points (V, 3) float32, whose indices are (F, 3) int32."""
    scene = EmbreeScene()
    TriangleMesh(scene, np.frombuffer(points, np.float32).reshape(-1, 3), np.frombuffer(faces, np.int32).reshape(-1, 3))
    ray = np.array([[0.0, 0.0, 1.0]], dtype=np.float32)
    scene.run(ray, ray, query="OCCLUDED")  # commits the scene, before threads share it
    return scene


def _window(camera: Camera, points: Float64) -> Bool:
    """Return a window (H, W) of the image that contains the projections of points (N, 3).

    It is the whole image if a point is nearer than the near plane or behind the camera.
    """
    inside = np.zeros((camera.height, camera.width), dtype=np.bool_)
    if points[:, 2].min() <= NEAR:
        inside[:] = True
        return inside
    pixels = camera.project(points)
    size = np.array([camera.width, camera.height])
    low = np.clip(np.floor(pixels.min(axis=0)).astype(int) - 1, 0, size)
    high = np.clip(np.ceil(pixels.max(axis=0)).astype(int) + 2, low, size)
    inside[low[1] : high[1], low[0] : high[0]] = True
    return inside
