"""Frames a second of a folder against the number of workers, and memory over time.

    python scripts/bench.py folder --frames 1000 --workers 1 2

The frames are those of --session, repeated. Memory is the resident set, in MB, of the largest worker and of the parent
process, after the first 100 frames and at the end. Rates are given from the first result to the last, and for the whole
run. With --page, the time that Chromium takes to load the page is the median of five. With --results, the page of that
folder's results, repeated, is measured alone:

    python scripts/bench.py folder --results RESULTS --frames 1000
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import numpy as np
import psutil

from dvrk_cmaes.config import EstimateConfig
from dvrk_cmaes.frames.session_folder import read_session
from dvrk_cmaes.instrument import Instrument, load_instrument
from dvrk_cmaes.io.toml_file import read_config
from dvrk_cmaes.report.page import write_page
from dvrk_cmaes.results.result import Status
from dvrk_cmaes.runs.batch import BatchProgress, Workers, run_batch
from dvrk_cmaes.runs.worker import FrameOutcome
from measure.bench.many_frames import repeated_results, repeated_session, small_session
from measure.bench.page import chromium, load
from measure.places import SHARED
from measure.tables import Report

SETTLED: Final = 100  # frames after which memory should be constant
_LOADS: Final = 5
_AROUND: Final = 10  # samples whose median is taken, since single ones scatter


@dataclass
class Memory(BatchProgress):
    """Samples of time and memory, one for each frame: (seconds, MB of the largest worker, MB of the parent)."""

    started: float = 0.0
    samples: list[tuple[float, float, float]] = field(default_factory=list)

    def on_start(self, todo: int, kept: Sequence[Status]) -> None:
        """Start the clock."""
        self.started = time.perf_counter()

    def on_frame(self, outcome: FrameOutcome) -> None:
        """Take a sample."""
        parent = psutil.Process()
        workers = []
        for child in parent.children():
            try:
                workers.append(child.memory_info().rss)
            except psutil.Error:  # the process has just ended
                continue
        seconds = time.perf_counter() - self.started
        self.samples.append((seconds, max(workers, default=0) / 1e6, parent.memory_info().rss / 1e6))


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    parser.add_argument("--session", type=Path, default=SHARED / "frames" / "made" / "medium", help="session")
    parser.add_argument("--frames", type=int, default=1000, metavar="N", help="number of frames (default: %(default)s)")
    parser.add_argument(
        "--workers", type=int, nargs="+", default=[1, 2], metavar="N", help="numbers of workers (default: 1 2)"
    )
    parser.add_argument("--config", type=Path, metavar="TOML", help="settings of the estimates")
    parser.add_argument("--shrink", type=int, default=1, metavar="N", help="masks at 1 / N of their size")
    parser.add_argument("--results", type=Path, metavar="DIR", help="results of batch, whose page alone is measured")
    parser.add_argument("--page", action="store_true", help="load the page in Chromium, too")


def folder_report(options: argparse.Namespace) -> Report:
    """Measure each number of workers, or the page alone, and return a row for each."""
    instrument = load_instrument(options.instrument)
    config = EstimateConfig() if options.config is None else read_config(options.config, EstimateConfig())
    with tempfile.TemporaryDirectory() as place:
        if options.results is not None:
            return {"page of results": [_page_row(options.results, Path(place), options.frames)]}
        source = options.session
        if options.shrink > 1:
            source = small_session(source, Path(place, "small"), options.shrink)
        session = repeated_session(source, Path(place, "session"), options.frames)
        rows = [_measure(session, Path(place, f"out-{n}"), instrument, config, n) for n in options.workers]
        if options.page:
            rows[0] |= _page_load(Path(place, f"out-{options.workers[0]}", "report.html"), Path(place, "profile"))
    for row in rows:
        row["times one worker's rate"] = round(row["frames a second"] / rows[0]["frames a second"], 3)
    return {"a folder": rows}


def _measure(session: Path, out: Path, instrument: Instrument, config: EstimateConfig, workers: int) -> dict[str, Any]:
    """Estimate a folder with a number of workers and return rates and memory."""
    memory = Memory()
    read = read_session(session, known=instrument.joint_names)
    done = run_batch(read, out, instrument, config=config, workers=Workers(workers, progress=memory))
    seconds, worker, parent = np.array(memory.samples).T
    early = min(SETTLED, len(seconds) // 2)
    row: dict[str, Any] = {
        "workers": workers,
        "frames": len(seconds),
        "failed": done.counts["failed"],
        "frames a second": round((len(seconds) - 1) / (seconds[-1] - seconds[0]), 3),
        "frames a second, with start and end": done.document["timing"]["run"]["frames_per_second"],
    }
    for name, series in (("worker", worker), ("parent", parent)):
        first, last = np.median(series[early : early + _AROUND]), np.median(series[-_AROUND:])
        row[f"{name} after {early} frames, MB"] = round(float(first), 1)
        row[f"{name} at the end, MB"] = round(float(last), 1)
        row[f"{name} grew, %"] = round(float(100 * (last / first - 1)), 2)
    row["page, MB"] = round((out / "report.html").stat().st_size / 1e6, 2)
    return row


def _page_row(results: Path, place: Path, frames: int) -> dict[str, Any]:
    """Write the page of repeated results, load it, and return its size and the times."""
    out = repeated_results(results, place / "out", frames)
    began = time.process_time()
    page = write_page(out)
    seconds = time.process_time() - began
    row = {"frames": frames, "page, MB": round(page.stat().st_size / 1e6, 2), "written, s CPU": round(seconds, 1)}
    return row | _page_load(page, place / "profile")


def _page_load(page: Path, profile: Path) -> dict[str, Any]:
    """Return the time that Chromium takes to load a page."""
    with chromium(profile) as browser:
        return {"page loaded, s": round(float(np.median([load(browser, page) for _ in range(_LOADS)])), 2)}
