"""Points on the silhouette's outline, and where they lie on the instrument.

A small motion of the instrument moves its outline, to first order, as it moves the points of the body that are on the
outline: the others slide along it. So the outline's points in three dimensions give the change of everything that is
summed over the silhouette, without drawing another one. Lines that cross the outline steeply measure it best: rows
where it is steep, columns where it is flat.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.camera import Camera
from dvrk_cmaes.silhouette.crossings import NO_CHANGE, Crossings, find_crossings
from dvrk_cmaes.silhouette.grid import LineGrid
from dvrk_cmaes.silhouette.ordering import ordered
from dvrk_cmaes.silhouette.spans import SORTED_BITS
from dvrk_cmaes.silhouette.topology import MeshTopology

Float64 = NDArray[np.float64]

_CLOSE = 1 / (1 << SORTED_BITS)  # px


@dataclass(frozen=True, eq=False)
class OutlinePoints:
    """Points on the outlines of a population.

    pose : (N,) which of the poses. pixels : (N, 2). normals : (N, 2), pointing out of the silhouette, as long as the
    stretch of outline, px, that the point stands for. link : (N,), points : (N, 3) on the instrument, m, in the
    link's frame.
    """

    pose: NDArray[np.int32]
    pixels: Float64
    normals: Float64
    link: NDArray[np.integer[Any]]
    points: Float64


def _visible_turns(
    crossings: Crossings, grid: LineGrid, extent: int, poses: int
) -> tuple[NDArray[np.signedinteger[Any]], Float64]:
    """Crossings (n,) between covered and uncovered, within the image, and +1 where the covered side begins, else -1."""
    position = np.clip((crossings.u + 1) * np.float32(1 << SORTED_BITS), 0, (extent + 1) << SORTED_BITS)
    place = np.arange(len(position), dtype=np.int32)
    positions = ((extent + 1) << SORTED_BITS) + 1
    _, order = ordered(crossings.row, position.astype(np.int32), place, poses * grid.lines, positions)
    covered = np.cumsum(crossings.code[order] - NO_CHANGE, dtype=np.int32) > 0
    start, end = order[np.flatnonzero(np.diff(covered, prepend=False))].reshape(-1, 2).T  # of each span
    u, row = crossings.u, crossings.row
    # Neighbours too close to be told apart may be the wrong way round: what then seems to lie between them is nothing.
    gap = (row[start[1:]] == row[end[:-1]]) & (u[start[1:]] - u[end[:-1]] < _CLOSE)
    first, last = np.ones((2, len(start)), dtype=np.bool_)
    first[1:], last[:-1] = ~gap, ~gap
    start, end = start[first], end[last]
    wide = u[end] - u[start] >= _CLOSE
    turns = np.stack([start[wide], end[wide]], axis=1).ravel()
    begins = np.tile([1.0, -1.0], np.count_nonzero(wide))
    seen = (u[turns] > -0.5) & (u[turns] < extent - 0.5)
    return turns[seen], begins[seen]


def outline_points(
    topology: MeshTopology, camera: Camera, camera_from_link: Float64, *, per_pixel: int = 1
) -> OutlinePoints:
    """Points on the visible outlines of a few poses (C, L, 4, 4), on ``per_pixel`` lines a pixel."""
    parts = []
    for vertical in (False, True):
        across, extent = (camera.width, camera.height) if vertical else (camera.height, camera.width)
        grid = LineGrid(across, per_pixel, vertical)
        crossings = find_crossings(topology, camera, grid, camera_from_link, detail=True)
        assert crossings.segment is not None
        index, begins = _visible_turns(crossings, grid, extent, len(camera_from_link))
        slope = crossings.slope[crossings.segment[index]].astype(np.float64) * per_pixel  # px along for a px across
        on_instrument = ~crossings.segments.on_near_plane()[crossings.segment[index]]
        steep = (np.abs(slope) < 1 if vertical else np.abs(slope) <= 1) & on_instrument
        index, begins, slope = index[steep], begins[steep], slope[steep]
        pose, line = np.divmod(crossings.row[index], grid.lines)
        segments = crossings.segments.select(crossings.segment[index])
        along, away = crossings.u[index].astype(np.float64), grid.line_to_v(line)
        share = np.clip((line - segments.v[0]) / (segments.v[1] - segments.v[0]), 0, 1)
        assert segments.inverse_depth is not None
        near, far = segments.inverse_depth
        depth = 1 / (near + share * (far - near))
        normal = -begins[:, None] * np.stack([np.ones_like(slope), -slope], axis=1) / per_pixel
        pixels = np.stack([along, away], axis=1)
        if vertical:
            pixels, normal = pixels[:, ::-1], normal[:, ::-1]
        parts.append((pose, pixels, normal, segments.face, depth))
    pose, pixels, normal, face, depth = (np.concatenate(columns) for columns in zip(*parts, strict=True))
    link = np.searchsorted(topology.face_start, face, side="right") - 1
    seen = np.c_[camera.normalise(pixels), np.ones(len(pixels))] * depth[:, None]
    to_camera = camera_from_link[pose, link]
    points = np.einsum("nji,nj->ni", to_camera[:, :3, :3], seen - to_camera[:, :3, 3])
    return OutlinePoints(pose, pixels, normal, link, points)
