"""Calls of a function in worker processes, with one thread each, and progress on stderr."""

from __future__ import annotations

import multiprocessing
import os
import sys
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from typing import Any, TypeVar

Item = TypeVar("Item")


def in_processes(
    call: Callable[..., Item],
    tasks: Sequence[tuple[Any, ...]],
    workers: int,
    label: str,
    on_done: Callable[[int, Item], None],
) -> None:
    """Call a function in worker processes with the arguments of each task, and take each result with its number."""
    if not tasks:
        return
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ[name] = "1"  # inherited by the workers, whose libraries read it when they are loaded
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(workers, context, initializer=_use_one_thread) as pool:
        futures = {pool.submit(call, *task): number for number, task in enumerate(tasks)}
        try:
            for count, future in enumerate(as_completed(futures), start=1):
                on_done(futures[future], future.result())
                print_progress(label, count, len(tasks))
        except BaseException:
            pool.shutdown(cancel_futures=True)
            raise


def print_progress(label: str, count: int, total: int) -> None:
    """Print progress on stderr: on a terminal always in the same line, otherwise a line for every 20th item."""
    if sys.stderr.isatty():
        print(f"\r{label}: {count}/{total}", end="\n" if count == total else "", file=sys.stderr, flush=True)
    elif count == total or count % 20 == 0:
        print(f"{label}: {count}/{total}", file=sys.stderr, flush=True)


def _use_one_thread() -> None:
    """Keep OpenCV in a worker process from using several threads."""
    import cv2

    cv2.setNumThreads(1)
