"""Frames a second of a whole folder against the number of workers, and memory over time.

    python scripts/bench_folder.py --frames 1000 --workers 1 2

Run by hand, on a quiet machine. Frames are those of --session over and over. Memory is the workers' largest and the
parent's resident set, in MB, after the first 100 frames and at the end; rates are from the first result to the last,
and the whole run's. --json prints numbers for programs.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import numpy as np
import psutil
from many_frames import multiplied_session

from dvrk_cmaes.config import EstimateConfig
from dvrk_cmaes.errors import DvrkCmaesError
from dvrk_cmaes.frames.session_folder import read_session
from dvrk_cmaes.instrument import Instrument, load_instrument
from dvrk_cmaes.io.toml_file import read_config
from dvrk_cmaes.results.result import Status
from dvrk_cmaes.runs.batch import Watcher, run_batch
from dvrk_cmaes.runs.worker import FrameOutcome

SHARED: Final = Path(__file__).resolve().parents[2] / "shared"
SETTLED: Final = 100  # frames, after which memory should not grow
_AROUND: Final = 10  # frames whose median is taken: single samples waver


@dataclass
class Memory(Watcher):
    """Samples of time and memory, one a frame: (seconds, largest worker's MB, parent's MB)."""

    began: float = 0.0
    samples: list[tuple[float, float, float]] = field(default_factory=list)

    def begins(self, todo: int, kept: Sequence[Status]) -> None:
        """Start the clock."""
        self.began = time.perf_counter()

    def done(self, outcome: FrameOutcome) -> None:
        """Take a sample."""
        parent = psutil.Process()
        workers = []
        for child in parent.children():
            try:
                workers.append(child.memory_info().rss)
            except psutil.Error:  # It has just ended.
                continue
        seconds = time.perf_counter() - self.began
        self.samples.append((seconds, max(workers, default=0) / 1e6, parent.memory_info().rss / 1e6))


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--session", type=Path, default=SHARED / "frames" / "made" / "medium")
    parser.add_argument("--instrument", default=str(SHARED / "instruments" / "lnd_400006" / "lnd_400006.urdf"))
    parser.add_argument("--frames", type=int, default=1000)
    parser.add_argument("--workers", type=int, nargs="+", default=[1, 2])
    parser.add_argument("--config", type=Path, help="settings (TOML)")
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    try:
        instrument = load_instrument(arguments.instrument)
        config = EstimateConfig() if arguments.config is None else read_config(arguments.config, EstimateConfig())
        with tempfile.TemporaryDirectory() as place:
            session = multiplied_session(arguments.session, Path(place, "session"), arguments.frames)
            rows = [_measure(session, Path(place, f"out-{n}"), instrument, config, n) for n in arguments.workers]
    except DvrkCmaesError as error:
        print(f"bench_folder.py: {error}", file=sys.stderr)
        return error.exit_code
    for row in rows:
        row["times one worker's rate"] = round(row["frames a second"] / rows[0]["frames a second"], 3)
    if arguments.json:
        print(json.dumps(rows, indent=1))
        return 0
    for row in rows:
        print("\n".join(f"{name:<36s} {value}" for name, value in row.items()), end="\n\n")
    return 0


def _measure(session: Path, out: Path, instrument: Instrument, config: EstimateConfig, workers: int) -> dict[str, Any]:
    """Run a whole folder."""
    memory = Memory()
    read = read_session(session, known=instrument.joint_names)
    done = run_batch(read, out, instrument, config=config, workers=workers, watcher=memory)
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
    return row


if __name__ == "__main__":
    sys.exit(main())
