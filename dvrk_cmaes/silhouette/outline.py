"""Points on the outline of the silhouette, in the image and on the instrument's surface.

To first order, a small motion of the instrument moves its outline along the image normals by as much as it moves the
surface points that project onto the outline. The derivatives of sums over the silhouette therefore follow from the
three-dimensional points of the outline, without rendering further silhouettes. A point is located best on an image line
that crosses the outline at a large angle: rows are used where the outline is steep, columns where it is flat.
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
    """Points on the outlines of several poses, sorted by pose, then by link.

    pose : (N,) index of the pose. link : (N,) index of the link. pixels : (N, 2). normals : (N, 2), pointing out of the
    silhouette; their length is that of the piece of outline, px, that the point represents. points : (N, 3) on the
    instrument's surface, m, in the link's frame.
    """

    pose: NDArray[np.integer[Any]]
    link: NDArray[np.integer[Any]]
    pixels: Float64
    normals: Float64
    points: Float64

    @staticmethod
    def joined(groups: Sequence[OutlinePoints], parts: Sequence[slice]) -> OutlinePoints:
        """Concatenate the points of batches of poses; ``parts`` are the slices of the poses in each batch."""
        if len(groups) == 1:
            return groups[0]
        pose = np.concatenate([group.pose + part.start for group, part in zip(groups, parts, strict=True)])
        rest = [np.concatenate([getattr(g, name) for g in groups]) for name in ("link", "pixels", "normals", "points")]
        return OutlinePoints(pose, *rest)

    def of_each(self, poses: int) -> Iterator[OutlinePoints]:
        """Iterate over the points of each pose, for the given number of poses."""
        edges = np.searchsorted(self.pose, np.arange(poses + 1))
        for i in range(poses):
            part = slice(edges[i], edges[i + 1])
            yield OutlinePoints(
                self.pose[part], self.link[part], self.pixels[part], self.normals[part], self.points[part]
            )

    def every(self, stride: int) -> OutlinePoints:
        """Return every ``stride``-th point, which represents the pieces of outline of those beside it, too."""
        if stride == 1:
            return self
        part = slice(None, None, stride)
        normals = stride * self.normals[part]
        return OutlinePoints(self.pose[part], self.link[part], self.pixels[part], normals, self.points[part])


@dataclass(frozen=True, eq=False)
class _LinePoints:
    """Points where the visible outline crosses image lines at an angle of at least 45 degrees."""

    pose: NDArray[np.signedinteger[Any]]
    pixels: Float64
    normals: Float64
    face: NDArray[np.intp]
    depth: Float64

    @staticmethod
    def of(spans: Spans, grid: LineGrid, extent: int) -> _LinePoints:
        """Take the points from the ends of all spans."""
        crossings = spans.crossings
        assert spans.ends_at is not None
        assert crossings.segment is not None
        n = grid.per_pixel
        start, end = spans.ends_at
        u, row = crossings.u, crossings.row
        at_start, at_end = u.take(start, mode="clip"), u.take(end, mode="clip")
        # Crossings closer than CLOSE may be in the wrong order, so gaps and spans shorter than that are ignored.
        row_of_span = row.take(start, mode="clip")
        gap = (row_of_span[1:] == row_of_span[:-1]) & (at_start[1:] - at_end[:-1] < CLOSE)
        if gap.any():
            first, last = np.ones((2, len(start)), dtype=np.bool_)
            first[1:], last[:-1] = ~gap, ~gap
            start, end, at_start, at_end = start[first], end[last], at_start[first], at_end[last]
        wide = at_end - at_start >= CLOSE
        index = np.stack([start[wide], end[wide]], axis=1).ravel()
        begins = np.tile([1.0, -1.0], len(index) // 2)
        segment, along = crossings.segment.take(index, mode="clip"), u.take(index, mode="clip")
        slope = crossings.slope.take(segment, mode="clip").astype(np.float64) * n  # change of u in px per px of v
        steep = (np.abs(slope) < 1 if grid.vertical else np.abs(slope) <= 1) & (along > -0.5) & (along < extent - 0.5)
        steep &= ~crossings.segments.on_near_plane().take(segment, mode="clip")
        (kept,) = steep.nonzero()
        index, along = index.take(kept, mode="clip"), along.take(kept, mode="clip")
        begins, slope = begins.take(kept, mode="clip"), slope.take(kept, mode="clip")

        pose, line = np.divmod(row.take(index, mode="clip"), grid.lines)
        segments = crossings.segments.select(segment.take(kept, mode="clip"))
        share = np.clip((line - segments.v[0]) / (segments.v[1] - segments.v[0]), 0, 1)
        assert segments.inverse_depth is not None
        near, far = segments.inverse_depth
        pixels = np.stack([along.astype(np.float64), grid.line_to_v(line)], axis=1)
        normals = -begins[:, None] * np.stack([np.ones_like(slope), -slope], axis=1) / n
        if grid.vertical:
            pixels, normals = pixels[:, ::-1], normals[:, ::-1]
        return _LinePoints(pose, pixels, normals, segments.face, 1 / (near + share * (far - near)))


def outline_points(edges: OutlineEdges, camera: Camera, rows: Spans, grid: LineGrid) -> OutlinePoints:
    """Find points on the visible outlines of a batch of poses, on the lines of ``grid`` and on the pixel columns.

    ``rows`` are the spans on ``grid``, computed with ``detail``.
    """
    columns = LineGrid(camera.width, vertical=True)
    spans = covered_spans(edges, columns, camera.height, detail=True)
    parts = [
        _LinePoints.of(rows, grid, camera.width),
        _LinePoints.of(spans, columns, camera.height),
    ]
    pose = np.concatenate([part.pose for part in parts])
    link = edges.link_of(np.concatenate([part.face for part in parts]))
    order = (pose * edges.links + link).astype(np.uint16).argsort(kind="stable")
    pose, link = pose.take(order), link.take(order)
    pixels, normals, depth = (
        np.concatenate([getattr(part, name) for part in parts]).take(order, axis=0)
        for name in ("pixels", "normals", "depth")
    )
    seen = np.c_[camera.normalise(pixels), np.ones(len(pixels))] * depth[:, None]
    to_camera = edges.camera_from_link[pose, link]
    points = np.einsum("nji,nj->ni", to_camera[:, :3, :3], seen - to_camera[:, :3, 3])
    return OutlinePoints(pose, link, pixels, normals, points)
