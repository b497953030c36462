"""Where the instrument covers the image, as spans along image lines, for many poses at once.

Along an image line the number of triangles over a point changes only where the line crosses an outline edge, and by a
known amount (see ``topology``). Sorted along the line, the crossings' running sum is the layer count, and the
instrument covers the line where it is positive: each span's answer follows from its left neighbour's. On a line whose
sum does not come back to zero a link has been cut by the near plane beside the image; there Embree is asked span by
span, and pixel by pixel where the eye stands in a link's box, so that the cut itself may be in view. Either way the
ends of the spans are real numbers, exact to a fraction of a pixel, at the cost of the outline instead of the image.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.camera import Camera
from dvrk_cmaes.silhouette.crossings import LANES, Crossings, LineGrid, find_crossings
from dvrk_cmaes.silhouette.scenes import LinkScenes
from dvrk_cmaes.silhouette.topology import MeshTopology

_CHANGE = np.array([-2, -1, 1, 2], dtype=np.int8)
_CHANGE_CODE = np.array([0, 1, 0, 2, 3], dtype=np.uint8)  # of the change + 2


@dataclass(frozen=True, eq=False)
class SpanEnds:
    """Both ends of all covered spans of a population.

    A start has ``sign`` +1, an end -1; ``at`` is measured in pixels from the image's left border, between 0 and its
    width: whole numbers of pixels for spans to the pixel, real numbers otherwise.
    """

    pose: NDArray[np.int32]
    line: NDArray[np.int32]
    at: NDArray[np.float32]
    sign: NDArray[np.int8]
    rays: int
    """How many rays were traced."""


@dataclass(frozen=True, eq=False)
class SpanRenderer:
    """Finds the covered spans of populations of poses in one camera.

    ``grid.per_pixel`` lines run through each row of pixels. With ``to_pixel``, a span's ends are whole pixels, such
    that the pixels whose centres are covered are those between them; otherwise they are where the outline really is.
    """

    topology: MeshTopology
    scenes: LinkScenes
    camera: Camera
    grid: LineGrid
    to_pixel: bool

    def ends(self, camera_from_link: NDArray[np.float64]) -> SpanEnds:
        """Spans of up to ``LANES`` poses, (C, L, 4, 4)."""
        if len(camera_from_link) > LANES:
            raise ValueError(f"at most {LANES} poses at a time, got {len(camera_from_link)}")
        crossings = find_crossings(self.topology, self.camera, self.grid, camera_from_link)
        doubtful = crossings.unsettled_lines(len(camera_from_link), self.grid.lines)
        if doubtful is None:
            return self._count(crossings, len(camera_from_link))
        ask = doubtful[crossings.pose, crossings.line]
        counted = self._count(crossings.select(~ask), len(camera_from_link))
        traced = self._trace(crossings.select(ask), doubtful, camera_from_link)
        return SpanEnds(
            pose=np.concatenate([counted.pose, traced.pose]),
            line=np.concatenate([counted.line, traced.line]),
            at=np.concatenate([counted.at, traced.at]),
            sign=np.concatenate([counted.sign, traced.sign]),
            rays=traced.rays,
        )

    def _fraction_bits(self) -> int:
        """Bits behind the point of a position packed into 32 bits with its line and its change of count."""
        if self.to_pixel:
            return 0
        return 30 - int(self.grid.lines).bit_length() - int(self.camera.width + 1).bit_length()

    def _count(self, crossings: Crossings, poses: int) -> SpanEnds:
        """Spans from the running layer count; each line's changes must sum to zero."""
        width = self.camera.width
        bits = self._fraction_bits()
        wide = bits < (0 if self.to_pixel else 6)
        key_type = np.uint64 if wide else np.uint32
        bits = 16 if wide and not self.to_pixel else max(bits, 0)
        shift = int(width << bits).bit_length()
        scale = np.float32(1 << bits)
        if self.to_pixel:
            at = np.ceil(crossings.u)
        else:
            at = (crossings.u + np.float32(0.5)) * scale
            np.rint(at, out=at)
        np.clip(at, 0, width * scale, out=at)
        key: NDArray[Any] = crossings.line.astype(key_type)
        key <<= shift
        key |= at.astype(key_type)
        key <<= 2
        key |= _CHANGE_CODE[crossings.change + 2]

        # One row a pose, padded behind, so that all poses are sorted in one call.
        per_pose = np.bincount(crossings.pose, minlength=poses)
        used = np.arange(per_pose.max(initial=0)) < per_pose[:, None]
        table = np.full(used.shape, np.iinfo(key_type).max, dtype=key_type)
        table[used] = key
        table.sort(axis=1)
        covered = np.cumsum(_CHANGE[table & key_type(3)], axis=1, dtype=np.int32) > 0
        turns = covered.copy()
        turns[:, 1:] ^= covered[:, :-1]
        turns &= used
        pose, position = np.nonzero(turns)
        found = table[pose, position]
        line = (found >> key_type(shift + 2)).astype(np.int32)
        at = ((found >> key_type(2)) & key_type((1 << shift) - 1)).astype(np.float32)
        at /= scale
        sign = np.where(covered[pose, position], 1, -1).astype(np.int8)
        return SpanEnds(pose=pose.astype(np.int32), line=line, at=at, sign=sign, rays=0)

    def _trace(
        self, crossings: Crossings, doubtful: NDArray[np.bool_], camera_from_link: NDArray[np.float64]
    ) -> SpanEnds:
        """Spans of the doubtful lines, one ray each; the image's borders are crossings too."""
        width = self.camera.width
        border_pose, border_line = np.nonzero(doubtful)
        every_pixel = np.flatnonzero(crossings.inside[border_pose])
        within = np.repeat(every_pixel, width - 1)
        pose = np.concatenate([crossings.pose, border_pose, border_pose, border_pose[within]])
        line = np.concatenate([crossings.line, border_line, border_line, border_line[within]])
        ends = (
            np.zeros(len(border_pose)),
            np.full(len(border_pose), width),
            np.tile(np.arange(1, width), len(every_pixel)),
        )
        at = np.clip(np.concatenate([crossings.u + 0.5, *ends]), 0.0, width)
        order = np.lexsort((at, line, pose))
        pose, line, at = pose[order], line[order], at[order]
        if self.to_pixel:
            at = np.clip(np.ceil(at - 0.5), 0, width)
        least = 0.5 if self.to_pixel else 1e-4
        span = np.flatnonzero((pose[1:] == pose[:-1]) & (line[1:] == line[:-1]) & (at[1:] - at[:-1] > least))
        start, end = at[span], at[span + 1]
        middle = np.floor((start + end) / 2) if self.to_pixel else (start + end) / 2 - 0.5
        pixels = np.stack([middle, self.grid.line_to_v(line[span])], axis=1)
        directions = np.c_[self.camera.normalise(pixels), np.ones(len(span))]
        covered = self.scenes.covered(camera_from_link, pose[span], directions)
        span, start, end = span[covered], start[covered], end[covered]
        return SpanEnds(
            pose=np.tile(pose[span], 2).astype(np.int32),
            line=np.tile(line[span], 2).astype(np.int32),
            at=np.concatenate([start, end]).astype(np.float32),
            sign=np.repeat(np.array([1, -1], dtype=np.int8), len(span)),
            rays=len(directions),
        )
