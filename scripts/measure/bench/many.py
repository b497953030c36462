"""How the calibration of a session grows with its frames, after `batch`, with all files written.

    python scripts/bench.py many SESSION --results RESULTS --frames 100 200 400 600 --workers 2

The frames are those of SESSION that have a result in RESULTS, a folder of `batch`, in their order and repeated. Seconds
are from the start of the workers to the page; the processor time of the parent and that of all workers are beside them.
With --lag, the search for the lag between images and readings, which is a part of the parent's work, is measured alone.
"""

from __future__ import annotations

import argparse
import itertools
import resource
import sys
import tempfile
import time
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from dvrk_cmaes.calibration.calibrate import find_lag
from dvrk_cmaes.calibration.frame_task import SessionFrame
from dvrk_cmaes.calibration.together import solved_alone
from dvrk_cmaes.config import EstimateConfig
from dvrk_cmaes.frames.frame import read_frame
from dvrk_cmaes.frames.session_folder import read_session
from dvrk_cmaes.instrument import Instrument, load_instrument
from dvrk_cmaes.results.folder import read_results
from dvrk_cmaes.runs.calibrate_folder import solving_folder
from dvrk_cmaes.runs.exchanged_tools import ArmInSession
from dvrk_cmaes.runs.instrument_processes import instrument_processes
from dvrk_cmaes.silhouette.prepare import prepare
from measure.bench.many_frames import repeated_results, repeated_session
from measure.tables import Report


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    parser.add_argument("session", type=Path, help="session")
    parser.add_argument("--results", type=Path, required=True, metavar="DIR", help="results of batch")
    parser.add_argument("--frames", type=int, nargs="+", default=[100, 200, 400, 600], metavar="N", help="frames")
    parser.add_argument("--workers", type=int, default=2, metavar="N", help="workers (default: %(default)s)")
    parser.add_argument("--lag", action="store_true", help="measure the search for the lag alone")
    parser.add_argument("--stages", action="store_true", help="print the seconds of each stage, too")


def many_report(options: argparse.Namespace) -> Report:
    """Measure each number of frames, and return a row for each; those that are known go to stderr, too."""
    instrument = load_instrument(options.instrument)
    rows, stages = [], []
    for frames in options.frames:
        if options.lag:
            rows.append(_measure_lag(options.session, options.results, instrument, frames))
        else:
            row = _measure(options.session, options.results, instrument, frames, options.workers)
            stages.append({"frames": frames, **row.pop("stages")})
            rows.append(row)
        print(rows[-1], file=sys.stderr, flush=True)
    return {"calibrate": rows} | ({"stages, seconds": stages} if options.stages and not options.lag else {})


def _measure(source: Path, results: Path, instrument: Instrument, frames: int, workers: int) -> dict[str, Any]:
    """Calibrate a session of repeated frames, and return its times, memory and the size of its page."""
    with tempfile.TemporaryDirectory() as place:
        known = read_results(results).frames
        folder = repeated_session(source, Path(place, "session"), frames, [*known])
        alone = repeated_results(results, Path(place, "results"), frames)
        session = read_session(folder, known=instrument.joint_names)
        began, processor = time.perf_counter(), _processor()
        stages = {"reading, lag and consensus": began}
        out = Path(place, "out")
        with instrument_processes(instrument, workers, session.frames) as processes:
            solving = solving_folder(
                ArmInSession(session, prepare(instrument), "classic"),
                read_results(alone).frames,
                out,
                processes,
                alone=alone,
                config=EstimateConfig(),
                progress=lambda stage, _: stages.__setitem__(stage, time.perf_counter()),
            )
            solved = solved_alone(solving)
        ended, used = time.perf_counter(), _processor()
        ends = [*list(stages.values())[1:], ended]
        return {
            "frames": frames,
            "used": len(solved.calibration.frames),
            "seconds": round(ended - began, 1),
            "processor s, parent": round(used[0] - processor[0], 1),
            "processor s, workers": round(used[1] - processor[1], 1),
            "parent's peak, MB": round(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3),
            "page, MB": round((out / "report.html").stat().st_size / 1e6, 2),
            "stages": {name: round(end - start, 1) for (name, start), end in zip(stages.items(), ends, strict=True)},
        }


def _measure_lag(source: Path, results: Path, instrument: Instrument, frames: int) -> dict[str, Any]:
    """Find the lag of a session of repeated frames, and return the processor time."""
    known = read_results(results).frames
    with tempfile.TemporaryDirectory() as place:
        session = read_session(
            repeated_session(source, Path(place, "session"), frames, [*known]), known=instrument.joint_names
        )
        repeated = zip(session.frames, itertools.cycle(known.values()), strict=False)
        used = [
            SessionFrame(files.name, partial(read_frame, files, session.camera), replace(result, frame=files.name))
            for files, result in repeated
        ]
        began = time.process_time()
        lag, untold = find_lag(used, instrument, series=session.reading_series())
        seconds = round(time.process_time() - began, 2)
    return {"frames": frames, "processor s": seconds, "lag": untold if lag is None else lag.describe()}


def _processor() -> tuple[float, float]:
    """Return the processor seconds of this process, and of its processes that have ended."""
    used = (resource.getrusage(whose) for whose in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    own, ended = (one.ru_utime + one.ru_stime for one in used)
    return own, ended
