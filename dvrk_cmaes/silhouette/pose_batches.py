"""Batches of poses that are processed together.

Arrays of faces, edges and vertices have the pose as their last axis, so that the values of all poses of a batch are
adjacent in memory. The length of that axis, the batch size, is a power of two; entries beyond the number of poses are
padding. The flags of one face for all poses fit into a few machine words, so an edge is compared for all poses
with a few operations, and its faces and ends are looked up once per batch.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.errors import InputError
from dvrk_cmaes.io.arguments import described

POSES_PER_BATCH = 16
"""Largest number of poses in a batch whose images are drawn."""
SUMMED_PER_BATCH = 64
"""Largest number of poses in a batch of which only sums are computed, in arrays as large as the outlines are long."""

Float32 = NDArray[np.float32]
Words = NDArray[np.unsignedinteger[Any]]

_BLOCK = 2048

_WORD_TYPES: dict[int, type[np.unsignedinteger[Any]]] = {
    1: np.uint8,
    2: np.uint16,
    4: np.uint32,
    8: np.uint64,
    16: np.uint64,
    32: np.uint64,
    64: np.uint64,
}


def batch_size_for(poses: int) -> int:
    """Return the smallest batch size for a number of poses; ValueError beyond ``SUMMED_PER_BATCH``."""
    if poses > SUMMED_PER_BATCH:
        raise ValueError(f"at most {SUMMED_PER_BATCH} poses at a time, got {poses}")
    return next(size for size in _WORD_TYPES if size >= poses)


def batch_slices(poses: int, most: int = POSES_PER_BATCH) -> list[slice]:
    """Divide poses into batches of nearly equal length, at most ``most`` each.

    More than ``most`` poses are divided into an even number of batches, so that two threads get equal
    shares. The division does not depend on the number of threads.
    """
    batches = max(-(-poses // most), 1)
    if batches % 2 and poses > most:
        batches += 1
    edges = [round(poses * i / batches) for i in range(batches + 1)]
    return [slice(begin, end) for begin, end in pairwise(edges)]


def index_shift(batch_size: int) -> int:
    """Return log2 of the batch size: a flat index shifted right by this gives the row, its low bits the pose."""
    return batch_size.bit_length() - 1


def matmul_in_blocks(rows: Float32, columns: Float32, out: Float32) -> None:
    """Multiply (N, 4) by (4, batch_size) into ``out``, in blocks too small for the BLAS library to use threads.

    BLAS threads slow this down where the other cores are busy, for example with other threads of the renderer.
    """
    for begin in range(0, len(rows), _BLOCK):
        np.matmul(rows[begin : begin + _BLOCK], columns, out=out[begin : begin + _BLOCK])


def as_words(flags: NDArray[np.bool_]) -> Words:
    """View contiguous flags (N, batch_size) as words (N, 1 or more), one byte per pose."""
    return flags.view(_WORD_TYPES[flags.shape[1]])


def as_flags(words: Words) -> NDArray[np.bool_]:
    """View words (N, 1 or more), whose bytes are 0 or 1, as flags (N, batch_size), one byte per pose."""
    return words.view(np.bool_)


def repeated_words(flags: NDArray[np.bool_], batch_size: int) -> Words:
    """Repeat flags (N,) for every pose of a batch: words (N, 1 or more)."""
    return as_words(np.repeat(flags[:, None], batch_size, axis=1))


def check_poses(names: Sequence[str], camera_from_root: NDArray[np.float64], joints: NDArray[np.float64]) -> None:
    """Raise an InputError for poses that are not (C, 4, 4) or joints that are not (C, J), or one row for all poses."""
    poses = np.shape(camera_from_root)
    if len(poses) != 3 or poses[1:] != (4, 4) or not isinstance(camera_from_root, np.ndarray):
        raise InputError(f"camera_from_root: expected an array (C, 4, 4), got {described(camera_from_root)}")
    rows = joints.shape if isinstance(joints, np.ndarray) else ()
    if rows[-1:] != (len(names),) or rows[:-1] not in ((), (1,), (poses[0],)):
        expected = f"an array ({poses[0]}, {len(names)}) of {', '.join(names)}"
        raise InputError(f"joints: expected {expected}, got {described(joints)}")


def check_finite(camera_from_root: NDArray[np.float64], joints: NDArray[np.float64]) -> None:
    """Raise an InputError for arrays with numbers that are not finite."""
    for name, array in (("camera_from_root", camera_from_root), ("joints", joints)):
        if isinstance(array, np.ndarray) and not np.isfinite(array).all():
            raise InputError(f"{name}: expected finite numbers, got others in {described(array)}")
