"""Projection of all vertices of the meshes into the image, for a batch of poses."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.silhouette.grid import Float32, LineGrid, Projection
from dvrk_cmaes.silhouette.pose_batches import batch_size_for, matmul_in_blocks
from dvrk_cmaes.silhouette.scenes import NEAR
from dvrk_cmaes.silhouette.segments import Segments
from dvrk_cmaes.silhouette.topology import MeshTopology


class ProjectedVertices:
    """Image positions of the vertices, arrays (..., V, batch_size); undefined for vertices behind the near plane.

    For each link with vertices behind the near plane, ``behind`` flags these vertices, (V of the link, batch_size), and
    ``homogeneous`` holds u, v and 1 times the depth of all of the link's vertices, (3, V of the link, batch_size).
    """

    def __init__(self, topology: MeshTopology, projection: Projection, camera_from_link: NDArray[np.float64]) -> None:
        poses, batch_size = len(camera_from_link), batch_size_for(len(camera_from_link))
        self.batch_size = batch_size
        self.topology = topology
        self.projection = projection
        image_from_link = projection.matrix @ camera_from_link[:, :, :3]
        matrix = np.zeros((topology.links, 3, 4, batch_size), dtype=np.float32)
        matrix[:, 2, 3] = 1  # padding: all vertices coincide, so that no edge crosses a line
        matrix[..., :poses] = image_from_link.transpose(1, 2, 3, 0)
        nearest = (topology.corners @ image_from_link[:, :, 2, :, None]).min(axis=(0, 2, 3), initial=np.inf)

        homogeneous = np.empty((3, len(topology.vertices), batch_size), dtype=np.float32)
        depth = homogeneous[2]
        self.behind: dict[int, NDArray[np.bool_]] = {}
        self.homogeneous: dict[int, Float32] = {}
        for link in range(topology.links):
            part = slice(topology.vertex_start[link], topology.vertex_start[link + 1])
            for row, out in zip(matrix[link], homogeneous, strict=True):
                matmul_in_blocks(topology.vertices[part], row, out[part])
            if nearest[link] < 1.01 * NEAR:
                behind = depth[part] < NEAR
                if behind.any():
                    self.behind[link] = behind
                    self.homogeneous[link] = homogeneous[:, part].copy()
                    depth[part][behind] = 1
        self.inverse_depth: Float32 = np.divide(np.float32(1), depth, out=depth)
        image = homogeneous[:2]
        image *= self.inverse_depth
        self.xy: Float32 | None = None if projection.camera.is_pinhole else image
        self.pixels = projection.pixels(image.reshape(2, -1)).reshape(image.shape)

    def on(self, grid: LineGrid) -> VerticesOnLines:
        """Return the vertices in the coordinates of a grid of lines."""
        u, v = grid.place(self.pixels)
        return VerticesOnLines(self, grid, u, v, grid.first_line(v))


@dataclass(frozen=True, eq=False)
class VerticesOnLines:
    """Vertices in line coordinates, (V, batch_size): positions u, real line numbers v, first lines at or below."""

    vertices: ProjectedVertices
    grid: LineGrid
    u: Float32
    v: Float32
    line: NDArray[np.signedinteger[Any]]

    def ends(self, edge: NDArray[np.intp], pose: NDArray[np.intp]) -> NDArray[np.intp]:
        """Return the places (2, S) of both ends of S edges of given poses in the arrays (V, batch_size)."""
        ends = self.vertices.topology.edge_ends.take(edge, axis=1, mode="clip")
        ends *= self.vertices.batch_size
        ends += pose
        return ends

    def segments(
        self, edge: NDArray[np.intp], pose: NDArray[np.intp], ends: NDArray[np.intp], detail: bool
    ) -> Segments:
        """Return S edges of given poses with their ``ends`` as segments, with their inverse depth if ``detail``."""
        vertices, topology = self.vertices, self.vertices.topology
        return Segments(
            pose,
            topology.edge_faces[0].take(edge, mode="clip"),
            topology.weight.take(edge, mode="clip"),
            self.u.ravel().take(ends, mode="clip"),
            self.v.ravel().take(ends, mode="clip"),
            self.line.ravel().take(ends, mode="clip"),
            None if vertices.xy is None else vertices.xy.reshape(2, -1).take(ends, axis=1, mode="clip"),
            vertices.inverse_depth.ravel().take(ends, mode="clip") if detail else None,
        )
