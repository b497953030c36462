"""Cut a link at the near plane: what is left of its outline edges, and the edge along which each face is cut.

With the latter, what is left of a mesh has no holes that nobody counts: every line's changes sum to zero.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.silhouette.grid import Float32
from dvrk_cmaes.silhouette.pose_batches import Words, answers_of, shift_of, words_of
from dvrk_cmaes.silhouette.scenes import NEAR
from dvrk_cmaes.silhouette.segments import Segments
from dvrk_cmaes.silhouette.vertices import VerticesOnLines


def _cut_points(homogeneous: Float32, ends: NDArray[np.intp]) -> Float32:
    """Where edges meet the near plane, (2, N) after the division by depth; ``ends`` (2, N) index homogeneous points."""
    # The same whichever way an edge is written down: one that several pairs of faces share is there repeatedly.
    in_order = np.stack([np.minimum(*ends), np.maximum(*ends)])
    before, after = homogeneous.reshape(3, -1).take(in_order, axis=1).astype(np.float64).transpose(1, 0, 2)
    share = (NEAR - before[2]) / (after[2] - before[2])
    at: Float32 = ((before[:2] + share * (after[:2] - before[:2])) / NEAR).astype(np.float32)
    return at


def cut_link(on_lines: VerticesOnLines, link: int, outline: Words, detail: bool) -> Segments:
    """Segments of a link that end on the near plane or run along it; what touches it or is behind leaves ``outline``.

    ``outline`` (E,) holds the outline edges of all links; with ``detail``, the segments know their depth.
    """
    vertices = on_lines.vertices
    topology, lanes = vertices.topology, vertices.lanes
    edges = slice(topology.edge_start[link], topology.edge_start[link + 1])
    start, end = words_of(vertices.behind[link]).take(
        topology.edge_ends[:, edges] - topology.vertex_start[link], axis=0
    )
    at = np.flatnonzero(answers_of(start ^ end))
    own = np.flatnonzero(answers_of(outline[edges]).ravel().take(at))
    end_behind = answers_of(end).ravel().take(at)
    outline[edges] &= ~(start | end)
    edge, lane = (at >> shift_of(lanes)) + edges.start, at & (lanes - 1)

    ends = (topology.edge_ends.take(edge, axis=1) - topology.vertex_start[link]) * lanes + lane
    xy = _cut_points(vertices.homogeneous[link], ends)
    u, v = on_lines.grid.place(vertices.projection.pixels(xy))
    line = on_lines.grid.first_line(v)

    # What is before the plane of an outline edge.
    left = on_lines.segments(edge.take(own), lane.take(own), detail)
    place = end_behind.take(own).view(np.int8), np.arange(len(own))
    left.u[place], left.v[place], left.line[place] = u.take(own), v.take(own), line.take(own)
    if left.xy is not None:
        left.xy[:, *place] = xy.take(own, axis=1)
    if left.inverse_depth is not None:
        left.inverse_depth[place] = 1 / NEAR

    # A face's boundary goes behind the plane along one of its edges and comes back along another.
    second = np.flatnonzero(topology.weight.take(edge) == 2)
    faces = topology.edge_faces.take(edge, axis=1)
    faces = np.concatenate([faces[0], faces[1].take(second)])
    point = np.concatenate([np.arange(len(edge)), second])
    goes = np.concatenate([end_behind, end_behind.take(second) == topology.same_way.take(edge.take(second))])
    goes_at, comes_at = np.flatnonzero(goes), np.flatnonzero(~goes)
    key = (faces - topology.face_start[link]) * lanes + lane.take(point)
    comes = np.empty((topology.face_start[link + 1] - topology.face_start[link]) * lanes, dtype=np.intp)
    comes[key.take(comes_at)] = point.take(comes_at)
    ends = np.stack([point.take(goes_at), comes.take(key.take(goes_at))])
    along = Segments(
        lane.take(ends[0]),
        faces.take(goes_at),
        np.ones(len(goes_at), dtype=np.int8),
        u.take(ends),
        v.take(ends),
        line.take(ends),
        None if left.xy is None else xy.take(ends, axis=1),
        np.full(ends.shape, 1 / NEAR, dtype=np.float32) if detail else None,
    )
    return left.and_more(along)
