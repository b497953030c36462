"""Points on the silhouette's outline, and where they lie on the instrument.

A small motion of the instrument moves its outline, to first order, as it moves the points of the body that are on the
outline: the others slide along it. So the outline's points in three dimensions give the change of everything that is
summed over the silhouette, without drawing another one. Lines that cross the outline steeply measure it best: rows
where it is steep, columns where it is flat.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.camera import Camera
from dvrk_cmaes.silhouette.grid import LineGrid
from dvrk_cmaes.silhouette.outline_edges import OutlineEdges
from dvrk_cmaes.silhouette.spans import CLOSE, Spans, covered_spans

Float64 = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class OutlinePoints:
    """Points on the outlines of a population, by pose and link.

    pose : (N,) which of the poses, ascending. link : (N,), ascending for each pose. pixels : (N, 2). normals : (N, 2),
    pointing out of the silhouette, as long as the stretch of outline, px, that the point stands for. points : (N, 3)
    on the instrument, m, in the link's frame.
    """

    pose: NDArray[np.integer[Any]]
    link: NDArray[np.integer[Any]]
    pixels: Float64
    normals: Float64
    points: Float64

    @staticmethod
    def joined(groups: Sequence[OutlinePoints], parts: Sequence[slice]) -> OutlinePoints:
        """Join those of the parts that a population was divided into."""
        if len(groups) == 1:
            return groups[0]
        pose = np.concatenate([group.pose + part.start for group, part in zip(groups, parts, strict=True)])
        rest = [np.concatenate([getattr(g, name) for g in groups]) for name in ("link", "pixels", "normals", "points")]
        return OutlinePoints(pose, *rest)

    def of_each(self, poses: int) -> Iterator[OutlinePoints]:
        """Give the points of each of so many poses."""
        edges = np.searchsorted(self.pose, np.arange(poses + 1))
        for i in range(poses):
            part = slice(edges[i], edges[i + 1])
            yield OutlinePoints(
                self.pose[part], self.link[part], self.pixels[part], self.normals[part], self.points[part]
            )


@dataclass(frozen=True, eq=False)
class _Turns:
    """Places where the outline crosses lines, visibly and at an angle that says well where it is."""

    pose: NDArray[np.signedinteger[Any]]
    pixels: Float64
    normals: Float64
    face: NDArray[np.intp]
    depth: Float64

    @staticmethod
    def of(spans: Spans, grid: LineGrid, extent: int) -> _Turns:
        """Find them on all lines."""
        crossings = spans.crossings
        assert spans.turns is not None
        assert crossings.segment is not None
        n = grid.per_pixel
        start, end = spans.turns
        u, row = crossings.u, crossings.row
        # Neighbours too close to be told apart may be the wrong way round: what then seems to lie between is nothing.
        gap = (row[start[1:]] == row[end[:-1]]) & (u[start[1:]] - u[end[:-1]] < CLOSE)
        first, last = np.ones((2, len(start)), dtype=np.bool_)
        first[1:], last[:-1] = ~gap, ~gap
        start, end = start[first], end[last]
        wide = u[end] - u[start] >= CLOSE
        index = np.stack([start[wide], end[wide]], axis=1).ravel()
        begins = np.tile([1.0, -1.0], np.count_nonzero(wide))
        segment = crossings.segment[index]
        slope = crossings.slope[segment].astype(np.float64) * n  # px along for a px across
        seen = (u[index] > -0.5) & (u[index] < extent - 0.5) & ~crossings.segments.on_near_plane()[segment]
        steep = seen & (np.abs(slope) < 1 if grid.vertical else np.abs(slope) <= 1)
        index, begins, slope = index[steep], begins[steep], slope[steep]

        pose, line = np.divmod(row[index], grid.lines)
        segments = crossings.segments.select(segment[steep])
        share = np.clip((line - segments.v[0]) / (segments.v[1] - segments.v[0]), 0, 1)
        assert segments.inverse_depth is not None
        near, far = segments.inverse_depth
        pixels = np.stack([u[index].astype(np.float64), grid.line_to_v(line)], axis=1)
        normals = -begins[:, None] * np.stack([np.ones_like(slope), -slope], axis=1) / n
        if grid.vertical:
            pixels, normals = pixels[:, ::-1], normals[:, ::-1]
        return _Turns(pose, pixels, normals, segments.face, 1 / (near + share * (far - near)))


def outline_points(edges: OutlineEdges, camera: Camera, rows: Spans, grid: LineGrid) -> OutlinePoints:
    """Points on the visible outlines of a few poses, on the rows of ``grid`` and on a column a pixel.

    ``rows`` are the spans of ``grid``, in detail.
    """
    columns = LineGrid(camera.width, vertical=True)
    spans = covered_spans(edges, columns, camera.height, detail=True)
    parts = [
        _Turns.of(rows, grid, camera.width),
        _Turns.of(spans, columns, camera.height),
    ]
    pose = np.concatenate([part.pose for part in parts])
    link = edges.link_of(np.concatenate([part.face for part in parts]))
    order = (pose * edges.links + link).astype(np.uint16).argsort(kind="stable")
    pose, link = pose[order], link[order]
    pixels, normals = (np.concatenate([getattr(p, name) for p in parts])[order] for name in ("pixels", "normals"))
    depth = np.concatenate([part.depth for part in parts])[order]
    seen = np.c_[camera.normalise(pixels), np.ones(len(pixels))] * depth[:, None]
    to_camera = edges.camera_from_link[pose, link]
    points = np.einsum("nji,nj->ni", to_camera[:, :3, :3], seen - to_camera[:, :3, 3])
    return OutlinePoints(pose, link, pixels, normals, points)
