"""Map a function over independent items in threads, and divide items into batches."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise
from typing import TypeVar

A = TypeVar("A")
B = TypeVar("B")


def map_threaded(function: Callable[[A], B], items: Sequence[A], threads: int) -> list[B]:
    """Apply a function to each item in up to ``threads`` threads; returns the values in the order of the items.

    Each item is one call of the function, so the values do not depend on the number of threads.
    """
    if threads <= 1 or len(items) <= 1:
        return [function(item) for item in items]
    with ThreadPoolExecutor(min(threads, len(items))) as pool:
        return list(pool.map(function, items))


def batches(items: Sequence[A], size: int) -> list[Sequence[A]]:
    """Divide items into batches of nearly equal length, at most ``size`` each."""
    count = -(-len(items) // size)
    edges = [round(i * len(items) / count) for i in range(count + 1)] if count else []
    return [items[a:b] for a, b in pairwise(edges)]
