"""Silhouettes of whole populations of poses: loss sums, masks to the pixel, antialiased coverage.

Poses in, sums and images out. Poses are handled in the same groups whatever the number of threads, so results do not
depend on it to the last bit.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cache
from threading import Lock
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.camera import Camera
from dvrk_cmaes.instrument import Instrument
from dvrk_cmaes.silhouette.decimate import lightened
from dvrk_cmaes.silhouette.grid import LineGrid
from dvrk_cmaes.silhouette.outline import OutlinePoints, outline_points
from dvrk_cmaes.silhouette.outline_edges import OutlineEdges
from dvrk_cmaes.silhouette.pose_batches import groups_of
from dvrk_cmaes.silhouette.scenes import NEAR, LinkScenes
from dvrk_cmaes.silhouette.spans import Spans, covered_spans
from dvrk_cmaes.silhouette.topology import MeshTopology, build_topology

T = TypeVar("T")


@dataclass(frozen=True, eq=False)
class Body:
    """An instrument prepared for rendering: its outline topology and its Embree scenes. Share it between renderers."""

    instrument: Instrument
    topology: MeshTopology
    scenes: LinkScenes
    error_m: float = 0.0
    """How far its surface may be from the instrument's, m."""

    @staticmethod
    def prepare(instrument: Instrument) -> Body:
        """Pair the edges and build the scenes of an instrument."""
        return Body(instrument, build_topology(instrument), LinkScenes(instrument))

    def lightened(self, cell: float) -> Body:
        """Return a body of fewer faces for coarse images, its details smaller than ``cell`` m left out."""
        instrument, error = lightened(self.instrument, cell)
        return Body(instrument, build_topology(instrument), LinkScenes(instrument), self.error_m + error)

    def camera_from_links(
        self, camera_from_root: NDArray[np.float64], joints: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Poses (C, 4, 4) of the root and joints (C, J) to poses of all links, (C, L, 4, 4)."""
        return np.asarray(camera_from_root[:, None] @ self.instrument.forward(joints))


@dataclass(frozen=True, eq=False)
class PixelSums:
    """Images whose sums over a silhouette are wanted, as prefix sums along the rows.

    ``table`` is (H, W + 1, K or more): the sums of ``count`` = K images from the left border to each pixel's left side.
    """

    table: NDArray[np.float32]
    count: int

    @staticmethod
    def of(images: NDArray[np.floating], weight: NDArray[np.floating] | None = None) -> PixelSums:
        """Prepare images (K, H, W), each multiplied by a weight (H, W)."""
        weighted = np.asarray(images if weight is None else images * weight, dtype=np.float64)
        count, height, width = weighted.shape
        # NumPy gathers rows of 4, 8, 16, .. bytes far faster than others.
        padded = 1 << (count - 1).bit_length()
        table = np.zeros((height, width + 1, padded), dtype=np.float32)
        table[:, 1:, :count] = np.moveaxis(weighted.cumsum(axis=2), 0, -1)
        return PixelSums(table, count)


@cache
def _pool(threads: int) -> ThreadPoolExecutor:
    """Threads that all renderers share: starting some for every population would cost more than they save."""
    return ThreadPoolExecutor(threads, thread_name_prefix="silhouettes")


@cache
def _keep_freed_memory() -> None:
    """Have the C library keep the memory of temporary arrays.

    glibc hands freed memory back to the system beyond twice the largest block that has been freed so far (at most
    32 MB), and asking for it anew, page by page, can take as long as all of the rendering. Elsewhere this is nothing.
    """
    np.empty(31 << 20, dtype=np.uint8)


class Renderer:
    """Silhouettes of one instrument in one camera; safe to use from several threads."""

    def __init__(self, body: Body, camera: Camera, *, threads: int = 2) -> None:
        self.body = body
        self.camera = camera
        self.threads = threads
        self.rays = 0
        """Pixels traced so far: ``trace`` alone needs rays."""
        self.poses = 0
        """Poses rendered so far."""
        self._counting = Lock()
        _keep_freed_memory()

    def at(self, width: int, height: int) -> Renderer:
        """Return a renderer of the same body in the same camera at another image size."""
        return Renderer(self.body, self.camera.scaled(width, height), threads=self.threads)

    def _each_group(
        self,
        camera_from_root: NDArray[np.float64],
        joints: NDArray[np.float64],
        use: Callable[[OutlineEdges], T],
    ) -> list[T]:
        """Apply ``use`` to the outline edges of each group of poses, in threads."""
        links = self.body.camera_from_links(camera_from_root, joints)
        groups = [links[group] for group in groups_of(len(links))]

        def work(group: NDArray[np.float64]) -> T:
            return use(OutlineEdges(self.body.topology, self.camera, group))

        if self.threads == 1 or len(groups) == 1:
            done = [work(group) for group in groups]
        else:
            done = list(_pool(self.threads).map(work, groups))
        with self._counting:
            self.poses += len(links)
        return done

    def sums(
        self,
        camera_from_root: NDArray[np.float64],
        joints: NDArray[np.float64],
        images: PixelSums,
        *,
        lines_per_pixel: int = 1,
        to_pixel: bool = False,
    ) -> NDArray[np.float64]:
        """Sum K images over the silhouettes of C poses, giving (C, K), without making any image.

        With ``to_pixel``, over the pixels whose centres are covered; otherwise over the real outline, which makes the
        sums continuous in the pose.
        """
        width, grid = self.camera.width, LineGrid(self.camera.height, lines_per_pixel)
        flat = images.table.reshape(-1, images.table.shape[2])

        def upto(row: NDArray[np.int64], at: NDArray[np.float32]) -> NDArray[np.float32]:
            whole = at.astype(np.int32)
            index = row * (width + 1) + whole
            values = flat.take(index, axis=0, mode="clip")
            if not to_pixel:
                step = flat.take(index + 1, axis=0, mode="clip")
                step -= values
                step *= (at - whole.astype(np.float32))[:, None]
                values += step
            return values

        def add(edges: OutlineEdges) -> NDArray[np.float64]:
            spans = covered_spans(edges, grid, width, to_pixel=to_pixel)
            pose = spans.row // grid.lines
            row = spans.row - pose * grid.lines
            if lines_per_pixel > 1:
                row //= lines_per_pixel
            values = upto(row, spans.end)
            values -= upto(row, spans.start)
            columns = values.T[: images.count]
            return np.stack([np.bincount(pose, weights=column, minlength=edges.poses) for column in columns], axis=1)

        return np.concatenate(self._each_group(camera_from_root, joints, add)) / lines_per_pixel

    def coverage(
        self, camera_from_root: NDArray[np.float64], joints: NDArray[np.float64], *, lines_per_pixel: int = 4
    ) -> NDArray[np.float32]:
        """Antialiased silhouettes of C poses: the covered share of each pixel, (C, H, W)."""
        grid = LineGrid(self.camera.height, lines_per_pixel)

        def draw(edges: OutlineEdges) -> NDArray[np.float32]:
            return self._covered_shares(covered_spans(edges, grid, self.camera.width), edges.poses, lines_per_pixel)

        return np.concatenate(self._each_group(camera_from_root, joints, draw))

    def _covered_shares(self, spans: Spans, poses: int, lines_per_pixel: int) -> NDArray[np.float32]:
        """Covered share of each pixel, (C, H, W)."""
        height, width = self.camera.height, self.camera.width
        row = spans.row // lines_per_pixel if lines_per_pixel > 1 else spans.row
        at = np.concatenate([spans.start, spans.end])
        whole = at.astype(np.int32)
        later = at - whole.astype(np.float32)
        later[len(row) :] *= -1
        now = np.repeat(np.array([1, -1], dtype=np.float32), len(row)) - later
        index = np.tile(row * (width + 2), 2) + whole
        change = np.bincount(
            np.concatenate([index, index + 1]),
            weights=np.concatenate([now, later]),
            minlength=poses * height * (width + 2),
        )
        table = change.astype(np.float32).reshape(poses * height, width + 2).cumsum(axis=1)[:, :width]
        return table.reshape(poses, height, width) * np.float32(1 / lines_per_pixel)

    def outlines(self, camera_from_root: NDArray[np.float64], joints: NDArray[np.float64]) -> OutlinePoints:
        """Points on the outlines of C poses, on a line a pixel, and where they lie on the instrument."""
        grid = LineGrid(self.camera.height)

        def find(edges: OutlineEdges) -> OutlinePoints:
            rows = covered_spans(edges, grid, self.camera.width, detail=True)
            return outline_points(edges, self.camera, rows, grid)

        groups = self._each_group(camera_from_root, joints, find)
        return OutlinePoints.joined(groups, groups_of(len(camera_from_root)))

    def coverage_and_outlines(
        self, camera_from_root: NDArray[np.float64], joints: NDArray[np.float64], *, lines_per_pixel: int = 2
    ) -> tuple[NDArray[np.float32], OutlinePoints]:
        """Both at little more than the cost of one of them; the outlines' points are on all of the coverage's rows."""
        grid = LineGrid(self.camera.height, lines_per_pixel)

        def both(edges: OutlineEdges) -> tuple[NDArray[np.float32], OutlinePoints]:
            rows = covered_spans(edges, grid, self.camera.width, detail=True)
            points = outline_points(edges, self.camera, rows, grid)
            return self._covered_shares(rows, edges.poses, lines_per_pixel), points

        coverage, points = zip(*self._each_group(camera_from_root, joints, both), strict=True)
        return np.concatenate(coverage), OutlinePoints.joined(points, groups_of(len(camera_from_root)))

    def masks(self, camera_from_root: NDArray[np.float64], joints: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Silhouettes to the pixel of C poses: whether each pixel's centre is covered, (C, H, W)."""
        height, width = self.camera.height, self.camera.width
        grid = LineGrid(height)

        def draw(edges: OutlineEdges) -> NDArray[np.bool_]:
            spans, poses = covered_spans(edges, grid, width, to_pixel=True), edges.poses
            begin = spans.row * (width + 1)
            index = np.concatenate([begin + spans.start.astype(np.int32), begin + spans.end.astype(np.int32)])
            sign = np.repeat([1.0, -1.0], len(begin))
            change = np.bincount(index, weights=sign, minlength=poses * height * (width + 1))
            return np.asarray(change.reshape(poses, height, width + 1).cumsum(axis=2)[:, :, :width] > 0.5)

        return np.concatenate(self._each_group(camera_from_root, joints, draw))

    def trace(self, camera_from_root: NDArray[np.float64], joints: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Trace one ray through every pixel's centre, with nothing clever: the reference for ``masks``, (C, H, W)."""
        height, width = self.camera.height, self.camera.width
        v, u = np.mgrid[:height, :width]
        pixels = np.stack([u.ravel(), v.ravel()], axis=1).astype(np.float64)
        directions = np.c_[self.camera.normalise(pixels), np.ones(len(pixels))]
        links = self.body.camera_from_links(camera_from_root, joints)
        pose = np.zeros(len(pixels), dtype=np.intp)
        found = np.empty((len(links), height, width), dtype=np.bool_)
        for one, image in zip(links, found, strict=True):
            image[:] = self.body.scenes.covered(one[None], pose, directions).reshape(height, width)
        with self._counting:
            self.rays += found.size
        return found


__all__ = ["NEAR", "Body", "PixelSums", "Renderer"]
