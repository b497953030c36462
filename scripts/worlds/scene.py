"""Instruments in a frame, and what rays from the camera (Embree) meet of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene
from numpy.typing import NDArray

from dvrk_cmaes.geometry import apply, inverse
from dvrk_cmaes.instrument import Instrument

Float32 = NDArray[np.float32]
Float64 = NDArray[np.float64]

NEAREST: Final = 1e-3  # m, along the optical axis
_MOST_RAYS: Final = 2_000_000  # at a time
_HIDDEN: Final = 1.5e-3  # m, by which what a ray meets must be nearer than an end to hide it


@dataclass(frozen=True, eq=False)
class Placed:
    """An instrument in a frame: ``camera_from_root`` (4, 4), m, and joints (J,)."""

    instrument: Instrument
    camera_from_root: Float64
    joints: Float64


class Scene:
    """The triangles of some instruments, which rays from the camera meet."""

    def __init__(self, tools: Sequence[Placed]) -> None:
        self.tools = tools
        points, faces, owner, before = [], [], [], 0
        for number, placed in enumerate(tools):
            poses = placed.camera_from_root @ placed.instrument.forward(placed.joints)
            for index, (link, camera_from_link) in enumerate(zip(placed.instrument.links, poses, strict=True)):
                points.append(apply(camera_from_link, link.vertices))
                faces.append(link.faces + before)
                owner.append(np.tile([[number], [index]], len(link.faces)))
                before += len(link.vertices)
        self.tool, self.link = np.concatenate(owner, axis=1)
        self.points, self.faces = np.concatenate(points), np.concatenate(faces)
        self._scene = EmbreeScene()
        TriangleMesh(self._scene, self.points.astype(np.float32), self.faces.astype(np.int32))

    def normals(self, face: NDArray[np.int64]) -> Float64:
        """Return the unit normals (N, 3) of triangles."""
        a, b, c = np.swapaxes(self.points[self.faces[face]], 0, 1)
        normals = np.cross(b - a, c - a)
        return np.asarray(normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30))

    def steel(self, face: NDArray[np.int64]) -> NDArray[np.bool_]:
        """Return whether triangles (N,) are beyond the end of the black shaft."""
        found = self.link[face] > 0
        for number, placed in enumerate(self.tools):
            shaft, own = placed.instrument.shaft, self.tool[face] == number
            if shaft is not None:
                middles = self.points[self.faces[face[own]]].mean(axis=1)
                found[own] |= apply(inverse(placed.camera_from_root), middles)[:, 2] > shaft.distal_end
        return np.asarray(found)

    def hits(self, rays: Float32) -> tuple[NDArray[np.int64], Float32]:
        """Return for rays (N, 3), whose z is 1, the triangle that each meets first, or -1, and its depth, m."""
        found = [
            self._scene.run(np.ascontiguousarray(NEAREST * part), np.ascontiguousarray(part), output=True)
            for part in np.array_split(rays, max(1, -(-len(rays) // _MOST_RAYS)))
        ]
        face = np.concatenate([each["primID"] for each in found]).astype(np.int64)
        return face, np.asarray(np.concatenate([each["tfar"] for each in found]) + NEAREST, np.float32)


def ends_seen(tools: Sequence[Placed], number: int) -> float:
    """Return the share of the ends of a tool that are before the camera and not hidden by it or another tool."""
    placed = tools[number]
    ends = apply(placed.camera_from_root, placed.instrument.ends(placed.joints))
    _, depth = Scene(tools).hits((ends / ends[:, 2:]).astype(np.float32))
    return float(np.mean((depth > ends[:, 2] - _HIDDEN) | (depth <= NEAREST)))
