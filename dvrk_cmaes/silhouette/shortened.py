"""An instrument whose shaft is cut off outside the image, so that its faces there need not be processed.

Most of an instrument's shaft lies outside the image, and it usually reaches behind the camera, where each of its edges
has to be cut at the near plane. A part that lies outside one plane of the viewing frustum covers no pixel. What is left
is rendered as a mesh with a boundary, whose layer count is exact in the image.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache
from itertools import product

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.camera import Camera
from dvrk_cmaes.geometry import frame_along
from dvrk_cmaes.instrument import Instrument, Link
from dvrk_cmaes.silhouette.kept import topology_of
from dvrk_cmaes.silhouette.scenes import NEAR
from dvrk_cmaes.silhouette.topology import MeshTopology

Float64 = NDArray[np.float64]

_KEPT = np.array([0.03, 0.045, 0.07, 0.1, 0.15])  # m, from the root's origin along the shaft
_MARGIN = 0.1  # of the image, on each side, if the lens bends the planes of the frustum
_SAMPLES = 9  # points on each side of the image's border


class ShortenedShaft:
    """The topologies of an instrument with shafts of several lengths; each is computed when it is first needed.

    ``whole`` returns that of the whole instrument.
    """

    def __init__(self, instrument: Instrument, whole: Callable[[], MeshTopology]) -> None:
        self._instrument = instrument
        self._whole = whole
        self._built: dict[int, MeshTopology] = {}
        self._corners = self._corners_of_cut_parts()

    def topology_for(self, camera: Camera, camera_from_link: Float64) -> MeshTopology:
        """Return the topology with the shortest shaft that looks in the image as the whole one, in all C poses.

        ``camera_from_link`` is (C, L, 4, 4).
        """
        if not len(self._corners) or not len(camera_from_link):
            return self._whole()
        root = camera_from_link[:, 0]
        sides = self._corners @ (_frustum(camera) @ root).swapaxes(1, 2)
        beyond = (sides < 0).reshape(len(root), -1, 8, sides.shape[2])
        outside = np.all(np.any(np.all(beyond, axis=2), axis=2), axis=0)
        if not outside.any():
            return self._whole()
        index = int(outside.argmax())
        if index not in self._built:
            self._built[index] = topology_of(self._cut(float(_KEPT[index])))
        return self._built[index]

    def _corners_of_cut_parts(self) -> Float64:
        """Compute the homogeneous corners (8 K, 4) of boxes around what each of K lengths cuts off, in the root."""
        shaft = self._instrument.shaft
        if shaft is None or self._instrument.links[0].name != self._instrument.root_link:
            return np.empty((0, 4))
        axes = frame_along(shaft.direction)
        inside = (self._instrument.links[0].vertices - shaft.point) @ axes
        low, high = inside.min(axis=0), inside.max(axis=0)
        kept = _KEPT[low[2] < -_KEPT]
        corners = [
            np.where(upper, [*high[:2], -length], low) for length in kept for upper in product((False, True), repeat=3)
        ]
        points = np.reshape(corners, (-1, 3)) @ axes.T + shaft.point
        return np.column_stack([points, np.ones(len(points))])

    def _cut(self, length: float) -> Instrument:
        """Return the instrument with a shaft of the given length, m, behind the root's origin."""
        shaft, links = self._instrument.shaft, self._instrument.links
        assert shaft is not None
        return replace(self._instrument, links=(cut_off(links[0], shaft.point, shaft.direction, -length), *links[1:]))


def cut_off(link: Link, point: Float64, direction: Float64, least: float) -> Link:
    """Cut a link's mesh at a plane and drop what lies behind it; the cut is left open.

    The plane consists of the points whose coordinate along the unit vector ``direction`` from ``point`` is ``least``.
    """
    ahead = (link.vertices - point) @ direction - least
    kept = (ahead >= 0)[link.faces]
    count = kept.sum(axis=1)
    cut = np.flatnonzero((count == 1) | (count == 2))
    # Turn each cut face so that its first vertex is the one that is alone on its side of the plane.
    alone = np.where(count[cut] == 1, kept[cut].argmax(axis=1), kept[cut].argmin(axis=1))
    a, b, c = (link.faces[cut, (alone + k) % 3] for k in range(3))
    # Both faces at an edge cut it at the same vertex.
    edges = np.sort(np.concatenate([np.stack([a, b], axis=1), np.stack([a, c], axis=1)]), axis=1)
    ends, which = np.unique(edges, axis=0, return_inverse=True)
    before, after = ahead[ends].T
    share = (before / (before - after))[:, None]
    added = (1 - share) * link.vertices[ends[:, 0]] + share * link.vertices[ends[:, 1]]
    on_ab, on_ac = which.reshape(2, -1) + len(link.vertices)
    tip = count[cut] == 1
    faces = [
        link.faces[count == 3],
        np.stack([a, on_ab, on_ac], axis=1)[tip],
        np.stack([on_ab, b, c], axis=1)[~tip],
        np.stack([on_ab, c, on_ac], axis=1)[~tip],
    ]
    every = np.concatenate(faces).astype(np.int64)
    used, index = np.unique(every, return_inverse=True)
    vertices = np.concatenate([link.vertices, added])[used]
    return Link(link.name, vertices, index.reshape(-1, 3).astype(np.int32))


@lru_cache(maxsize=64)
def _frustum(camera: Camera) -> Float64:
    """Return the planes (5, 4) that bound what can be seen: n @ p + d < 0 for points p outside, in the camera."""
    across, down = np.linspace(-0.5, camera.width - 0.5, _SAMPLES), np.linspace(-0.5, camera.height - 0.5, _SAMPLES)
    u, v = np.meshgrid(across, down)
    seen = camera.normalise(np.stack([u.ravel(), v.ravel()], axis=1))
    margin = 0.0 if camera.is_pinhole else _MARGIN
    low, high = seen.min(axis=0), seen.max(axis=0)
    low, high = low - margin * (high - low), high + margin * (high - low)
    return np.array(
        [
            [1.0, 0.0, -low[0], 0.0],
            [-1.0, 0.0, high[0], 0.0],
            [0.0, 1.0, -low[1], 0.0],
            [0.0, -1.0, high[1], 0.0],
            [0.0, 0.0, 1.0, -NEAR],
        ]
    )
