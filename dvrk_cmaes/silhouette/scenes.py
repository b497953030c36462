"""Embree scenes of an instrument: one scene per link, in whose frame the rays are traced.

Mesh decimation by vertex clustering, for rendering at low image resolution.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from threading import Lock
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.errors import InputError
from dvrk_cmaes.geometry import Bool, Float32, Float64, Indices
from dvrk_cmaes.instrument import Instrument, Link

NEAR = 1e-3
"""Depth of the near plane, m along the optical axis: surfaces in front of it are not rendered."""


_NOTHING_HIT = 1e36  # below the distance that Embree states where a ray hits nothing


def _embree() -> Any:
    try:
        from embreex import rtcore_scene
        from embreex.mesh_construction import TriangleMesh
    except ImportError as error:
        raise InputError(
            f"embreex is missing or does not load ({error}): install it with 'pip install \"embreex>=4.4,<5\"'"
        ) from error
    return rtcore_scene.EmbreeScene, TriangleMesh


class LinkScenes:
    """Embree scenes, one for each link; may be queried from several threads at once.

    They are built when the first ray is traced: those of a body for the small images of a search mostly never are.
    Scenes cannot be pickled: each process builds its own. InputError if Embree is missing.
    """

    def __init__(self, instrument: Instrument) -> None:
        self._scene_type, self._mesh_type = _embree()
        self._links = instrument.links
        self._building = Lock()
        self._built: list[Any] = []

    @property
    def _scenes(self) -> list[Any]:
        """The scenes, which are built once."""
        with self._building:
            if not self._built:
                self._built = [self.scene_of(link) for link in self._links]
        return self._built

    def scene_of(self, link: Link) -> Any:
        """Build the scene of a link."""
        scene = self._scene_type()
        self._mesh_type(scene, link.vertices.astype(np.float32), link.faces)  # twice as quick as by triangles' corners
        # The first query commits the scene without a lock, so it is made before threads share the scene.
        ray = np.array([[0.0, 0.0, 1.0]], dtype=np.float32)
        scene.run(ray, ray, query="OCCLUDED")
        return scene

    def __len__(self) -> int:
        return len(self._links)

    def hit(self, link: int, origins: Float32, directions: Float32) -> Bool:
        """Return whether each ray, (N, 3) in the link's frame, hits the link, (N,)."""
        if len(origins) == 0:
            return np.zeros(0, dtype=np.bool_)
        found: NDArray[np.int32] = self._scenes[link].run(origins, directions, query="OCCLUDED")
        return np.asarray(found == 0)

    def covered(self, camera_from_link: Float64, pose: Indices, directions: Float64) -> Bool:
        """Return whether any link covers each viewing direction, (N,).

        ``camera_from_link`` is (C, L, 4, 4); ``pose`` (N,), ascending, is the index of the pose of each ray;
        ``directions`` (N, 3) are in the camera's frame with z = 1. A ray that has hit one link is not traced against
        the others.
        """
        result = np.zeros(len(directions), dtype=np.bool_)
        rotation = camera_from_link[:, :, :3, :3].astype(np.float32)
        centre = -np.einsum("clji,clj->cli", camera_from_link[:, :, :3, :3], camera_from_link[:, :, :3, 3])
        rest, left = np.arange(len(directions)), np.asarray(directions, dtype=np.float32)
        for link in range(len(self)):
            ends = np.searchsorted(pose[rest], np.arange(len(camera_from_link) + 1))
            turned, origins = np.empty_like(left), np.empty_like(left)
            for one, (begin, end) in enumerate(pairwise(ends)):
                np.matmul(left[begin:end], rotation[one, link], out=turned[begin:end])
                np.add(centre[one, link].astype(np.float32), NEAR * turned[begin:end], out=origins[begin:end])
            hit = self.hit(link, origins, turned)
            result[rest[hit]] = True
            rest, left = rest[~hit], left[~hit]
        return result

    def depths(self, camera_from_link: Float64, directions: Float64) -> tuple[Float64, Indices]:
        """Return the depth of the nearest surface along viewing directions, and the link that it belongs to, (N,) each.

        ``camera_from_link`` is (L, 4, 4), of one pose; ``directions`` (N, 3) are in the camera's frame with z = 1, so
        that depths are z in that frame, m. Where no link is hit, the depth is infinite and the link -1.
        """
        depth, owner = np.full(len(directions), np.inf), np.full(len(directions), -1, dtype=np.intp)
        if len(directions) == 0:
            return depth, owner
        for link, pose in enumerate(camera_from_link):
            turned = np.ascontiguousarray(directions @ pose[:3, :3], dtype=np.float32)
            origins = (NEAR * turned - pose[:3, :3].T @ pose[:3, 3]).astype(np.float32)
            beyond = self._scenes[link].run(origins, turned, query="DISTANCE") + np.float64(NEAR)
            nearer = (beyond < _NOTHING_HIT) & (beyond < depth)
            depth[nearer], owner[nearer] = beyond[nearer], link
        return depth, owner


_LARGEST = 1 << 62  # number of different rows, up to which each has a number of 64 bits


def decimate(instrument: Instrument, cell: float) -> tuple[Instrument, float]:
    """Replace the vertices of each link within a cubic grid cell, ``cell`` m wide, by their mean.

    Returns the instrument and the largest distance, m, by which a vertex moved. This distance also bounds the motion
    of every other point of the surface, because these are convex combinations of vertices. The error of the outline in
    the image is therefore at most this distance times focal length over depth.
    """
    links, errors = zip(*(_decimate_link(link, cell) for link in instrument.links), strict=True)
    return replace(instrument, links=links), max(errors)


def _decimate_link(link: Link, cell: float) -> tuple[Link, float]:
    cells = np.floor(link.vertices / cell).astype(np.int64)
    _, group = np.unique(_keys(cells - cells.min(axis=0)), return_inverse=True)
    size = np.bincount(group)
    vertices = np.stack([np.bincount(group, weights=column) for column in link.vertices.T], axis=1) / size[:, None]
    faces: NDArray[np.int32] = group[link.faces].astype(np.int32)
    faces = faces[(faces != np.roll(faces, 1, axis=1)).all(axis=1)]
    _, once = np.unique(_keys(np.sort(faces, axis=1).astype(np.int64)), return_index=True)
    moved = float(np.linalg.norm(vertices[group] - link.vertices, axis=1).max())
    return Link(link.name, vertices, np.ascontiguousarray(faces[np.sort(once)])), moved


def _keys(rows: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return a number for each row (N, 3) of numbers from 0 on, in their order; `np.unique` is faster on it."""
    first, second, third = (rows.max(axis=0, initial=0) + 1).tolist()
    if first * second * third >= _LARGEST:
        return np.asarray(np.unique(rows, axis=0, return_inverse=True)[1]).ravel()
    return np.asarray((rows[:, 0] * second + rows[:, 1]) * third + rows[:, 2])
