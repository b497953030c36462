"""Which edges of an instrument's meshes can be outline, prepared once for all poses.

A triangle seen from the eye covers a patch of the image; the number of triangles over a point (the layer count)
changes only across edges whose faces do not cancel. An edge between a face that looks at the eye and one that looks
away is such an edge, and so is every edge with one face, and two faces turned against each other that look the same
way. Edges of more than two faces are split into pairs, which changes nothing: the change of the count across an edge
is a sum over its faces.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.instrument import Instrument
from dvrk_cmaes.silhouette.pose_batches import Words, same_in_all_lanes

Float32 = NDArray[np.float32]
Int32 = NDArray[np.int32]


@dataclass(frozen=True, eq=False)
class MeshTopology:
    """All links' vertices, face planes and edges in one set of arrays, links one after the other.

    Vertices and planes stay in their link's frame; ``*_start`` hold the L + 1 offsets of each link.
    """

    vertices: Float32
    """(V, 4) x, y, z, 1 in metres."""
    vertex_start: Int32
    planes: Float32
    """(F, 4) outward normal (of unit length) and offset: ``planes @ [eye, 1] > 0`` where the face looks at the eye."""
    face_start: Int32
    edge_start: Int32
    edge_ends: NDArray[np.intp]
    """(2, E) first and second vertex, in the direction in which the first of ``edge_faces`` runs along the edge."""
    edge_faces: NDArray[np.intp]
    """(2, E) the edge's faces; twice the same one where it has no other."""
    flip: dict[int, Words]
    """By the number of lanes: (E,) 0 or 1, outline where looks(first face) xor looks(second face) xor flip."""
    weight: NDArray[np.int8]
    """(E,) by how much the layer count changes across the edge where it is outline: 2, or 1 for an edge of one face."""
    same_way: NDArray[np.bool_]
    """(E,) whether the edge's second face, too, runs along it from its first to its second vertex."""
    corners: NDArray[np.float64]
    """(L, 8, 4) homogeneous corners of the box around each link's vertices, m."""

    @property
    def links(self) -> int:
        """Number of links with geometry."""
        return len(self.vertex_start) - 1


def _paired_edges(faces: NDArray[np.int32]) -> tuple[NDArray[np.int64], ...]:
    """Edges of one mesh as pairs of faces: from, to, left, right (-1 for none), and whether right runs the same way."""
    n = len(faces)
    start = faces.T.reshape(-1).astype(np.int64)
    end = np.roll(faces, -1, axis=1).T.reshape(-1).astype(np.int64)
    face = np.tile(np.arange(n), 3)
    forward = start < end
    low, high = np.minimum(start, end), np.maximum(start, end)
    # Along each edge, faces that run forwards and backwards alternate as far as they go, so that opposite ones pair up.
    order = np.lexsort((forward, high, low))
    key_low, key_high, direction = low[order], high[order], forward[order]
    new_run = np.r_[True, (np.diff(key_low) != 0) | (np.diff(key_high) != 0) | (direction[1:] != direction[:-1])]
    run_start = np.flatnonzero(new_run)
    rank = np.arange(len(order)) - run_start[np.cumsum(new_run) - 1]
    order = order[np.lexsort((direction, rank, key_high, key_low))]
    low, high, face, forward = low[order], high[order], face[order], forward[order]
    new_edge = np.r_[True, (np.diff(low) != 0) | (np.diff(high) != 0)]
    edge_first = np.flatnonzero(new_edge)
    position = np.arange(len(order)) - edge_first[np.cumsum(new_edge) - 1]
    left = np.flatnonzero(position % 2 == 0)
    has_right = (left + 1 < len(order)) & ~np.r_[new_edge, True][left + 1]
    right_at = np.minimum(left + 1, len(order) - 1)
    right = np.where(has_right, face[right_at], -1)
    same_way = has_right & (forward[right_at] == forward[left])
    runs_forward = forward[left]
    edge_from = np.where(runs_forward, low[left], high[left])
    edge_to = np.where(runs_forward, high[left], low[left])
    return edge_from, edge_to, face[left], right, same_way


def build_topology(instrument: Instrument) -> MeshTopology:
    """Prepare the meshes of all links of an instrument for outline extraction."""
    vertices, planes, corners = [], [], []
    edges: list[list[NDArray[np.int64]]] = [[], [], [], []]
    flips, weights, same_ways = [], [], []
    vertex_start, face_start, edge_start = [0], [0], [0]
    for link in instrument.links:
        triangles = link.vertices[link.faces]
        normal = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
        normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-30)
        offset = -np.einsum("ij,ij->i", normal, triangles.mean(axis=1))
        edge_from, edge_to, left, right, same_way = _paired_edges(link.faces)
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
        flips.append(same_way | alone)
        weights.append(np.where(alone, 1, 2))
        same_ways.append(same_way)
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
        flip=same_in_all_lanes(np.concatenate(flips)),
        weight=np.concatenate(weights).astype(np.int8),
        same_way=np.concatenate(same_ways),
        corners=np.array(corners, dtype=np.float64),
    )
