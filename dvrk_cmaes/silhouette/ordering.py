"""Sort crossings line by line by counting, in time that grows with their number only.

NumPy's stable sort of 16-bit numbers counts them. Two such sorts, of the lower and then of the upper half of a number
made of a line with a position on it behind, are several times as fast as a comparison sort.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

_DIGIT_BITS = 16


def ordered(row: NDArray[np.int32], position: NDArray[np.int32], rows: int, positions: int) -> NDArray[np.intp]:
    """Order (N,) that sorts by row, then by position; those at the same position keep theirs.

    Rows are 0 to ``rows`` - 1, positions 0 to ``positions`` - 1.
    """
    low_bits = max(positions - 1, 0).bit_length()
    bits = low_bits + max(rows - 1, 0).bit_length()
    key: NDArray[np.unsignedinteger[Any]] = row.astype(np.uint32 if bits <= 32 else np.uint64)
    key <<= low_bits
    key |= position.view(np.uint32)
    order = key.astype(np.uint16).argsort(kind="stable")
    for shift in range(_DIGIT_BITS, bits, _DIGIT_BITS):
        digit = (key >> shift).astype(np.uint16).take(order, mode="clip")
        order = order.take(digit.argsort(kind="stable"), mode="clip")
    return order
