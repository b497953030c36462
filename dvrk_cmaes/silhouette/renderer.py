"""Rendering of silhouettes for many poses: sums of images over silhouettes, masks, antialiased coverage, outlines.

Poses are divided into the same batches for any number of threads, so results do not depend on it, to the last bit.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cache, cached_property
from itertools import pairwise
from threading import Lock
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.camera import Camera
from dvrk_cmaes.instrument import Instrument
from dvrk_cmaes.io.arguments import check_type
from dvrk_cmaes.silhouette.grid import LineGrid
from dvrk_cmaes.silhouette.kept import decimated, topology_of
from dvrk_cmaes.silhouette.outline import OutlinePoints, outline_points
from dvrk_cmaes.silhouette.outline_edges import OutlineEdges
from dvrk_cmaes.silhouette.pose_batches import (
    POSES_PER_BATCH,
    SUMMED_PER_BATCH,
    batch_slices,
    check_finite,
    check_poses,
)
from dvrk_cmaes.silhouette.scenes import NEAR, LinkScenes
from dvrk_cmaes.silhouette.shortened import ShortenedShaft
from dvrk_cmaes.silhouette.sliced_call import worked
from dvrk_cmaes.silhouette.spans import Spans, covered_spans
from dvrk_cmaes.silhouette.topology import MeshTopology

T = TypeVar("T")


@dataclass(frozen=True, eq=False)
class Body:
    """An instrument prepared for rendering: its edge topology and its Embree scenes. Renderers may share it.

    Each of these is computed when it is first needed: most images need only the topology with a shortened shaft.
    """

    instrument: Instrument
    scenes: LinkScenes
    error_m: float = 0.0
    """Upper bound of the distance of its surface from the instrument's, m."""
    method: str = "count"
    """How renderers decide what the instrument covers, one of ``METHODS``."""

    def __repr__(self) -> str:
        """Show the instrument."""
        return f"Body({self.instrument!r})"

    @staticmethod
    def prepare(instrument: Instrument) -> Body:
        """Prepare an instrument.

        Parameters
        ----------
        instrument
            The instrument, whose meshes are prepared.
        """
        return Body(instrument, LinkScenes(instrument))

    @cached_property
    def topology(self) -> MeshTopology:
        """The edge topology of the whole instrument."""
        return topology_of(self.instrument)

    @cached_property
    def shortened(self) -> ShortenedShaft:
        """The instrument with the part of its shaft cut off that lies outside an image."""
        return ShortenedShaft(self.instrument, lambda: self.topology)

    def decimated(self, cell: float) -> Body:
        """Return a body with fewer faces for images of low resolution, decimated on a grid with cells of ``cell`` m.

        Parameters
        ----------
        cell
            Width of the grid's cells, m.
        """
        instrument, error = decimated(self.instrument, cell)
        return Body(instrument, LinkScenes(instrument), self.error_m + error, self.method)

    def camera_from_links(
        self, camera_from_root: NDArray[np.float64], joints: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Compute the poses of all links, (C, L, 4, 4), from those of the root, (C, 4, 4), and joints (C, J).

        Parameters
        ----------
        camera_from_root
            Poses of the root link in the camera, (C, 4, 4), m.
        joints
            Joint values, (C, J), rad, in the order of the instrument's `joint_names`.
        """
        return np.asarray(camera_from_root[:, None] @ self.instrument.forward(joints))


@dataclass(frozen=True, eq=False)
class PixelSums:
    """Prefix sums along the rows of images that are to be summed over silhouettes.

    ``table`` (H, W + 1, K or more) holds the sums of ``count`` = K images from the left border to the left side of each
    pixel.
    """

    table: NDArray[np.float32]
    count: int

    @staticmethod
    def of(images: NDArray[np.floating], weight: NDArray[np.floating] | None = None) -> PixelSums:
        """Compute the prefix sums of images (K, H, W), each multiplied by a weight (H, W)."""
        weighted = np.asarray(images if weight is None else images * weight, dtype=np.float64)
        count, height, width = weighted.shape
        # NumPy gathers rows of 4, 8, 16, ... bytes much faster than rows of other lengths.
        padded = 1 << (count - 1).bit_length()
        table = np.zeros((height, width + 1, padded), dtype=np.float32)
        table[:, 1:, :count] = np.moveaxis(weighted.cumsum(axis=2), 0, -1)
        return PixelSums(table, count)


@cache
def _pool(threads: int) -> ThreadPoolExecutor:
    """Return a pool of threads that all renderers share; starting new ones on each call would cost too much time."""
    return ThreadPoolExecutor(threads, thread_name_prefix="silhouettes")


@cache
def _keep_freed_memory() -> None:
    """Make the C library retain the memory of freed temporary arrays.

    glibc returns freed memory to the system above a threshold: twice the largest block freed so far, at most 32 MB.
    Requesting that memory again, page by page, can take as long as the rendering. Allocating and freeing one large
    block raises the threshold. With other C libraries this has no effect.
    """
    np.empty(31 << 20, dtype=np.uint8)


class Renderer:
    """Renders silhouettes of one instrument in one camera; may be used from several threads at once.

    All methods take C poses at a time: ``camera_from_root`` (C, 4, 4), m, and ``joints`` (C, J), rad, in the order of
    ``body.instrument.joint_names`` (wrist_pitch, wrist_yaw, jaw of the bundled instrument). Images are (C, H, W).

    Parameters
    ----------
    body
        The instrument, prepared for rendering (`dvrk_cmaes.prepare`).
    camera
        The camera, whose images are H by W pixels.
    threads
        Number of threads; the images do not depend on it.

    Raises
    ------
    InputError
        No `Body` or `Camera`; or, by the methods, arrays of other shapes.
    """

    def __init__(self, body: Body, camera: Camera, *, threads: int = 2) -> None:
        check_type("body", body, Body, "a Body (dvrk_cmaes.prepare makes one)")
        check_type("camera", camera, Camera, "a Camera")
        self.body = body
        self.camera = camera
        self.threads = threads
        self.rays = 0
        """Number of rays traced so far."""
        self.poses = 0
        """Number of poses rendered so far."""
        self._counting = Lock()
        _keep_freed_memory()

    def at(self, width: int, height: int) -> Renderer:
        """Return a renderer of the same body in the same camera, scaled to another image size in pixels.

        Parameters
        ----------
        width
            Width of the images, px.
        height
            Height of the images, px.
        """
        return Renderer(self.body, self.camera.scaled(width, height), threads=self.threads)

    def _map_batches(
        self,
        camera_from_root: NDArray[np.float64],
        joints: NDArray[np.float64],
        use: Callable[[OutlineEdges], T],
        most: int = POSES_PER_BATCH,
    ) -> list[T]:
        """Apply ``use`` to the outline edges of each batch of at most ``most`` poses, in ``threads`` threads."""
        check_poses(self.body.instrument.joint_names, camera_from_root, joints)
        links = self.body.camera_from_links(camera_from_root, joints)
        batches = [links[part] for part in batch_slices(len(links), most)]

        def work(batch: NDArray[np.float64]) -> T:
            topology = self.body.shortened.topology_for(self.camera, batch)
            scenes = self.body.scenes if self.body.method == "rays" else None
            edges = OutlineEdges(topology, self.camera, batch, scenes)
            done = use(edges)
            if edges.rays is not None:
                with self._counting:
                    self.rays += edges.rays.count
            worked(len(batch) * self.camera.height)
            return done

        if self.threads == 1 or len(batches) == 1:
            done = [work(batch) for batch in batches]
        else:
            done = list(_pool(self.threads).map(work, batches))
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
        """Sum K images over the silhouettes of C poses, (C, K), without rendering an image.

        With ``to_pixel``, the sums are over the pixels whose centres are covered. Otherwise they are integrals over the
        area within the outline, which are continuous in the pose.

        Parameters
        ----------
        camera_from_root
            Poses of the root link in the camera, (C, 4, 4), m.
        joints
            Joint values, (C, J), rad, in the order of the instrument's `joint_names`.
        images
            The K images whose pixels are summed.
        lines_per_pixel
            Lines of the image along which edges are found, for each row of pixels.
        to_pixel
            Whether to sum over whole pixels instead of integrating over areas.
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

        return np.concatenate(self._map_batches(camera_from_root, joints, add, SUMMED_PER_BATCH)) / lines_per_pixel

    def coverage(
        self, camera_from_root: NDArray[np.float64], joints: NDArray[np.float64], *, lines_per_pixel: int = 4
    ) -> NDArray[np.float32]:
        """Render antialiased silhouettes of C poses: the covered fraction of each pixel, (C, H, W).

        Parameters
        ----------
        camera_from_root
            Poses of the root link in the camera, (C, 4, 4), m.
        joints
            Joint values, (C, J), rad, in the order of the instrument's `joint_names`.
        lines_per_pixel
            Lines of the image along which edges are found, for each row of pixels.
        """
        grid = LineGrid(self.camera.height, lines_per_pixel)

        def draw(edges: OutlineEdges) -> NDArray[np.float32]:
            return self._covered_shares(covered_spans(edges, grid, self.camera.width), edges.poses, lines_per_pixel)

        return np.concatenate(self._map_batches(camera_from_root, joints, draw))

    def _covered_shares(self, spans: Spans, poses: int, lines_per_pixel: int) -> NDArray[np.float32]:
        """Compute the covered fraction of each pixel, (C, H, W), from spans."""
        height, width = self.camera.height, self.camera.width
        row = spans.row // lines_per_pixel if lines_per_pixel > 1 else spans.row
        at = np.concatenate([spans.start, spans.end])
        whole = at.astype(np.int32)
        later = at - whole.astype(np.float32)
        later[len(row) :] *= -1
        now = np.repeat(np.array([1, -1], dtype=np.float32), len(row)) - later
        rows = poses * height
        index = whole * rows + np.tile(row, 2)
        change = np.bincount(
            np.concatenate([index, index + rows]),
            weights=np.concatenate([now, later]),
            minlength=(width + 2) * rows,
        )
        # The sums along the rows, column by column: adding whole columns takes a third of the time of cumsum.
        columns = change.astype(np.float32).reshape(width + 2, rows)[:width]
        for before, after in pairwise(columns):
            after += before
        columns *= np.float32(1 / lines_per_pixel)
        return np.ascontiguousarray(columns.T).reshape(poses, height, width)

    def outlines(self, camera_from_root: NDArray[np.float64], joints: NDArray[np.float64]) -> OutlinePoints:
        """Find points on the outlines of C poses, in the image and on the instrument, on all pixel rows and columns.

        Parameters
        ----------
        camera_from_root
            Poses of the root link in the camera, (C, 4, 4), m.
        joints
            Joint values, (C, J), rad, in the order of the instrument's `joint_names`.
        """
        grid = LineGrid(self.camera.height)

        def find(edges: OutlineEdges) -> OutlinePoints:
            rows = covered_spans(edges, grid, self.camera.width, detail=True)
            return outline_points(edges, self.camera, rows, grid)

        points = self._map_batches(camera_from_root, joints, find)
        return OutlinePoints.joined(points, batch_slices(len(camera_from_root)))

    def coverage_and_outlines(
        self, camera_from_root: NDArray[np.float64], joints: NDArray[np.float64], *, lines_per_pixel: int = 2
    ) -> tuple[NDArray[np.float32], OutlinePoints]:
        """Compute the coverage and the outlines of C poses together, at little more than the cost of one of them.

        The points of the outlines lie on all lines of the coverage, ``lines_per_pixel`` per pixel row, and on the pixel
        columns.

        Parameters
        ----------
        camera_from_root
            Poses of the root link in the camera, (C, 4, 4), m.
        joints
            Joint values, (C, J), rad, in the order of the instrument's `joint_names`.
        lines_per_pixel
            Lines of the image along which edges are found, for each row of pixels.
        """
        grid = LineGrid(self.camera.height, lines_per_pixel)

        def both(edges: OutlineEdges) -> tuple[NDArray[np.float32], OutlinePoints]:
            rows = covered_spans(edges, grid, self.camera.width, detail=True)
            points = outline_points(edges, self.camera, rows, grid)
            return self._covered_shares(rows, edges.poses, lines_per_pixel), points

        coverage, points = zip(*self._map_batches(camera_from_root, joints, both), strict=True)
        return np.concatenate(coverage), OutlinePoints.joined(points, batch_slices(len(camera_from_root)))

    def masks(self, camera_from_root: NDArray[np.float64], joints: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Render masks of C poses: whether each pixel's centre is covered, (C, H, W).

        Parameters
        ----------
        camera_from_root
            (C, 4, 4), m: poses of the root link in the camera.
        joints
            (C, J), rad, in the order of ``body.instrument.joint_names``.

        Raises
        ------
        InputError
            Arrays of other shapes, or numbers that are not finite.
        """
        check_finite(camera_from_root, joints)
        height, width = self.camera.height, self.camera.width
        grid = LineGrid(height)

        def draw(edges: OutlineEdges) -> NDArray[np.bool_]:
            spans, poses = covered_spans(edges, grid, width, to_pixel=True), edges.poses
            begin = spans.row * (width + 1)
            index = np.concatenate([begin + spans.start.astype(np.int32), begin + spans.end.astype(np.int32)])
            change = np.zeros((poses, height, width + 1), dtype=np.int8)
            np.add.at(change.reshape(-1), index, np.repeat(np.array([1, -1], dtype=np.int8), len(begin)))
            covered = np.zeros((poses, height, width), dtype=np.bool_)
            if len(begin):  # the sums along the rows, of the part of the images that has spans
                row = spans.row % height
                part = np.s_[:, row.min() : row.max() + 1, int(spans.start.min()) : int(spans.end.max())]
                np.greater(change[part].cumsum(axis=2, dtype=np.int8), 0, out=covered[part])
            return covered

        return np.concatenate(self._map_batches(camera_from_root, joints, draw))

    def trace(self, camera_from_root: NDArray[np.float64], joints: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Trace one ray through the centre of every pixel: the reference for ``masks``, (C, H, W).

        Parameters
        ----------
        camera_from_root
            Poses of the root link in the camera, (C, 4, 4), m.
        joints
            Joint values, (C, J), rad, in the order of the instrument's `joint_names`.
        """
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
