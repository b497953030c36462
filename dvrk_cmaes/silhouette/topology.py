"""Edge topology of an instrument's meshes, computed once for all poses.

The layer count of an image point is the number of triangles that project onto it. It changes only across outline edges:
edges between a front-facing and a back-facing triangle, boundary edges with a single face, and edges between two faces
of opposite winding that are both front-facing or both back-facing. Edges with more than two faces are split into pairs
of faces; this is exact, because the change of the layer count across an edge is a sum over its faces.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import product

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.instrument import Instrument
from dvrk_cmaes.silhouette.pose_batches import Words, repeated_words

Float32 = NDArray[np.float32]
Int32 = NDArray[np.int32]


@dataclass(frozen=True, eq=False)
class MeshTopology:
    """Vertices, face planes and edges of all links, concatenated link by link.

    Vertices and planes are in the frame of their link; ``*_start`` (L + 1,) hold the offset at which each link starts.
    """

    vertices: Float32
    """(V, 4) x, y, z, 1 in metres."""
    vertex_start: Int32
    planes: Float32
    """(F, 4) outward unit normal n and offset d, m: the face is front-facing from a camera at c if n @ c + d > 0."""
    face_start: Int32
    edge_start: Int32
    edge_ends: NDArray[np.intp]
    """(2, E) first and second vertex, in the winding order of the first of ``edge_faces``."""
    edge_faces: NDArray[np.intp]
    """(2, E) the edge's two faces; a boundary edge has the same face twice."""
    flip: NDArray[np.bool_]
    """(E,) an edge is outline where front(first face) xor front(second face) xor flip."""
    weight: NDArray[np.int8]
    """(E,) magnitude of the change of the layer count across an outline edge: 2, or 1 for a boundary edge."""
    same_direction: NDArray[np.bool_]
    """(E,) whether the second face, too, has the edge's vertices in the order first, second."""
    corners: NDArray[np.float64]
    """(L, 8, 4) homogeneous corners of each link's bounding box, m."""

    _flip_words: dict[int, Words] = field(init=False, repr=False, default_factory=dict)

    def flip_words(self, batch_size: int) -> Words:
        """Return ``flip`` repeated for every pose of a batch, (E, words); computed once for each batch size."""
        if batch_size not in self._flip_words:
            self._flip_words[batch_size] = repeated_words(self.flip, batch_size)
        return self._flip_words[batch_size]

    @property
    def links(self) -> int:
        """Number of links with geometry."""
        return len(self.vertex_start) - 1


def _paired_edges(faces: NDArray[np.int32]) -> tuple[NDArray[np.int64], ...]:
    """Pair the faces of one mesh along its edges.

    ``faces`` is (F, 3). Returns for each edge its first and second vertex, its first and second face (-1 for none), and
    whether the second face has the edge's vertices in the same order as the first.
    """
    n = len(faces)
    start = faces.T.reshape(-1).astype(np.int64)
    end = np.roll(faces, -1, axis=1).T.reshape(-1).astype(np.int64)
    face = np.tile(np.arange(n), 3)
    forward = start < end
    low, high = np.minimum(start, end), np.maximum(start, end)
    # At each edge, faces of either winding alternate as far as possible, so that faces of opposite winding are paired.
    # The keys of each sort are one number: sorting by several is two to three times slower.
    edge = low * (int(high.max(initial=0)) + 1) + high
    order = (edge * 2 + forward).argsort(kind="stable")
    edge, direction = edge[order], forward[order]
    new_run = np.r_[True, (np.diff(edge) != 0) | (direction[1:] != direction[:-1])]
    run_start = np.flatnonzero(new_run)
    rank = np.arange(len(order)) - run_start[np.cumsum(new_run) - 1]
    if rank.any():  # otherwise no edge has two faces of the same winding, and the order stays the same
        order = order[((edge * (int(rank.max()) + 1) + rank) * 2 + direction).argsort(kind="stable")]
    low, high, face, forward = low[order], high[order], face[order], forward[order]
    new_edge = np.r_[True, (np.diff(low) != 0) | (np.diff(high) != 0)]
    edge_first = np.flatnonzero(new_edge)
    position = np.arange(len(order)) - edge_first[np.cumsum(new_edge) - 1]
    left = np.flatnonzero(position % 2 == 0)
    has_right = (left + 1 < len(order)) & ~np.r_[new_edge, True][left + 1]
    right_at = np.minimum(left + 1, len(order) - 1)
    right = np.where(has_right, face[right_at], -1)
    same_direction = has_right & (forward[right_at] == forward[left])
    runs_forward = forward[left]
    edge_from = np.where(runs_forward, low[left], high[left])
    edge_to = np.where(runs_forward, high[left], low[left])
    return edge_from, edge_to, face[left], right, same_direction


def build_topology(instrument: Instrument) -> MeshTopology:
    """Compute the edge topology of all links of an instrument."""
    vertices, planes, corners = [], [], []
    edges: list[list[NDArray[np.int64]]] = [[], [], [], []]
    flips, weights, same_directions = [], [], []
    vertex_start, face_start, edge_start = [0], [0], [0]
    for link in instrument.links:
        triangles = link.vertices[link.faces]
        normal = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
        normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-30)
        offset = -np.einsum("ij,ij->i", normal, triangles.sum(axis=1) / 3)
        edge_from, edge_to, left, right, same_direction = _paired_edges(link.faces)
        alone = right < 0
        vertices.append(np.c_[link.vertices, np.ones(len(link.vertices))])
        planes.append(np.c_[normal, offset])
        low, high = link.vertices.min(axis=0), link.vertices.max(axis=0)
        corners.append([[*np.where(upper, high, low), 1.0] for upper in product((False, True), repeat=3)])
        for stack, values, base in zip(
            edges,
            (edge_from, edge_to, left, np.where(alone, left, right)),
            (vertex_start[-1], vertex_start[-1], face_start[-1], face_start[-1]),
            strict=True,
        ):
            stack.append(values + base)
        flips.append(same_direction | alone)
        weights.append(np.where(alone, 1, 2))
        same_directions.append(same_direction)
        vertex_start.append(vertex_start[-1] + len(link.vertices))
        face_start.append(face_start[-1] + len(link.faces))
        edge_start.append(edge_start[-1] + len(left))
    edge_from, edge_to, left, right = (np.concatenate(stack).astype(np.intp) for stack in edges)
    return MeshTopology(
        vertices=np.ascontiguousarray(np.concatenate(vertices), dtype=np.float32),
        vertex_start=np.array(vertex_start, dtype=np.int32),
        planes=np.ascontiguousarray(np.concatenate(planes), dtype=np.float32),
        face_start=np.array(face_start, dtype=np.int32),
        edge_start=np.array(edge_start, dtype=np.int32),
        edge_ends=np.stack([edge_from, edge_to]),
        edge_faces=np.stack([left, right]),
        flip=np.concatenate(flips),
        weight=np.concatenate(weights).astype(np.int8),
        same_direction=np.concatenate(same_directions),
        corners=np.array(corners, dtype=np.float64),
    )
