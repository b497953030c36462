"""Files of arrays for the cache: read back alike, and refused where they are damaged."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from dvrk_cmaes.io.array_file import UNUSABLE, read_arrays, write_arrays

ARRAYS = {
    "points": np.arange(12, dtype=np.float64).reshape(4, 3),
    "flags": np.array([True, False, True]),
    "columns": np.arange(6, dtype=np.int32).reshape(2, 3).T,  # not contiguous
    "none": np.empty((0, 4), dtype=np.float32),
    "number": np.array(3.5),
}


@pytest.fixture
def path(tmp_path: Path) -> Path:
    """Write a file of arrays."""
    write_arrays(tmp_path / "kept.arrays", {"error": 0.25, "names": ["a", "b"]}, ARRAYS)
    return tmp_path / "kept.arrays"


def test_arrays_and_values_are_read_back(path: Path) -> None:
    document, arrays = read_arrays(path)
    assert document == {"error": 0.25, "names": ["a", "b"]}
    assert list(arrays) == list(ARRAYS)
    for name, array in ARRAYS.items():
        assert arrays[name].dtype == array.dtype
        np.testing.assert_array_equal(arrays[name], array)


def test_arrays_are_aligned_and_cannot_be_written_to(path: Path) -> None:
    _, arrays = read_arrays(path)
    assert not arrays["points"].flags.owndata
    assert arrays["points"].ctypes.data % 64 == 0
    with pytest.raises(ValueError, match="read-only"):
        arrays["points"][0] = 1.0


@pytest.mark.parametrize(
    "change",
    [lambda path: write_arrays(path, {}, {"points": np.zeros((4, 3))}), lambda path: path.write_bytes(b"")],
    ids=["replaced", "cut in place"],
)
def test_file_that_changes_does_not_change_what_was_read(path: Path, change: Callable[[Path], object]) -> None:
    _, arrays = read_arrays(path)
    change(path)
    np.testing.assert_array_equal(arrays["points"], ARRAYS["points"])


@pytest.mark.parametrize("length", [0, 3, 40, 200, -1])
def test_cut_off_file_is_refused(path: Path, length: int) -> None:
    path.write_bytes(path.read_bytes()[:length])
    with pytest.raises(UNUSABLE):
        read_arrays(path)


@pytest.mark.parametrize("at", [0, 9, 20, 30, 60, -70])
def test_changed_byte_is_found(path: Path, at: int) -> None:
    data = bytearray(path.read_bytes())
    data[at] ^= 0x10
    path.write_bytes(data)
    with pytest.raises(UNUSABLE):
        read_arrays(path)


def test_missing_file_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError):
        read_arrays(tmp_path / "none.arrays")
