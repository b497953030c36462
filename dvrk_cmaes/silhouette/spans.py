"""Where the instrument covers the image, as spans along image lines, for many poses at once.

Along an image line the number of triangles over a point changes only where the line crosses an outline edge, and by a
known amount (see ``topology``). Sorted along the line, the crossings' running sum is the layer count, and the
instrument covers the line where it is positive: no ray is needed. Every line's changes sum to zero, since an edge's
ends are on the same lines for all edges that share them, and what the near plane cuts is closed again (see
``near_plane``). The ends of the spans are real numbers, exact to a fraction of a pixel, at the cost of the outline
instead of the image.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.camera import Camera
from dvrk_cmaes.silhouette.crossings import CODE_BITS, NO_CHANGE, Crossings, find_crossings
from dvrk_cmaes.silhouette.grid import LineGrid
from dvrk_cmaes.silhouette.ordering import ordered
from dvrk_cmaes.silhouette.topology import MeshTopology

SORTED_BITS = 8
"""Bits behind the point of a position, px, by which crossings are sorted; closer ones are in no order."""


@dataclass(frozen=True, eq=False)
class Spans:
    """All covered spans of a few poses.

    Starts and ends are measured in pixels from the image's left border, between 0 and its width: whole numbers of
    pixels for spans to the pixel, real numbers otherwise.
    """

    row: NDArray[np.int64]
    """(S,) pose * lines + line, ascending."""
    start: NDArray[np.float32]
    end: NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class SpanRenderer:
    """Finds the covered spans of populations of poses in one camera.

    ``grid.per_pixel`` lines run through each row of pixels. With ``to_pixel``, a span's ends are whole pixels, such
    that the pixels whose centres are covered are those between them; otherwise they are where the outline really is.
    """

    topology: MeshTopology
    camera: Camera
    grid: LineGrid
    to_pixel: bool

    def spans(self, camera_from_link: NDArray[np.float64]) -> Spans:
        """Covered spans of up to ``LANES`` poses, (C, L, 4, 4)."""
        crossings = find_crossings(self.topology, self.camera, self.grid, camera_from_link)
        return self._count(crossings.row, self._fixed(crossings), len(camera_from_link) * self.grid.lines)

    @property
    def _fraction_bits(self) -> int:
        """Bits behind the point of a position that shares 31 bits with the code of its change."""
        return 0 if self.to_pixel else 31 - CODE_BITS - int(self.camera.width).bit_length()

    def _fixed(self, crossings: Crossings) -> NDArray[np.int32]:
        """Positions from the image's left border as numbers of fixed point, followed by the codes of the changes."""
        one = 1 << self._fraction_bits
        if self.to_pixel:
            at = np.ceil(crossings.u)
        else:
            at = crossings.u + np.float32(0.5)
            at *= np.float32(one)
        np.clip(at, 0, self.camera.width * one, out=at)
        fixed = at.astype(np.int32)
        fixed <<= CODE_BITS
        fixed |= crossings.code
        return fixed

    def _count(self, row: NDArray[np.int32], fixed: NDArray[np.int32], rows: int) -> Spans:
        """Spans from the running layer count; each line's changes must sum to zero."""
        counted = min(self._fraction_bits, SORTED_BITS)
        position = fixed >> (CODE_BITS + self._fraction_bits - counted)
        start, fixed = ordered(row, position, fixed, rows, (self.camera.width << counted) + 1)
        # Codes are changes plus NO_CHANGE, so their running sum is the layer count and so much for each crossing.
        count = np.cumsum(fixed & ((1 << CODE_BITS) - 1), dtype=np.int32)
        covered = count > np.arange(NO_CHANGE, NO_CHANGE * (len(count) + 1), NO_CHANGE, dtype=np.int32)
        turns = covered.copy()
        turns[1:] ^= covered[:-1]
        at = np.flatnonzero(turns)
        row_of = np.repeat(np.arange(rows, dtype=np.int32), np.diff(start)).take(at, mode="clip").astype(np.int64)
        ends = fixed.take(at, mode="clip")
        ends >>= CODE_BITS
        if not self.to_pixel:
            # Neighbours too close to be told apart may be the wrong way round: then there is nothing between them.
            along = (row_of << 32) + ends
            np.maximum.accumulate(along, out=along)
            ends = along.astype(np.int32)
        where = ends.astype(np.float32)
        where *= np.float32(1 / (1 << self._fraction_bits))
        return Spans(row_of[::2], where[::2], where[1::2])
