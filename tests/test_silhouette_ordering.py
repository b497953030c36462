"""Sorting by counting is sorting: by line, then by position, and fair to those at the same one."""

from __future__ import annotations

import numpy as np
import pytest

from dvrk_cmaes.silhouette.ordering import ordered


@pytest.mark.parametrize(("rows", "positions"), [(1, 1), (1, 2), (8 * 480, 641), (3, 641 << 8), (8 * 2160, 3841 << 8)])
@pytest.mark.parametrize("count", [0, 1, 20000, 100000])
def test_ordered_is_what_a_stable_comparison_sort_gives(rows: int, positions: int, count: int) -> None:
    rng = np.random.default_rng(rows + positions + count)
    row = rng.integers(0, rows, count, dtype=np.int32)
    position = rng.integers(0, positions, count, dtype=np.int32)
    position[: count // 2] //= 50  # many at the same place
    start, found = ordered(row, position, np.arange(count, dtype=np.int32), rows, positions)
    np.testing.assert_array_equal(found, np.lexsort((position, row)))
    np.testing.assert_array_equal(start, np.searchsorted(np.sort(row), np.arange(rows + 1)))
