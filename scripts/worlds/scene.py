"""Instruments in a frame, and what rays from the camera (Embree) meet of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import cv2
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
_MANY_RAYS: Final = 50_000  # from which on those that meet nothing are sorted out first
_CELLS: Final = 512  # of the plane z = 1, along each side of what the rays cover
_NOTHING: Final = 1e37  # m, where a ray meets nothing
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
        count = 1 + self.link.max()
        of_link = self.tool * count + self.link
        self._outlines = [_seen_in_plane(self.points, self.faces[of_link == each]) for each in np.unique(of_link)]
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
        face, depth = np.full(len(rays), -1, np.int64), np.full(len(rays), _NOTHING, np.float32)
        chosen = self._near(rays)
        for part in np.array_split(chosen, max(1, -(-len(chosen) // _MOST_RAYS))):
            found = self._scene.run(np.ascontiguousarray(NEAREST * rays[part]), rays[part], output=True)
            face[part], depth[part] = found["primID"], found["tfar"] + NEAREST
        return face, depth

    def _near(self, rays: Float32) -> NDArray[np.int64]:
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


def _seen_in_plane(points: Float64, faces: NDArray[np.int64]) -> Float64:
    """Return points (N, 2) of the plane z = 1 whose convex hull holds all of some triangles that is beyond NEAREST."""
    before = points[:, 2] > NEAREST
    edges = faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    a, b = np.swapaxes(points[edges[before[edges[:, 0]] != before[edges[:, 1]]]], 0, 1)
    cut = a + ((NEAREST - a[:, 2]) / (b[:, 2] - a[:, 2]))[:, None] * (b - a)
    corners = np.unique(faces)
    seen = np.concatenate([points[corners[before[corners]]], cut])
    return np.asarray(seen[:, :2] / seen[:, 2:])


def ends_seen(tools: Sequence[Placed], number: int) -> float:
    """Return the share of the ends of a tool that are before the camera and not hidden by it or another tool."""
    placed = tools[number]
    ends = apply(placed.camera_from_root, placed.instrument.ends(placed.joints))
    _, depth = Scene(tools).hits((ends / ends[:, 2:]).astype(np.float32))
    return float(np.mean((depth > ends[:, 2] - _HIDDEN) | (depth <= NEAREST)))
