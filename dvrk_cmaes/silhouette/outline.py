"""Points on the silhouette's outline, and where they lie on the instrument.

A small motion of the instrument moves its outline, to first order, as it moves the points of the body that are on the
outline: the others slide along it. So the outline's points in three dimensions give the change of everything that is
summed over the silhouette, without drawing another one. Lines that cross the outline steeply measure it best: rows
where it is steep, columns where it is flat.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.camera import Camera
from dvrk_cmaes.silhouette.crossings import Crossings, LineGrid, find_crossings
from dvrk_cmaes.silhouette.topology import MeshTopology

Float64 = NDArray[np.float64]

_FRACTION = np.float64(1 << 12)  # of a pixel, to which crossings are sorted


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
    link: NDArray[np.int64]
    points: Float64


def _visible_turns(crossings: Crossings, grid: LineGrid, extent: int, poses: int) -> tuple[NDArray[np.int64], Float64]:
    """Crossings (n,) between covered and uncovered, within the image, and +1 where the covered side begins, else -1.

    On a line along which a link is cut by the near plane, the changes do not sum to zero: what is missing lies beside
    the image, and the layer count begins with as much as makes it end at zero or above.
    """
    lines = grid.lines
    row = crossings.pose.astype(np.int64) * lines + crossings.line
    total = np.bincount(row, weights=crossings.change, minlength=poses * lines)
    at = np.clip(np.rint((crossings.u.astype(np.float64) + 1) * _FRACTION), 0, (extent + 1) * _FRACTION)
    at_bits = int((extent + 1) * _FRACTION).bit_length()
    index_bits = len(row).bit_length()
    if (poses * lines).bit_length() + at_bits + index_bits > 63:
        order = np.lexsort((at, row))
    else:
        key = (((row << at_bits) | at.astype(np.int64)) << index_bits) | np.arange(len(row))
        key.sort()
        order = key & ((1 << index_bits) - 1)
    row = row[order]
    begin = np.maximum(-total, 0) - (np.cumsum(total) - total)
    count = np.cumsum(crossings.change[order], dtype=np.int64)
    after = count + begin[row] > 0.5
    before = count - crossings.change[order] + begin[row] > 0.5
    u = crossings.u[order]
    seen = (after != before) & (u > -0.5) & (u < extent - 0.5) & ~crossings.inside[crossings.pose[order]]
    return order[seen], np.where(after[seen], 1.0, -1.0)


def outline_points(
    topology: MeshTopology, camera: Camera, camera_from_link: Float64, *, per_pixel: int = 1
) -> OutlinePoints:
    """Points on the visible outlines of up to eight poses (C, L, 4, 4), on ``per_pixel`` lines a pixel."""
    parts = []
    for vertical in (False, True):
        across, extent = (camera.width, camera.height) if vertical else (camera.height, camera.width)
        grid = LineGrid(across, per_pixel, vertical)
        crossings = find_crossings(topology, camera, grid, camera_from_link, detail=True)
        assert crossings.edge is not None
        assert crossings.slope is not None
        assert crossings.depth is not None
        index, begins = _visible_turns(crossings, grid, extent, len(camera_from_link))
        slope = crossings.slope[index].astype(np.float64) * per_pixel  # px along the line for a px across
        steep = np.abs(slope) < 1 if vertical else np.abs(slope) <= 1
        index, begins, slope = index[steep], begins[steep], slope[steep]
        along, away = crossings.u[index].astype(np.float64), grid.line_to_v(crossings.line[index])
        normal = -begins[:, None] * np.stack([np.ones_like(slope), -slope], axis=1) / per_pixel
        pixels = np.stack([along, away], axis=1)
        if vertical:
            pixels, normal = pixels[:, ::-1], normal[:, ::-1]
        parts.append((crossings.pose[index], pixels, normal, crossings.edge[index], crossings.depth[index]))
    pose, pixels, normal, edge, depth = (np.concatenate(columns) for columns in zip(*parts, strict=True))
    link = np.searchsorted(topology.edge_start, edge, side="right") - 1
    seen = np.c_[camera.normalise(pixels), np.ones(len(pixels))] * depth[:, None]
    to_camera = camera_from_link[pose, link]
    points = np.einsum("nji,nj->ni", to_camera[:, :3, :3], seen - to_camera[:, :3, 3])
    return OutlinePoints(pose, pixels, normal, link, points)
