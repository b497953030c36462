"""Sort crossings line by line by counting, in time that grows with their number only.

Numbers made of a line with a position on it behind are sorted by their lower, then by their upper half. NumPy's stable
sort of 16-bit numbers counts them, several times as fast as a comparison sort. Of very many, SciPy counts as much in
two thirds of the time, whatever that takes to load: a sparse matrix in compressed rows is a list grouped by row;
turning it into compressed columns groups it by column and keeps the order within.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

Int32 = NDArray[np.int32]

_DIGIT_BITS = 16
_VERY_MANY = 1 << 16  # more than a single frame's small images have


def ordered(
    row: Int32, position: Int32, value: Int32, rows: int, positions: int
) -> tuple[NDArray[np.integer[Any]], Int32]:
    """Sort values (N,) by row, then by position; those at the same position keep their order.

    Rows are 0 to ``rows`` - 1, positions 0 to ``positions`` - 1. Gives where each row begins, (rows + 1,), and the
    values in order.
    """
    bits = max(positions - 1, 0).bit_length()
    if len(row) > _VERY_MANY:
        return _ordered_at_length(row, position, value, rows, bits)
    all_bits = bits + max(rows - 1, 0).bit_length()
    key: NDArray[np.unsignedinteger[Any]] = row.astype(np.uint32 if all_bits <= 32 else np.uint64)
    key <<= bits
    key |= position.view(np.uint32)
    order = key.astype(np.uint16).argsort(kind="stable")
    for shift in range(_DIGIT_BITS, all_bits, _DIGIT_BITS):
        digit = (key >> shift).astype(np.uint16).take(order, mode="clip")
        order = order.take(digit.argsort(kind="stable"), mode="clip")
    start = np.zeros(rows + 1, dtype=np.intp)
    np.cumsum(np.bincount(row, minlength=rows), out=start[1:])
    return start, value.take(order, mode="clip")


def _ordered_at_length(
    row: Int32, position: Int32, value: Int32, rows: int, bits: int
) -> tuple[NDArray[np.integer[Any]], Int32]:
    """Sort very many; ``bits`` is how many a position has."""
    from scipy.sparse import coo_array

    # A table of counters for each half: best if both are small enough for the processor's nearest caches.
    low_bits = max(min((bits + rows.bit_length()) // 2 - 1, bits), 0)
    high = row << (bits - low_bits)
    high += position >> low_bits
    low = position & ((1 << low_bits) - 1)
    entries = coo_array((value, (low, high)), shape=(1 << low_bits, rows << (bits - low_bits)))
    entries.has_canonical_format = True  # entries at the same place are not to be added up
    by_row = entries.tocsr().tocsc()
    return by_row.indptr[:: 1 << (bits - low_bits)], by_row.data
