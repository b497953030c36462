"""Outline edges of the meshes for a batch of poses, and the segments of them that cross image lines.

All edges of an instrument and all poses of a batch are processed in one array operation. The data of the poses are
adjacent in memory, so the rows gathered for the two ends and two faces of each edge serve all poses of the batch.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.camera import Camera
from dvrk_cmaes.silhouette.grid import LineGrid, Projection
from dvrk_cmaes.silhouette.near_plane import cut_link
from dvrk_cmaes.silhouette.pose_batches import as_flags, as_words, batch_size_for, index_shift, matmul_in_blocks
from dvrk_cmaes.silhouette.scenes import LinkScenes
from dvrk_cmaes.silhouette.segments import Segments, subdivided
from dvrk_cmaes.silhouette.span_rays import SpanRays
from dvrk_cmaes.silhouette.topology import MeshTopology
from dvrk_cmaes.silhouette.vertices import ProjectedVertices


@dataclass(frozen=True, eq=False)
class OutlineSegments:
    """Segments of the outlines of a batch of poses that cross an image line."""

    segments: Segments
    front: NDArray[np.bool_]
    """(S,) whether the face of a segment is front-facing."""


def _front_facing(topology: MeshTopology, camera_from_link: NDArray[np.float64], batch_size: int) -> NDArray[np.bool_]:
    """Find the front-facing faces, (F, batch_size)."""
    centre = np.zeros((topology.links, 4, batch_size), dtype=np.float32)  # of the camera, in each link's frame
    centre[:, :3, : len(camera_from_link)] = -np.einsum(
        "clji,clj->lic", camera_from_link[..., :3, :3], camera_from_link[..., :3, 3]
    )
    centre[:, 3] = 1
    side = np.empty((len(topology.planes), batch_size), dtype=np.float32)
    for link in range(topology.links):
        faces = slice(topology.face_start[link], topology.face_start[link + 1])
        matmul_in_blocks(topology.planes[faces], centre[link], side[faces])
    return side > 0


class OutlineEdges:
    """The outline edges of a batch of poses (C, L, 4, 4), at most ``SUMMED_PER_BATCH``, for any grid of lines.

    ``scenes``, if given, are traced to decide what the instrument covers between the edges; otherwise layers count.
    """

    def __init__(
        self,
        topology: MeshTopology,
        camera: Camera,
        camera_from_link: NDArray[np.float64],
        scenes: LinkScenes | None = None,
    ) -> None:
        self.rays = None if scenes is None else SpanRays(scenes, camera, camera_from_link)
        self.poses, self._batch_size = len(camera_from_link), batch_size_for(len(camera_from_link))
        self.camera_from_link = camera_from_link
        self._topology = topology
        self._front_facing = _front_facing(topology, camera_from_link, self._batch_size)
        front_words = as_words(self._front_facing)
        outline = front_words.take(topology.edge_faces[0], axis=0, mode="clip")
        outline ^= front_words.take(topology.edge_faces[1], axis=0, mode="clip")
        outline ^= topology.flip_words(self._batch_size)
        self._outline = outline
        self._projection = Projection(camera)
        self._vertices = ProjectedVertices(topology, self._projection, camera_from_link)

    @property
    def links(self) -> int:
        """Number of links with geometry."""
        return self._topology.links

    def link_of(self, face: NDArray[np.intp]) -> NDArray[np.intp]:
        """Return the index of the link of each face (N,)."""
        return np.searchsorted(self._topology.face_start, face, side="right") - 1

    def segments(self, grid: LineGrid, *, detail: bool, exact: bool = False) -> OutlineSegments:
        """Return the outline segments that cross lines of a grid, with their inverse depth if ``detail``.

        ``exact`` ones follow the bends of a distorting lens as closely as whole pixels need.
        """
        straight, batch_size = self._projection.camera.is_pinhole, self._batch_size
        vertices, outline = self._vertices.on(grid), self._outline
        cut = []
        if self._vertices.behind:
            outline = outline.copy()
            cut = [cut_link(vertices, link, outline, detail) for link in self._vertices.behind]
        chosen = as_flags(outline)
        if self.poses < batch_size and not straight:
            chosen = chosen.copy()
            chosen[:, self.poses :] = False
        at = np.flatnonzero(chosen)
        edge, pose = at >> index_shift(batch_size), at & (batch_size - 1)
        ends = vertices.ends(edge, pose)
        if straight:
            crossing = np.flatnonzero(np.not_equal(*vertices.line.ravel().take(ends, mode="clip")))
            edge, pose, ends = (values.take(crossing, axis=-1, mode="clip") for values in (edge, pose, ends))
        segments = vertices.segments(edge, pose, ends, detail)
        for more in cut:
            segments = segments.concatenated(more.crossing() if straight else more)
        if not straight:
            segments = subdivided(segments, self._projection, grid, exact=exact)
        front = self._front_facing.ravel().take(segments.face * batch_size + segments.pose, mode="clip")
        return OutlineSegments(segments, front)
