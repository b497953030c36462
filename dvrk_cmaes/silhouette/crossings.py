"""Where image lines cross the outline edges of a few poses."""

from __future__ import annotations

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
"""A crossing's code is its change of the layer count, -2 to 2, plus this."""


@dataclass(frozen=True, eq=False)
class Crossings:
    """Crossings of lines with outline segments, in no order."""

    row: NDArray[np.int32]
    """(N,) pose * lines + line."""
    u: Float32
    """(N,) pixel column coordinate."""
    code: NDArray[np.int32]
    """(N,) by how much the layer count changes from left to right, plus ``_NO_CHANGE``; each row's sum to zero."""
    segments: Segments
    slope: Float32
    """(S,) change of the position from a line to the next."""
    segment: NDArray[np.int32] | None
    """(N,) which segment a crossing is on, where asked for."""

    def turns(
        self, position: NDArray[np.int32], payload: NDArray[np.int32], rows: int, positions: int
    ) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
        """Where the instrument begins and ends to cover a row, in turns, by row and position: rows and payloads (2 S,).

        ``position`` (N,) is what crossings are sorted by along their row, 0 to ``positions`` - 1; ``payload`` (N,), of
        at most ``PAYLOAD_BITS`` bits, what is wanted of those that are turns.
        """
        value = payload << _CODE_BITS
        value |= self.code
        start, value = ordered(self.row, position, value, rows, positions)
        # Codes are changes plus _NO_CHANGE, so their running sum is the layer count and so much for each crossing.
        count = np.cumsum(value & ((1 << _CODE_BITS) - 1), dtype=np.int32)
        covered = count > np.arange(_NO_CHANGE, _NO_CHANGE * (len(count) + 1), _NO_CHANGE, dtype=np.int32)
        turns = covered.copy()
        turns[1:] ^= covered[:-1]
        at = np.flatnonzero(turns)
        row = np.repeat(np.arange(rows, dtype=np.int32), np.diff(start))
        return row.take(at, mode="clip"), value.take(at, mode="clip") >> _CODE_BITS


def find_crossings(edges: OutlineEdges, grid: LineGrid, *, detail: bool = False) -> Crossings:
    """Crossings of all lines with outline edges; with ``detail``, also which segment each crossing is on."""
    found = edges.segments(grid, detail=detail)
    segments = found.segments

    first = np.minimum(*segments.line).astype(np.int32)
    lines = np.subtract(segments.line[1], segments.line[0], dtype=np.int32)
    count = np.abs(lines)
    way_u, way_v = segments.u[1] - segments.u[0], segments.v[1] - segments.v[0]
    slope: Float32 = np.divide(way_u, way_v, out=way_u)
    # Measured from the end that is nearer to the first line: the other may be very far outside the image.
    to_first = first.astype(np.float32) - segments.v
    end = (np.abs(to_first[1]) < np.abs(to_first[0])).astype(np.intp)
    to_first *= slope
    to_first += segments.u
    end *= len(count)
    end += np.arange(len(count))
    # Rows and columns changing places turns the image over, and left and right of an edge with it.
    rising = (lines > 0) ^ found.front ^ (not grid.vertical)
    change = (2 * rising.view(np.int8) - 1) * segments.weight
    offset = np.cumsum(count, dtype=np.int32)
    total = int(offset[-1]) if len(offset) else 0
    offset -= count

    # What crossings of a segment have in common goes to them in one piece: four numbers of four bytes.
    common = np.empty((len(count), 4), dtype=np.float32)
    common[:, 0] = slope
    common[:, 1] = to_first.ravel().take(end, mode="clip")
    common[:, 2] = offset
    row = segments.lane.astype(np.int32)
    row *= grid.lines
    row += first
    row -= offset
    row <<= _CODE_BITS
    row += change
    row += _NO_CHANGE
    common.view(np.int32)[:, 3] = row
    each = np.repeat(common.view(np.complex128)[:, 0], count).view(np.float32).reshape(-1, 4)
    place = np.arange(total, dtype=np.int32)
    u: Float32 = place.astype(np.float32)
    u -= each[:, 2]
    u *= each[:, 0]
    u += each[:, 1]
    place <<= _CODE_BITS
    place += each.view(np.int32)[:, 3]
    return Crossings(
        row=place >> _CODE_BITS,
        u=u,
        code=place & ((1 << _CODE_BITS) - 1),
        segments=segments,
        slope=slope,
        segment=np.repeat(np.arange(len(count), dtype=np.int32), count) if detail else None,
    )
