"""Counting sort of crossings by line and position, compared with a stable comparison sort."""

from __future__ import annotations

import numpy as np
import pytest

from dvrk_cmaes.silhouette.ordering import ordered


@pytest.mark.parametrize(("rows", "positions"), [(1, 1), (1, 2), (8 * 480, 641), (3, 641 << 8), (8 * 2160, 3841 << 8)])
@pytest.mark.parametrize("count", [0, 1, 20000, 100000])
def test_order_agrees_with_stable_sort(rows: int, positions: int, count: int) -> None:
    rng = np.random.default_rng(rows + positions + count)
    row = rng.integers(0, rows, count, dtype=np.int32)
    position = rng.integers(0, positions, count, dtype=np.int32)
    position[: count // 2] //= 50  # many at the same place
    start, found = ordered(row, position, np.arange(count, dtype=np.int32), rows, positions)
    np.testing.assert_array_equal(found, np.lexsort((position, row)))
    np.testing.assert_array_equal(start, np.searchsorted(np.sort(row), np.arange(rows + 1)))
