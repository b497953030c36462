"""Spans of image lines that the instrument covers, for a batch of poses.

Along an image line the number of triangles over a point (the layer count) changes only where the line crosses an
outline edge, and by a known amount (see ``topology``). With the crossings sorted along the line, the layer count is the
cumulative sum of these changes, and the instrument covers the line where it is positive. No rays are traced, unless the
outline edges have rays that decide instead (see ``span_rays``). The changes on a line sum to zero, because edges that
share a vertex assign it to the same line, and meshes cut by the near plane are closed (see ``near_plane``). The ends of
the spans are accurate to a fraction of a pixel, and the cost is proportional to the length of the outline, not to the
area of the image.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.silhouette.crossings import PAYLOAD_BITS, Crossings, find_crossings
from dvrk_cmaes.silhouette.grid import LineGrid
from dvrk_cmaes.silhouette.outline_edges import OutlineEdges

_SORTED_BITS = 8
"""Fractional bits of a position, px, that are used to sort crossings."""
CLOSE = 1 / (1 << _SORTED_BITS)
"""Distance, px, below which crossings on a line may be in the wrong order."""


@dataclass(frozen=True, eq=False)
class Spans:
    """All covered spans of a batch of poses.

    Starts and ends are in pixels from the image border, between 0 and the image's extent along the lines. They are
    integers if the spans were computed ``to_pixel``, real numbers otherwise.
    """

    row: NDArray[np.int64]
    """(S,) pose * lines + line, ascending."""
    start: NDArray[np.float32]
    end: NDArray[np.float32]
    crossings: Crossings
    ends_at: NDArray[np.int32] | None
    """(2, S) indices of the crossings at which spans start and end; None unless requested."""


def covered_spans(
    edges: OutlineEdges, grid: LineGrid, extent: int, *, to_pixel: bool = False, detail: bool = False
) -> Spans:
    """Find the spans of lines that each pose of a batch covers, in an image ``extent`` pixels long along the lines.

    With ``to_pixel``, starts and ends are integers, and a span contains exactly the pixels whose centres are covered;
    otherwise they are the positions of the outline. With ``detail``, the result holds the crossings at which spans
    start and end and the segment of each crossing.
    """
    crossings = find_crossings(edges, grid, detail=detail, exact=to_pixel)
    bits = 0 if to_pixel else PAYLOAD_BITS - extent.bit_length()  # fractional bits of a position
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
    rays = edges.rays

    def decide(row: NDArray[np.int32], payload: NDArray[np.int32]) -> NDArray[np.bool_]:
        assert rays is not None
        where = (fixed.take(payload, mode="clip") if detail else payload) / (1 << bits)
        return rays.covered(row, where, grid, to_pixel=to_pixel, least=1.0 if to_pixel else CLOSE)

    end_row, found = crossings.span_ends(
        position, payload, edges.poses * grid.lines, positions, None if rays is None else decide
    )
    row, ends = end_row.astype(np.int64), fixed.take(found, mode="clip") if detail else found
    if not to_pixel:
        # Crossings closer than CLOSE may be in the wrong order; the running maximum makes such spans empty.
        along = (row << 32) + ends
        np.maximum.accumulate(along, out=along)
        ends = along.astype(np.int32)
    where = ends.astype(np.float32)
    where *= np.float32(1 / (1 << bits))
    ends_at = found.reshape(-1, 2).T if detail else None
    return Spans(row[::2], where[::2], where[1::2], crossings, ends_at)
