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

from dvrk_cmaes.silhouette.crossings import PAYLOAD_BITS, Crossings, find_crossings
from dvrk_cmaes.silhouette.grid import LineGrid
from dvrk_cmaes.silhouette.outline_edges import OutlineEdges

_SORTED_BITS = 8
"""Bits behind the point of a position, px, by which crossings are sorted; closer ones are in no order."""
CLOSE = 1 / (1 << _SORTED_BITS)
"""Distance of crossings, px, below which they are in no order."""


@dataclass(frozen=True, eq=False)
class Spans:
    """All covered spans of a few poses.

    Starts and ends are measured in pixels from the image's border, between 0 and its extent: whole numbers of pixels
    for spans to the pixel, real numbers otherwise.
    """

    row: NDArray[np.int64]
    """(S,) pose * lines + line, ascending."""
    start: NDArray[np.float32]
    end: NDArray[np.float32]
    crossings: Crossings
    turns: NDArray[np.int32] | None
    """(2, S) the crossings at which spans begin and end, where asked for."""


def covered_spans(
    edges: OutlineEdges, grid: LineGrid, extent: int, *, to_pixel: bool = False, detail: bool = False
) -> Spans:
    """Find the spans of lines that a few poses cover, in an image that is ``extent`` pixels long along the lines.

    With ``to_pixel``, a span's ends are whole pixels, such that the pixels whose centres are covered are those between
    them; otherwise they are where the outline really is. With ``detail``, spans know the crossings at which they begin
    and end, and these their segments.
    """
    crossings = find_crossings(edges, grid, detail=detail)
    bits = 0 if to_pixel else PAYLOAD_BITS - extent.bit_length()  # behind the point of a position
    if to_pixel:
        at = np.ceil(crossings.u)
    else:
        at = crossings.u + np.float32(0.5)
        at *= np.float32(1 << bits)
    np.clip(at, 0, extent << bits, out=at)
    fixed = at.astype(np.int32)
    counted = min(bits, _SORTED_BITS)
    position, positions = fixed >> (bits - counted), (extent << counted) + 1
    payload = np.arange(len(fixed), dtype=np.int32) if detail else fixed
    turn_row, found = crossings.turns(position, payload, edges.poses * grid.lines, positions)
    row, ends = turn_row.astype(np.int64), fixed.take(found, mode="clip") if detail else found
    if not to_pixel:
        # Neighbours too close to be told apart may be the wrong way round: then there is nothing between them.
        along = (row << 32) + ends
        np.maximum.accumulate(along, out=along)
        ends = along.astype(np.int32)
    where = ends.astype(np.float32)
    where *= np.float32(1 / (1 << bits))
    turns = found.reshape(-1, 2).T if detail else None
    return Spans(row[::2], where[::2], where[1::2], crossings, turns)
