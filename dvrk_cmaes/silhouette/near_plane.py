"""Clipping of a link at the near plane: the clipped outline edges, and the edges along which faces are cut.

The edges along the cut close the clipped mesh, so that the changes of the layer count still sum to zero on every line.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.silhouette.grid import Float32
from dvrk_cmaes.silhouette.pose_batches import Words, as_flags, as_words, index_shift
from dvrk_cmaes.silhouette.scenes import NEAR
from dvrk_cmaes.silhouette.segments import Segments
from dvrk_cmaes.silhouette.vertices import VerticesOnLines


def _cut_points(homogeneous: Float32, ends: NDArray[np.intp]) -> Float32:
    """Find where edges meet the near plane, (2, N) after the division by depth; ``ends`` (2, N) index the points."""
    # Ends are sorted so that an edge listed several times, for several pairs of faces, gives identical points.
    in_order = np.stack([np.minimum(*ends), np.maximum(*ends)])
    before, after = homogeneous.reshape(3, -1).take(in_order, axis=1).astype(np.float64).transpose(1, 0, 2)
    share = (NEAR - before[2]) / (after[2] - before[2])
    at: Float32 = ((before[:2] + share * (after[:2] - before[:2])) / NEAR).astype(np.float32)
    return at


def cut_link(on_lines: VerticesOnLines, link: int, outline: Words, detail: bool) -> Segments:
    """Return the segments of a link that end on the near plane or run along it.

    ``outline`` (E, words) holds the outline flags of the edges of all links; those of edges that reach behind the plane
    are cleared in place. The segments have their inverse depth if ``detail``.
    """
    vertices = on_lines.vertices
    topology, batch_size = vertices.topology, vertices.batch_size
    edges = slice(topology.edge_start[link], topology.edge_start[link + 1])
    start, end = as_words(vertices.behind[link]).take(
        topology.edge_ends[:, edges] - topology.vertex_start[link], axis=0
    )
    at = np.flatnonzero(as_flags(start ^ end))
    on_outline = np.flatnonzero(as_flags(outline[edges]).ravel().take(at))
    end_behind = as_flags(end).ravel().take(at)
    outline[edges] &= ~(start | end)
    edge, pose = (at >> index_shift(batch_size)) + edges.start, at & (batch_size - 1)

    ends = (topology.edge_ends.take(edge, axis=1) - topology.vertex_start[link]) * batch_size + pose
    xy = _cut_points(vertices.homogeneous[link], ends)
    u, v = on_lines.grid.place(vertices.projection.pixels(xy))
    line = on_lines.grid.first_line(v)

    # The parts of the outline edges in front of the plane.
    kept = edge.take(on_outline), pose.take(on_outline)
    clipped = on_lines.segments(*kept, on_lines.ends(*kept), detail)
    place = end_behind.take(on_outline).view(np.int8), np.arange(len(on_outline))
    clipped.u[place], clipped.v[place] = u.take(on_outline), v.take(on_outline)
    clipped.line[place] = line.take(on_outline)
    if clipped.xy is not None:
        clipped.xy[:, *place] = xy.take(on_outline, axis=1)
    if clipped.inverse_depth is not None:
        clipped.inverse_depth[place] = 1 / NEAR

    # The boundary of a cut face passes behind the plane along one of its edges and returns along another.
    second = np.flatnonzero(topology.weight.take(edge) == 2)
    faces = topology.edge_faces.take(edge, axis=1)
    faces = np.concatenate([faces[0], faces[1].take(second)])
    point = np.concatenate([np.arange(len(edge)), second])
    leaves = np.concatenate([end_behind, end_behind.take(second) == topology.same_direction.take(edge.take(second))])
    leaves_at, returns_at = np.flatnonzero(leaves), np.flatnonzero(~leaves)
    key = (faces - topology.face_start[link]) * batch_size + pose.take(point)
    returns = np.empty((topology.face_start[link + 1] - topology.face_start[link]) * batch_size, dtype=np.intp)
    returns[key.take(returns_at)] = point.take(returns_at)
    ends = np.stack([point.take(leaves_at), returns.take(key.take(leaves_at))])
    along_plane = Segments(
        pose.take(ends[0]),
        faces.take(leaves_at),
        np.ones(len(leaves_at), dtype=np.int8),
        u.take(ends),
        v.take(ends),
        line.take(ends),
        None if clipped.xy is None else xy.take(ends, axis=1),
        np.full(ends.shape, 1 / NEAR, dtype=np.float32) if detail else None,
    )
    return clipped.concatenated(along_plane)
