"""Crossings of image lines with the outline edges of a batch of poses."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.silhouette.grid import Float32, LineGrid
from dvrk_cmaes.silhouette.ordering import ordered
from dvrk_cmaes.silhouette.outline_edges import OutlineEdges
from dvrk_cmaes.silhouette.segments import Segments

_CODE_BITS = 3
PAYLOAD_BITS = 31 - _CODE_BITS
_NO_CHANGE = 2
"""A crossing's code is the change of the layer count there, -2 to 2, plus this."""


@dataclass(frozen=True, eq=False)
class Crossings:
    """Crossings of image lines with outline segments, unsorted."""

    row: NDArray[np.int32]
    """(N,) pose * lines + line."""
    u: Float32
    """(N,) pixel column coordinate."""
    code: NDArray[np.int32]
    """(N,) change of the layer count from left to right, plus ``_NO_CHANGE``; the changes of a row sum to zero."""
    segments: Segments
    slope: Float32
    """(S,) change of the position along the lines from one line to the next."""
    segment: NDArray[np.int32] | None
    """(N,) index of the segment of each crossing; None unless requested."""

    def span_ends(
        self,
        position: NDArray[np.int32],
        payload: NDArray[np.int32],
        rows: int,
        positions: int,
        decide: Callable[[NDArray[np.int32], NDArray[np.int32]], NDArray[np.bool_]] | None = None,
    ) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
        """Find the crossings at which the S covered spans start and end: rows and payloads, (2 S,) each.

        They are sorted by row and position, so starts and ends alternate. ``position`` (N,) is the sort key of the
        crossings along their row, 0 to ``positions`` - 1; ``payload`` (N,) holds a value of at most ``PAYLOAD_BITS``
        bits for each crossing, which is returned for those found. ``decide``, if given, tells from rows and payloads of
        all crossings, in order, whether each span from one to the next is covered; otherwise the layers count.
        """
        value = payload << _CODE_BITS
        value |= self.code
        start, value = ordered(self.row, position, value, rows, positions)
        row = np.repeat(np.arange(rows, dtype=np.int32), np.diff(start))
        if decide is not None:
            covered = decide(row, value >> _CODE_BITS)
        else:
            # Codes are changes plus _NO_CHANGE, so their running sum is the layer count plus _NO_CHANGE per crossing.
            count = np.cumsum(value & ((1 << _CODE_BITS) - 1), dtype=np.int32)
            covered = count > np.arange(_NO_CHANGE, _NO_CHANGE * (len(count) + 1), _NO_CHANGE, dtype=np.int32)
        changed = covered.copy()
        changed[1:] ^= covered[:-1]
        at = np.flatnonzero(changed)
        return row.take(at, mode="clip"), value.take(at, mode="clip") >> _CODE_BITS


def find_crossings(edges: OutlineEdges, grid: LineGrid, *, detail: bool = False, exact: bool = False) -> Crossings:
    """Find the crossings of all lines with outline edges; with ``detail``, also the segment of each crossing.

    ``exact`` as of `OutlineEdges.segments`.
    """
    found = edges.segments(grid, detail=detail, exact=exact)
    segments = found.segments

    first = np.minimum(*segments.line).astype(np.int32)
    lines = np.subtract(segments.line[1], segments.line[0], dtype=np.int32)
    count = np.abs(lines)
    delta_u, delta_v = segments.u[1] - segments.u[0], segments.v[1] - segments.v[0]
    slope: Float32 = np.divide(delta_u, delta_v, out=delta_u)
    # Positions are extrapolated from the end nearer to the first line: the other may lie very far outside the image.
    to_first = first.astype(np.float32) - segments.v
    end = (np.abs(to_first[1]) < np.abs(to_first[0])).astype(np.intp)
    to_first *= slope
    to_first += segments.u
    end *= len(count)
    end += np.arange(len(count))
    # Swapping rows and columns mirrors the image, which swaps the left and right side of an edge.
    rising = (lines > 0) ^ found.front ^ (not grid.vertical)
    change = (2 * rising.view(np.int8) - 1) * segments.weight
    offset = np.cumsum(count, dtype=np.int32)
    total = int(offset[-1]) if len(offset) else 0
    offset -= count

    # The values shared by all crossings of a segment, four numbers of four bytes, are repeated as one 16-byte value.
    common = np.empty((len(count), 4), dtype=np.float32)
    common[:, 0] = slope
    common[:, 1] = to_first.ravel().take(end, mode="clip")
    common[:, 2] = offset
    row = segments.pose.astype(np.int32)
    row *= grid.lines
    row += first
    row -= offset
    row <<= _CODE_BITS
    row += change
    row += _NO_CHANGE
    common.view(np.int32)[:, 3] = row
    repeated = np.repeat(common.view(np.complex128)[:, 0], count).view(np.float32).reshape(-1, 4)
    place = np.arange(total, dtype=np.int32)
    u: Float32 = place.astype(np.float32)
    u -= repeated[:, 2]
    u *= repeated[:, 0]
    u += repeated[:, 1]
    place <<= _CODE_BITS
    place += repeated.view(np.int32)[:, 3]
    return Crossings(
        row=place >> _CODE_BITS,
        u=u,
        code=place & ((1 << _CODE_BITS) - 1),
        segments=segments,
        slope=slope,
        segment=np.repeat(np.arange(len(count), dtype=np.int32), count) if detail else None,
    )
