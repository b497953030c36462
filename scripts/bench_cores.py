"""What the second core is worth: to threads, which share the interpreter's lock, and to processes, which share nothing.

NumPy lets go of the lock for the length of each larger operation, some tens of microseconds here. A thread that wants
it back while the other one holds it goes to sleep, and is woken by the system: that, not the rendering, is what two
threads lose against two processes. Processes are the most that the machine's cores, caches and memory have to give.
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
from bench_render import images_to_sum, population

from dvrk_cmaes.instrument import load_instrument
from dvrk_cmaes.silhouette import Body, PixelSums, Renderer

WORKERS: Final = 2
_TOGETHER: Final = 8  # populations a process draws between two looks at the clock

_work: Callable[[int], object] | None = None


def _prepare(source: str, golden: Path) -> tuple[Callable[[int], object], int]:
    """Work that draws a population once on so many threads, and how many candidates that is."""
    body = Body.prepare(load_instrument(source))
    camera, poses, joints = population(body.instrument, golden)
    table = PixelSums.of(images_to_sum(camera))
    renderers = {threads: Renderer(body, camera, threads=threads) for threads in (1, WORKERS)}
    return lambda threads: renderers[threads].sums(poses, joints, table), len(poses)


def _start(source: str, golden: Path) -> None:
    global _work
    _work, _ = _prepare(source, golden)
    _work(1)


def _several() -> None:
    assert _work is not None
    for _ in range(_TOGETHER):
        _work(1)


def _waits() -> int:
    """How often this process's threads have gone to sleep so far."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_nvcsw


def cores_report(source: str, golden: Path, *, repeats: int) -> dict[str, Any]:
    """Milliseconds a candidate: one thread, two threads, and two processes at once, in turns."""
    draw, count = _prepare(source, golden)
    seconds: dict[str, list[float]] = {"1 thread": [], "2 threads": [], "2 processes": []}
    waits: dict[str, list[int]] = {name: [] for name in seconds}
    with ProcessPoolExecutor(
        WORKERS, mp_context=get_context("spawn"), initializer=_start, initargs=(source, golden)
    ) as pool:

        def processes() -> None:
            for done in [pool.submit(_several) for _ in range(WORKERS)]:
                done.result()

        ways: dict[str, tuple[Callable[[], object], int]] = {
            "1 thread": (lambda: draw(1), 1),
            "2 threads": (lambda: draw(WORKERS), 1),
            "2 processes": (processes, WORKERS * _TOGETHER),
        }
        for turn in range(repeats + 1):
            for name, (work, populations) in ways.items():
                before, start = _waits(), time.perf_counter()
                work()
                taken, slept = time.perf_counter() - start, _waits() - before
                if turn:  # the first is for nothing
                    seconds[name].append(taken / (populations * count))
                    waits[name].append(slept)
    each = {name: 1e3 * float(np.median(values)) for name, values in seconds.items()}
    rows: list[dict[str, Any]] = [
        {"way": name, "ms a candidate": value, "times as fast as one thread": each["1 thread"] / value}
        for name, value in each.items()
    ]
    sleeps = float(np.median(waits["2 threads"]))
    lost = 1e3 * count * (each["2 threads"] - each["2 processes"])
    return {
        "cores": rows,
        "two threads": [
            {
                "waits a population": sleeps,
                "us lost a population": lost,
                "us lost a wait, both threads": WORKERS * lost / max(sleeps, 1),
            }
        ],
    }
