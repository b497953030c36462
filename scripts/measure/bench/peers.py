"""Other renderers of silhouettes, for comparison: trimesh, Open3D, OpenCV, and our own trace of every pixel.

A peer draws the masks of C poses (C, H, W) and sums K images over each mask. The rays, and the images as a matrix, are
prepared once. The instrument is posed as one mesh, and its scene is built again for each pose, which takes less time
than the transformation of one ray for each pixel into the frame of each link.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
import trimesh
from numpy.typing import NDArray

from dvrk_cmaes.camera import Camera
from dvrk_cmaes.geometry import apply
from dvrk_cmaes.silhouette import NEAR, Body, Renderer

Float64 = NDArray[np.float64]
Masks = NDArray[np.bool_]
_SHIFT = 4  # fractional bits of OpenCV's pixel coordinates


@dataclass(frozen=True)
class Peer:
    """Renderer of silhouettes: ``masks`` maps poses (C, 4, 4) and joints (C, J) to masks (C, H, W)."""

    name: str
    threads: str
    masks: Callable[[Float64, Float64], Masks]

    def sums(self, poses: Float64, joints: Float64, images: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return the sums (C, K) of images (K, H * W) over the masks of C poses."""
        masks = self.masks(poses, joints)
        return masks.reshape(len(masks), -1).astype(np.float32) @ images.T


def all_peers(body: Body, camera: Camera, threads: int) -> tuple[list[Peer], list[str]]:
    """Return the peers that are installed, and one message for each of the others."""
    makers = {"trimesh": _trimesh, "Open3D": _open3d, "OpenCV fill": _opencv, "own trace": _own_trace}
    peers, left_out = [], []
    for name, make in makers.items():
        try:
            peers.append(make(body, camera, threads))
        except (ImportError, OSError) as error:
            left_out.append(f"{name}: {error}")
    return peers, left_out


def _rays(camera: Camera) -> NDArray[np.float32]:
    """Return rays (H * W, 6) through all pixels, starting at the near plane: origin and direction."""
    v, u = np.mgrid[: camera.height, : camera.width]
    pixels = np.stack([u.ravel(), v.ravel()], axis=1).astype(np.float64)
    directions = np.c_[camera.normalise(pixels), np.ones(len(pixels))]
    return np.concatenate([NEAR * directions, directions], axis=1).astype(np.float32)


def _posed(body: Body, poses: Float64, joints: Float64) -> Iterator[tuple[Float64, NDArray[np.int32]]]:
    """Yield the whole instrument in the camera's frame in each pose, as one mesh: vertices (V, 3) and faces (F, 3)."""
    links = body.instrument.links
    offsets = np.cumsum([0, *(len(link.vertices) for link in links)])
    faces = np.concatenate([link.faces + offset for link, offset in zip(links, offsets, strict=False)]).astype(np.int32)
    for transforms in body.camera_from_links(poses, joints):
        parts = [apply(pose, link.vertices) for link, pose in zip(links, transforms, strict=True)]
        yield np.concatenate(parts), faces


def _trimesh(body: Body, camera: Camera, threads: int) -> Peer:
    """Make the peer that traces rays with trimesh (Embree), on one thread."""
    from trimesh.ray.ray_pyembree import RayMeshIntersector

    rays = _rays(camera)
    origins, directions = np.ascontiguousarray(rays[:, :3]), np.ascontiguousarray(rays[:, 3:])

    def masks(poses: Float64, joints: Float64) -> Masks:
        found = np.empty((len(poses), camera.height, camera.width), dtype=np.bool_)
        for mask, (vertices, faces) in zip(found, _posed(body, poses, joints), strict=True):
            tracer: Any = RayMeshIntersector(trimesh.Trimesh(vertices, faces, process=False))
            mask[:] = tracer.intersects_any(origins, directions).reshape(mask.shape)
        return found

    return Peer("trimesh RayMeshIntersector", "1", masks)


def _open3d(body: Body, camera: Camera, threads: int) -> Peer:
    """Make the peer that traces rays with Open3D (Embree)."""
    import open3d

    rays = open3d.core.Tensor(_rays(camera))

    def masks(poses: Float64, joints: Float64) -> Masks:
        found = np.empty((len(poses), camera.height, camera.width), dtype=np.bool_)
        for mask, (vertices, faces) in zip(found, _posed(body, poses, joints), strict=True):
            scene = open3d.t.geometry.RaycastingScene(nthreads=threads)
            scene.add_triangles(vertices.astype(np.float32), faces.astype(np.uint32))
            mask[:] = scene.test_occlusions(rays, nthreads=threads).numpy().reshape(mask.shape)
        return found

    return Peer("Open3D RaycastingScene", str(threads), masks)


def _own_trace(body: Body, camera: Camera, threads: int) -> Peer:
    """Make the peer that traces every pixel with our renderer, on one thread."""
    return Peer("own trace of every pixel", "1", Renderer(body, camera, threads=1).trace)


def _opencv(body: Body, camera: Camera, threads: int) -> Peer:
    """Make the peer that fills triangles with OpenCV, one call each, since a common call uses the even-odd rule."""
    size = np.array([camera.width, camera.height])

    def masks(poses: Float64, joints: Float64) -> Masks:
        images = np.zeros((len(poses), camera.height, camera.width), dtype=np.uint8)
        for image, (vertices, faces) in zip(images, _posed(body, poses, joints), strict=True):
            pixels = camera.project(_clipped(vertices[faces]))
            seen = ((pixels.max(axis=1) > -1) & (pixels.min(axis=1) < size)).all(axis=1)
            corners = np.rint(np.clip(pixels[seen], -16000, 16000) * (1 << _SHIFT)).astype(np.int32)
            for triangle in corners:
                cv2.fillConvexPoly(image, triangle, 1, cv2.LINE_8, _SHIFT)
        return images.view(np.bool_)

    return Peer("OpenCV fillConvexPoly", str(cv2.getNumThreads()), masks)


def _clipped(triangles: Float64) -> Float64:
    """Clip triangles (T, 3, 3) at the near plane; a clipped triangle becomes one or two triangles."""
    behind = triangles[:, :, 2] < NEAR
    count = behind.sum(axis=1)
    parts = [triangles[count == 0]]
    for number in (1, 2):
        some = triangles[count == number]
        # rotated so that the corner alone on its side of the plane comes first
        odd = np.argmax(behind[count == number] == (number == 1), axis=1)
        a, b, c = (some[np.arange(len(some)), (odd + k) % 3] for k in range(3))
        ab = a + ((NEAR - a[:, 2]) / (b[:, 2] - a[:, 2]))[:, None] * (b - a)
        ac = a + ((NEAR - a[:, 2]) / (c[:, 2] - a[:, 2]))[:, None] * (c - a)
        kept = [(ab, b, c), (ab, c, ac)] if number == 1 else [(a, ab, ac)]
        parts += [np.stack(part, axis=1) for part in kept]
    return np.concatenate(parts)
