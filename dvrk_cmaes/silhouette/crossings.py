"""Where image lines cross the outline edges of a population of poses.

From poses to crossings: which faces look at the eye, which edges are outline, their ends in the image, the lines
between these. Poses go down eight at a time, so that one 64-bit word holds a face's answer for all of them.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.camera import Camera
from dvrk_cmaes.silhouette.scenes import NEAR
from dvrk_cmaes.silhouette.topology import MeshTopology

LANES = 8
"""Poses handled together."""

_BEND = 0.0005  # pixels by which a lens may bend a segment that is drawn straight
_ROUNDING = 1e-4  # m, added to the distance at which the near plane may cut a link in view

Float32 = NDArray[np.float32]


@dataclass(frozen=True)
class LineGrid:
    """Lines through an image: ``per_pixel`` evenly spaced ones in each of ``pixels`` rows, or columns if ``vertical``.

    Along vertical lines, u and v change places everywhere: positions are pixel rows and lines count columns.
    """

    pixels: int
    per_pixel: int = 1
    vertical: bool = False

    @property
    def lines(self) -> int:
        """Number of lines."""
        return self.pixels * self.per_pixel

    def line_to_v(self, line: NDArray[np.int32] | NDArray[np.int64]) -> NDArray[np.float64]:
        """Pixel row coordinate v of lines, column coordinate u of vertical ones."""
        return np.asarray((line + 0.5) / self.per_pixel - 0.5)


@dataclass(frozen=True, eq=False)
class Crossings:
    """Crossings of lines with outline edges; poses are in order, lines and positions are not."""

    pose: NDArray[np.int32]
    line: NDArray[np.int32]
    u: Float32
    """Pixel column coordinate."""
    change: NDArray[np.int8]
    """By how much the layer count changes from left to right."""
    link: NDArray[np.intp] | None
    """Link of each crossing; None where the near plane cuts nothing, so that no one asks."""
    inside: NDArray[np.bool_]
    """(C,) whether the eye may be inside a link of the pose."""
    edge: NDArray[np.int64] | None = None
    """Outline edge of each crossing, where asked for."""
    slope: Float32 | None = None
    """Change of the position from a line to the next, where asked for."""
    depth: Float32 | None = None
    """Depth z of the edge at the crossing, m, where asked for."""

    def select(self, keep: NDArray[np.bool_]) -> Crossings:
        """Keep some of the crossings."""
        link = None if self.link is None else self.link[keep]
        return Crossings(self.pose[keep], self.line[keep], self.u[keep], self.change[keep], link, self.inside)

    def unsettled_lines(self, poses: int, lines: int) -> NDArray[np.bool_] | None:
        """(C, lines) where the layer count cannot be trusted; None where it can everywhere."""
        unsettled = np.repeat(self.inside[:, None], lines, axis=1)
        if self.link is not None:
            # Link by link: what is missing of one can be what another has too much of.
            links = int(self.link.max(initial=0)) + 1
            place = (self.pose * links + self.link) * lines + self.line
            total = np.bincount(place, weights=self.change, minlength=poses * links * lines)
            unsettled |= (total.reshape(poses, links, lines) != 0).any(axis=1)
        return unsettled if unsettled.any() else None


@lru_cache(maxsize=64)
def _in_view(camera: Camera) -> float:
    """Distance from the eye, m, within which the near plane can be in view, and rounding."""
    u, v = np.meshgrid(np.linspace(-0.5, camera.width - 0.5, 9), np.linspace(-0.5, camera.height - 0.5, 9))
    widest = np.linalg.norm(camera.normalise(np.stack([u, v], axis=-1)), axis=-1).max()
    return float(NEAR * np.hypot(1, widest) + _ROUNDING)


@lru_cache(maxsize=64)
def _straight_length(camera: Camera) -> float:
    """Length in pixels up to which the lens bends a segment by less than ``_BEND`` wherever it is in the image."""
    u, v = np.meshgrid(np.linspace(-0.5, camera.width - 0.5, 17), np.linspace(-0.5, camera.height - 0.5, 17))
    middle = camera.normalise(np.stack([u, v], axis=-1))
    focal = np.array([camera.fx, camera.fy])
    turn = np.arange(8)[:, None, None, None] * np.pi / 8
    half = 2.0 * np.concatenate([np.cos(turn), np.sin(turn)], axis=-1) / focal
    start, end = camera.distort(middle - half) * focal, camera.distort(middle + half) * focal
    way, off = end - start, camera.distort(middle) * focal - (start + end) / 2
    bend = np.abs(way[..., 0] * off[..., 1] - way[..., 1] * off[..., 0]) / np.linalg.norm(way, axis=-1)
    return float(4.0 * np.sqrt(_BEND / max(bend.max(), 1e-9)))


def _outline_edges(topology: MeshTopology, eye: NDArray[np.float64]) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Which faces look at the eye, (F, LANES), and which edges are outline, (C, E); eye: (C, L, 3) in the links."""
    poses = len(eye)
    looks = np.zeros((len(topology.planes), LANES), dtype=np.bool_)
    homogeneous = np.concatenate([eye, np.ones((*eye.shape[:2], 1))], axis=2).astype(np.float32)
    for link in range(topology.links):
        faces = slice(topology.face_start[link], topology.face_start[link + 1])
        np.greater(topology.planes[faces] @ homogeneous[:, link].T, 0, out=looks[faces, :poses])
    word = looks.view(np.uint64)[:, 0]
    outline = word[topology.face_left]
    outline ^= word[topology.face_right]
    outline ^= topology.flip
    return looks, np.ascontiguousarray(outline.view(np.bool_).reshape(-1, LANES)[:, :poses].T)


@dataclass(frozen=True, eq=False)
class _Points:
    """Points of all poses in the image, flat: the vertices, pose after pose, then what clipping has added."""

    u: Float32
    v: Float32
    """Line number, a real number."""
    line: NDArray[np.int32]
    """The first line at or below the point, within the image."""
    xy: Float32 | None = None
    """(N, 2) undistorted normalised coordinates, where lines bend."""
    inverse_depth: Float32 | None = None
    """1 / z, where asked for."""

    def and_more(self, more: _Points) -> _Points:
        """Append points."""
        xy = None if self.xy is None or more.xy is None else np.concatenate([self.xy, more.xy])
        u, v = np.concatenate([self.u, more.u]), np.concatenate([self.v, more.v])
        inverse = None
        if self.inverse_depth is not None and more.inverse_depth is not None:
            inverse = np.concatenate([self.inverse_depth, more.inverse_depth])
        return _Points(u, v, np.concatenate([self.line, more.line]), xy, inverse)


@dataclass(frozen=True, eq=False)
class _Segments:
    """Outline edges, or parts of them, between two of the points; in order of their poses."""

    pose: NDArray[np.int32]
    edge: NDArray[np.int64]
    start: NDArray[np.int64]
    end: NDArray[np.int64]

    def select(self, which: NDArray[np.intp] | NDArray[np.bool_]) -> _Segments:
        """Keep some of the segments."""
        return _Segments(self.pose[which], self.edge[which], self.start[which], self.end[which])


class _Projection:
    """From homogeneous coordinates to points in the image, in one camera and line grid."""

    def __init__(self, camera: Camera, grid: LineGrid) -> None:
        n = grid.per_pixel
        self.camera = camera
        self.lines = grid.lines
        if grid.vertical:
            rows = [[0, camera.fy, camera.cy], [camera.fx * n, 0, (camera.cx + 0.5) * n - 0.5]]
        else:
            rows = [[camera.fx, 0, camera.cx], [0, camera.fy * n, (camera.cy + 0.5) * n - 0.5]]
        self.image_from_camera = np.array([*rows, [0, 0, 1]], dtype=np.float64)

    @property
    def matrix(self) -> NDArray[np.float64]:
        """(3, 3): what the camera's frame is multiplied with before the division by depth."""
        return self.image_from_camera if self.camera.is_pinhole else np.eye(3)

    def points(self, x: Float32, y: Float32, inverse_depth: Float32 | None = None) -> _Points:
        """Image points from coordinates after the division by depth, each (N,)."""
        xy = None
        if not self.camera.is_pinhole:
            xy = np.stack([x, y], axis=-1)
            distorted = self.camera.distort(xy)
            m = self.image_from_camera.astype(np.float32)
            x, y = (distorted @ m[:2, :2].T + m[:2, 2]).T
        first = np.ceil(y)
        np.clip(first, 0, self.lines, out=first)
        return _Points(x, y, first.astype(np.int32), xy, inverse_depth)


def _project(
    topology: MeshTopology, projection: _Projection, camera_from_link: NDArray[np.float64]
) -> tuple[Float32, NDArray[np.bool_]]:
    """Vertices of all poses as homogeneous image coordinates, (C, 3, V), and (C, L) which links the near plane cuts."""
    matrix = (projection.matrix @ camera_from_link[:, :, :3]).astype(np.float32)
    points = np.empty((len(matrix), 3, len(topology.vertices)), dtype=np.float32)
    for link in range(topology.links):
        part = slice(topology.vertex_start[link], topology.vertex_start[link + 1])
        np.matmul(matrix[:, link], topology.vertices[part].T, out=points[:, :, part])
    return points, np.minimum.reduceat(points[:, 2], topology.vertex_start[:-1], axis=1) < NEAR


def _clip_near(
    homogeneous: Float32, projection: _Projection, points: _Points, segments: _Segments
) -> tuple[_Points, _Segments]:
    """Cut segments at the near plane and drop those behind it."""
    depth = homogeneous[:, 2].ravel()
    start_behind, end_behind = depth[segments.start] < NEAR, depth[segments.end] < NEAR
    vertices = homogeneous.shape[2]
    cut = np.flatnonzero(start_behind != end_behind)
    pose = segments.pose[cut]
    before = homogeneous[pose, :, segments.start[cut] - pose * vertices].astype(np.float64)
    after = homogeneous[pose, :, segments.end[cut] - pose * vertices].astype(np.float64)
    share = (NEAR - before[:, 2]) / (after[:, 2] - before[:, 2])
    at = ((before + share[:, None] * (after - before)) / NEAR).astype(np.float32)
    added = np.arange(len(cut)) + len(points.u)
    start, end = segments.start.copy(), segments.end.copy()
    start[cut] = np.where(start_behind[cut], added, start[cut])
    end[cut] = np.where(end_behind[cut], added, end[cut])
    moved = _Segments(segments.pose, segments.edge, start, end)
    inverse_depth = np.full(len(cut), 1 / NEAR, dtype=np.float32)
    more = projection.points(at[:, 0], at[:, 1], inverse_depth)
    return points.and_more(more), moved.select(~(start_behind & end_behind))


def _bend(projection: _Projection, points: _Points, segments: _Segments) -> tuple[_Points, _Segments]:
    """Divide segments that a lens may bend visibly into short ones, inside the image's surroundings."""
    assert points.xy is not None
    start, end = points.xy[segments.start].astype(np.float64), points.xy[segments.end].astype(np.float64)
    focal = np.array([projection.camera.fx, projection.camera.fy])
    straight = _straight_length(projection.camera)
    long = np.flatnonzero(np.linalg.norm((end - start) * focal, axis=1) > straight)
    start, end = start[long], end[long]
    # The part of each within the square around the circle where the lens model is used as written.
    reach = projection.camera.lens_radius
    way = end - start
    safe = np.where(np.abs(way) < 1e-12, 1e-12, way)
    t = np.sort(np.stack([(-reach - start) / safe, (reach - start) / safe]), axis=0)
    enter, leave = np.clip(t[0].max(axis=1), 0, 1), np.clip(t[1].min(axis=1), 0, 1)
    leave = np.maximum(leave, enter)
    pieces = np.ceil(np.linalg.norm(way * focal, axis=1) * (leave - enter) / straight).astype(np.int64)
    # Inner corners of segment i: at enter, the divisions, at leave; pieces + 1 of them.
    corners = pieces + 1
    owner = np.repeat(np.arange(len(long)), corners)
    offset = np.cumsum(corners) - corners
    rank = np.arange(len(owner)) - offset[owner]
    share = enter[owner] + (leave - enter)[owner] * rank / np.maximum(pieces[owner], 1)
    at = (start[owner] + share[:, None] * way[owner]).astype(np.float32)
    inverse = points.inverse_depth
    if inverse is not None:  # linear along a straight line in the image
        ends = inverse[segments.start[long]][owner], inverse[segments.end[long]][owner]
        inverse = (ends[0] + share * (ends[1] - ends[0])).astype(np.float32)
    added = np.arange(len(owner)) + len(points.u)
    # Chain: start, corners, end; corners + 1 parts.
    parts = np.ones(len(segments.pose), dtype=np.int64)
    parts[long] += corners
    which = np.repeat(np.arange(len(parts)), parts)
    last = np.cumsum(parts) - 1
    new_start, new_end = segments.start[which], segments.end[which]
    first_of = last - parts + 1
    corner_slot = first_of[long][owner] + rank
    new_end[corner_slot] = added
    new_start[corner_slot + 1] = added
    return (
        points.and_more(projection.points(at[:, 0], at[:, 1], inverse)),
        _Segments(segments.pose[which], segments.edge[which], new_start, new_end),
    )


def find_crossings(
    topology: MeshTopology,
    camera: Camera,
    grid: LineGrid,
    camera_from_link: NDArray[np.float64],
    *,
    detail: bool = False,
) -> Crossings:
    """Crossings of all lines with the outline edges of up to ``LANES`` poses, (C, L, 4, 4).

    With ``detail``, also which edge each crossing is on, how steep it is and how far away.
    """
    poses = len(camera_from_link)
    eye = -np.einsum("clji,clj->cli", camera_from_link[..., :3, :3], camera_from_link[..., :3, 3])
    looks, outline = _outline_edges(topology, eye)
    margin = _in_view(camera)
    inside = ((eye > topology.boxes[:, 0] - margin) & (eye < topology.boxes[:, 1] + margin)).all(axis=2).any(axis=1)

    projection = _Projection(camera, grid)
    homogeneous, cut = _project(topology, projection, camera_from_link)
    depth = homogeneous[:, 2]
    if cut.any():
        depth = np.where(depth < NEAR, np.float32(1), depth)
    x: Float32 = homogeneous[:, 0] / depth
    y: Float32 = homogeneous[:, 1] / depth
    inverse_depth = np.asarray(1 / depth, dtype=np.float32).ravel() if detail else None
    points = projection.points(x.ravel(), y.ravel(), inverse_depth)

    pose = np.repeat(np.arange(poses, dtype=np.int32), outline.sum(axis=1))
    edge = np.flatnonzero(outline) - pose * np.int64(outline.shape[1])
    vertex = pose * np.int64(homogeneous.shape[2])
    segments = _Segments(pose, edge, topology.edge_from[edge] + vertex, topology.edge_to[edge] + vertex)
    if cut.any():
        points, segments = _clip_near(homogeneous, projection, points, segments)
    if not camera.is_pinhole:
        points, segments = _bend(projection, points, segments)

    segments = segments.select(np.flatnonzero(points.line[segments.start] != points.line[segments.end]))
    line_a, line_b = points.line[segments.start], points.line[segments.end]
    ua, va = points.u[segments.start], points.v[segments.start]
    ub, vb = points.u[segments.end], points.v[segments.end]
    front = looks.ravel()[topology.face_left[segments.edge] * np.int64(LANES) + segments.pose]
    weight = topology.weight[segments.edge]
    # Rows and columns changing places turns the image over, and left and right of an edge with it.
    down = line_b > line_a if not grid.vertical else line_b < line_a
    change = np.where(down == front, weight, -weight)
    count = np.abs(line_b - line_a)
    first = np.minimum(line_a, line_b)
    slope = (ub - ua) / (vb - va)
    # Measured from the end that is nearer to the first line: the other may be very far outside the image.
    from_start = np.abs(va - first) < np.abs(vb - first)
    u_first = np.where(from_start, ua + (first - va) * slope, ub + (first - vb) * slope)

    segment = np.repeat(np.arange(len(count)), count)
    step = (np.arange(len(segment)) - np.repeat(np.cumsum(count) - count, count)).astype(np.int32)
    edges: NDArray[np.int64] | None = None
    slopes: Float32 | None = None
    depths: Float32 | None = None
    if points.inverse_depth is not None:
        share = ((first - va) / (vb - va))[segment] + step * (1 / (vb - va))[segment]
        start, end = points.inverse_depth[segments.start][segment], points.inverse_depth[segments.end][segment]
        depths = (1 / (start + np.clip(share, 0, 1) * (end - start))).astype(np.float32)
        edges, slopes = segments.edge[segment], slope[segment].astype(np.float32)
    return Crossings(
        pose=segments.pose[segment],
        line=first[segment] + step,
        u=(u_first[segment] + step * slope[segment]).astype(np.float32),
        change=change[segment],
        link=(np.searchsorted(topology.edge_start, segments.edge, side="right") - 1)[segment] if cut.any() else None,
        inside=inside,
        edge=edges,
        slope=slopes,
        depth=depths,
    )
