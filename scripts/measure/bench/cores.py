"""Speed of the renderer with two threads and with two processes, relative to one thread.

NumPy releases Python's global interpreter lock during each larger operation, for some tens of microseconds here. A
thread that requests the lock while the other one holds it is suspended, and later resumed by the operating system. Two
threads are slower than two processes because of these waits. Two processes show the largest speed that the machine's
cores, caches and memory allow.
"""

from __future__ import annotations

import resource
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import Any, Final

import numpy as np

from dvrk_cmaes.instrument import load_instrument
from dvrk_cmaes.silhouette import Body, PixelSums, Renderer
from measure.bench.kernel import images_to_sum, population

WORKERS: Final = 2
_CALLS: Final = 8  # renderings of the population in each timed task of a process

_work: Callable[[int], object] | None = None


def _prepare(source: str, golden: Path) -> tuple[Callable[[int], object], int]:
    """Return a function that renders a population once on a number of threads, and the number of candidates."""
    body = Body.prepare(load_instrument(source))
    camera, poses, joints = population(body.instrument, golden)
    table = PixelSums.of(images_to_sum(camera))
    renderers = {threads: Renderer(body, camera, threads=threads) for threads in (1, WORKERS)}
    return lambda threads: renderers[threads].sums(poses, joints, table), len(poses)


def _prepare_worker(source: str, golden: Path) -> None:
    """Prepare the work in a worker process."""
    global _work
    _work, _ = _prepare(source, golden)
    _work(1)


def _render_several() -> None:
    """Render the population several times in a worker process."""
    assert _work is not None
    for _ in range(_CALLS):
        _work(1)


def _context_switches() -> int:
    """Return the number of voluntary context switches of this process so far."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_nvcsw


def cores_report(source: str, golden: Path, *, repeats: int) -> dict[str, Any]:
    """Measure milliseconds a candidate with one thread, two threads and two processes, called alternately."""
    draw, count = _prepare(source, golden)
    seconds: dict[str, list[float]] = {"1 thread": [], "2 threads": [], "2 processes": []}
    waits: dict[str, list[int]] = {name: [] for name in seconds}
    with ProcessPoolExecutor(
        WORKERS, mp_context=get_context("spawn"), initializer=_prepare_worker, initargs=(source, golden)
    ) as pool:

        def processes() -> None:
            for done in [pool.submit(_render_several) for _ in range(WORKERS)]:
                done.result()

        methods: dict[str, tuple[Callable[[], object], int]] = {
            "1 thread": (lambda: draw(1), 1),
            "2 threads": (lambda: draw(WORKERS), 1),
            "2 processes": (processes, WORKERS * _CALLS),
        }
        for repeat in range(repeats + 1):
            for name, (work, populations) in methods.items():
                before, start = _context_switches(), time.perf_counter()
                work()
                taken, waited = time.perf_counter() - start, _context_switches() - before
                if repeat:  # the first is a warm-up
                    seconds[name].append(taken / (populations * count))
                    waits[name].append(waited)
    each = {name: 1e3 * float(np.median(values)) for name, values in seconds.items()}
    rows: list[dict[str, Any]] = [
        {"way": name, "ms a candidate": value, "times as fast as one thread": each["1 thread"] / value}
        for name, value in each.items()
    ]
    median_waits = float(np.median(waits["2 threads"]))
    lost = 1e3 * count * (each["2 threads"] - each["2 processes"])
    return {
        "cores": rows,
        "two threads": [
            {
                "waits a population": median_waits,
                "us lost a population": lost,
                "us lost a wait, both threads": WORKERS * lost / max(median_waits, 1),
            }
        ],
    }
