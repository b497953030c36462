"""From poses to segments: which edges of the meshes are outline, and which of them cross a line of the image.

All of it is done for the edges of a whole mesh at once, and for a few poses in the lanes of one array, so that
what is costly (one row gathered for each end and face of every edge) is paid once for all of them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.camera import Camera
from dvrk_cmaes.silhouette.grid import LineGrid, Projection
from dvrk_cmaes.silhouette.near_plane import cut_link
from dvrk_cmaes.silhouette.pose_batches import answers_of, lanes_for, product, shift_of, words_of
from dvrk_cmaes.silhouette.segments import Segments, bent
from dvrk_cmaes.silhouette.topology import MeshTopology
from dvrk_cmaes.silhouette.vertices import ProjectedVertices


@dataclass(frozen=True, eq=False)
class OutlineSegments:
    """Segments of the outlines of a few poses that cross a line of the image."""

    segments: Segments
    front: NDArray[np.bool_]
    """(S,) whether the face of a segment looks at the eye."""


def _looks(topology: MeshTopology, camera_from_link: NDArray[np.float64], lanes: int) -> NDArray[np.bool_]:
    """Which faces look at the eye, (F, lanes)."""
    eye = np.zeros((topology.links, 4, lanes), dtype=np.float32)
    eye[:, :3, : len(camera_from_link)] = -np.einsum(
        "clji,clj->lic", camera_from_link[..., :3, :3], camera_from_link[..., :3, 3]
    )
    eye[:, 3] = 1
    side = np.empty((len(topology.planes), lanes), dtype=np.float32)
    for link in range(topology.links):
        faces = slice(topology.face_start[link], topology.face_start[link + 1])
        product(topology.planes[faces], eye[link], side[faces])
    return side > 0


class OutlineEdges:
    """The outline edges of a few poses (C, L, 4, 4), at most ``LANES``, for lines of any kind."""

    def __init__(self, topology: MeshTopology, camera: Camera, camera_from_link: NDArray[np.float64]) -> None:
        self.poses, self._lanes = len(camera_from_link), lanes_for(len(camera_from_link))
        self.camera_from_link = camera_from_link
        self._topology = topology
        self._looks = _looks(topology, camera_from_link, self._lanes)
        looks = words_of(self._looks)
        outline = looks.take(topology.edge_faces[0], axis=0, mode="clip")
        outline ^= looks.take(topology.edge_faces[1], axis=0, mode="clip")
        outline ^= topology.flip[self._lanes]
        self._outline = outline
        self._projection = Projection(camera)
        self._vertices = ProjectedVertices(topology, self._projection, camera_from_link)

    @property
    def links(self) -> int:
        """Number of links with geometry."""
        return self._topology.links

    def link_of(self, face: NDArray[np.intp]) -> NDArray[np.intp]:
        """Which link faces (N,) belong to."""
        return np.searchsorted(self._topology.face_start, face, side="right") - 1

    def segments(self, grid: LineGrid, *, detail: bool) -> OutlineSegments:
        """Segments of the outlines, as far as they cross lines; with ``detail``, they know their depth."""
        straight, lanes = self._projection.camera.is_pinhole, self._lanes
        vertices, outline = self._vertices.on(grid), self._outline
        cut = []
        if self._vertices.behind:
            outline = outline.copy()
            cut = [cut_link(vertices, link, outline, detail) for link in self._vertices.behind]
        chosen = answers_of(outline)
        if straight:
            start, end = (vertices.line.take(ends, axis=0, mode="clip") for ends in self._topology.edge_ends)
            chosen = chosen & (start != end)
        elif self.poses < lanes:
            chosen = chosen.copy()
            chosen[:, self.poses :] = False
        at = np.flatnonzero(chosen)
        segments = vertices.segments(at >> shift_of(lanes), at & (lanes - 1), detail)
        for more in cut:
            segments = segments.and_more(more.crossing() if straight else more)
        if not straight:
            segments = bent(segments, self._projection, grid)
        return OutlineSegments(segments, self._looks.ravel().take(segments.face * lanes + segments.lane, mode="clip"))
