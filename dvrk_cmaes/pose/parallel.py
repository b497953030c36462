"""Both cores for independent pieces of one frame's work."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise
from typing import TypeVar

A = TypeVar("A")
B = TypeVar("B")


def each(function: Callable[[A], B], items: Sequence[A], threads: int) -> list[B]:
    """Apply a function to all items, in their order, on up to ``threads`` threads.

    The items decide what is computed together, so results do not depend on the number of threads.
    """
    if threads <= 1 or len(items) <= 1:
        return [function(item) for item in items]
    with ThreadPoolExecutor(min(threads, len(items))) as pool:
        return list(pool.map(function, items))


def batches(items: Sequence[A], size: int) -> list[Sequence[A]]:
    """Cut items into batches of nearly equal length, at most ``size`` long."""
    count = -(-len(items) // size)
    edges = [round(i * len(items) / count) for i in range(count + 1)] if count else []
    return [items[a:b] for a, b in pairwise(edges)]
