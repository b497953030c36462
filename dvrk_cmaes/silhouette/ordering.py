"""Sort crossings line by line by counting, in time that grows with their number only.

A sparse matrix in compressed rows is a list grouped by row; turning it into compressed columns groups it by column and
keeps the order within. Twice that is a radix sort of two digits, here of a line's number with a position on it behind:
several times as fast as a comparison sort.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

Integers = NDArray[np.signedinteger[Any]]


def ordered(
    row: NDArray[np.int32], position: NDArray[np.int32], value: Integers, rows: int, positions: int
) -> tuple[NDArray[np.int32], Integers]:
    """Sort (N,) values by row, then by position; those at the same position keep their order.

    Gives where each row begins, (rows + 1,), and the values in order.
    """
    from scipy.sparse import coo_array

    bits = (positions - 1).bit_length()
    # A table of counters for each digit: best if both are small enough for the processor's nearest caches.
    low_bits = max(min((bits + rows.bit_length()) // 2 - 1, bits), 0)
    high = row << (bits - low_bits)
    high += position >> low_bits
    low = position & ((1 << low_bits) - 1)
    entries = coo_array((value, (low, high)), shape=(1 << low_bits, rows << (bits - low_bits)))
    entries.has_canonical_format = True  # entries at the same place are not to be added up
    by_row = entries.tocsr().tocsc()
    return by_row.indptr[:: 1 << (bits - low_bits)], by_row.data
