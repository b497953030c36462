"""Poses side by side: of a few poses, what is known of a face, a vertex or an edge lies together in memory.

Answers of all poses about one face fit into one word or two, so that an edge compares its faces for all of them at
once, and what is costly about an edge, looking its faces and ends up, is paid once for all of them.
"""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

LANES = 16
"""Poses handled together at most."""

Float32 = NDArray[np.float32]
Words = NDArray[np.unsignedinteger[Any]]

_BLOCK = 2048

_WORDS: dict[int, type[np.unsignedinteger[Any]]] = {
    1: np.uint8,
    2: np.uint16,
    4: np.uint32,
    8: np.uint64,
    16: np.uint64,
}


def lanes_for(poses: int) -> int:
    """Count of lanes, a power of two, that holds so many poses; ValueError beyond ``LANES``."""
    if poses > LANES:
        raise ValueError(f"at most {LANES} poses at a time, got {poses}")
    return next(lanes for lanes in _WORDS if lanes >= poses)


def groups_of(poses: int) -> list[slice]:
    """Divide poses into nearly equal groups of at most ``LANES``; more than half of that make an even number of them.

    So two threads have the same to do, and what is computed together does not depend on the number of threads.
    """
    groups = max(-(-poses // LANES), 1)
    if groups % 2 and poses > LANES // 2:
        groups += 1
    edges = [round(poses * i / groups) for i in range(groups + 1)]
    return [slice(begin, end) for begin, end in pairwise(edges)]


def shift_of(lanes: int) -> int:
    """By how many bits an index is shifted to make room for the lane."""
    return lanes.bit_length() - 1


def product(rows: Float32, columns: Float32, out: Float32) -> None:
    """Matrix product of (N, 4) and (4, lanes), in blocks too small for a BLAS to start threads of its own.

    Those would wait for each other wherever the other cores are at work, as with several threads of ours.
    """
    for begin in range(0, len(rows), _BLOCK):
        np.matmul(rows[begin : begin + _BLOCK], columns, out=out[begin : begin + _BLOCK])


def words_of(answers: NDArray[np.bool_]) -> Words:
    """Answers (N, lanes), contiguous, seen as words (N, 1 or 2) of a byte a lane."""
    return answers.view(_WORDS[answers.shape[1]])


def answers_of(words: Words) -> NDArray[np.bool_]:
    """Words (N, 1 or 2) of a byte a lane, each byte 0 or 1, seen as answers (N, lanes)."""
    return words.view(np.bool_)


def same_in_all_lanes(answers: NDArray[np.bool_]) -> dict[int, Words]:
    """Answers (N,) that hold for every pose, as words, by the number of lanes."""
    return {lanes: words_of(np.repeat(answers[:, None], lanes, axis=1)) for lanes in _WORDS}
