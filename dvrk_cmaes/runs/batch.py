"""Do the frames of a session that have no result yet, write each as it is done, then the tables and the page."""

from __future__ import annotations

import functools
import os
import threading
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from dvrk_cmaes.calibration.document import SessionCalibration
from dvrk_cmaes.config import EstimateConfig
from dvrk_cmaes.errors import InputError
from dvrk_cmaes.export.pose_table import pose_rows, table_text
from dvrk_cmaes.frames.frame import FrameFiles
from dvrk_cmaes.frames.session_folder import Session
from dvrk_cmaes.instrument import Instrument
from dvrk_cmaes.instrument.arm import Arm
from dvrk_cmaes.io.atomic import write_json, write_text
from dvrk_cmaes.pose.config_check import check_config
from dvrk_cmaes.results.folder import SUMMARY, read_results
from dvrk_cmaes.results.result import Status
from dvrk_cmaes.runs.digests import frame_digests
from dvrk_cmaes.runs.executor import Elsewhere, through_executor
from dvrk_cmaes.runs.manifest import (
    check_same_frames,
    check_same_settings,
    manifest_of,
    read_manifest,
    with_frames,
    write_manifest,
)
from dvrk_cmaes.runs.output import POSES, clear, locked, refuse_strangers, sweep, whole_results, write_outcome
from dvrk_cmaes.runs.processes import Died, through_processes
from dvrk_cmaes.runs.summary import RunTiming, summarize
from dvrk_cmaes.runs.worker import (
    BatchSetup,
    FrameOutcome,
    PackedSetup,
    failed_outcome,
    named_from,
    prepare_process,
    run_task,
)
from dvrk_cmaes.runs.worklist import Shard, check_names, chosen_frames, shards_folder
from dvrk_cmaes.segment.with_instrument import SegmentSettings

TIME_LIMIT = 600.0
"""Seconds after which a frame is given up, in our own processes."""


class Watcher:
    """Told how a batch gets on; this one does not care."""

    def begins(self, todo: int, kept: Sequence[Status]) -> None:
        """Hear how many frames are to be done, and the statuses of those that have a result already."""

    def done(self, outcome: FrameOutcome) -> None:
        """Hear of a frame that is done and written."""


@dataclass(frozen=True, eq=False)
class BatchSummary:
    """How a batch ended.

    ``folder`` has the results; ``counts`` are of all its frames, by status and ``missing``; ``ran`` frames were done
    by this run. ``document`` is that of summary.json.
    """

    folder: Path
    counts: dict[str, int]
    ran: int
    interrupted: bool
    document: dict[str, Any]


def run_batch(
    session: Session,
    out: str | Path,
    instrument: Instrument,
    *,
    config: EstimateConfig | None = None,
    arm: Arm = "classic",
    segment: SegmentSettings | None = None,
    calibration: SessionCalibration | None = None,
    threads: int = 1,
    pattern: str | None = None,
    shard: Shard | None = None,
    resume: bool = True,
    retry_failed: bool = False,
    workers: int | None = None,
    executor: Executor | Elsewhere | None = None,
    time_limit: float = TIME_LIMIT,
    stop: threading.Event | None = None,
    watcher: Watcher | None = None,
) -> BatchSummary:
    """Estimate the frames of a session that have no result in a folder yet, and write results, tables and page.

    What comes out does not depend on workers, shards, executor or order. Processes are started by `spawn`: a script
    that calls this needs ``if __name__ == "__main__":``.

    Parameters
    ----------
    session, instrument
        What was read of them. Where the workers run, the session's files must lie under the same paths.
    out
        Folder of the results.
    config, arm
        As in `estimate`; of the configuration, ``threads`` is replaced by the argument.
    segment
        How frames without a mask get one.
    calibration
        Start frames from what their session says.
    threads
        Of each worker.
    pattern
        A shell's pattern of the frames' names.
    shard
        Do this part only, in a folder of its own below ``out``, for ``merge_shards``; no tables then.
    resume
        Keep the results that are there; otherwise they are removed first.
    retry_failed
        Do frames again that failed.
    workers
        Processes of our own; as many as there are cores for, unless given.
    executor
        Somebody else's workers instead.
    time_limit
        Seconds after which a frame in a process of our own is given up.
    stop
        Once it is set, the frames that are running are finished, and no more are begun.
    watcher
        Told of each frame.

    Raises
    ------
    InputError
        Settings that make no sense, names that cannot be written, or results there that were made from something else.
    DvrkCmaesError
        Another batch is at the folder, the disk is full, or workers cannot be had.
    """
    stop, watcher, out = stop or threading.Event(), watcher or Watcher(), Path(out)
    settings = replace(EstimateConfig() if config is None else config, threads=threads)
    check_config(settings)
    folder = out if shard is None else shard.folder(out)
    chosen = chosen_frames([_from_anywhere(files, session.folder) for files in session.frames], pattern)
    frames = chosen if shard is None else shard.part(chosen)
    check_names(folder, chosen)
    home = Path(os.path.abspath(session.folder))
    if any(files.mask is None for files in frames) and Path(os.path.abspath(out)) == home:
        raise InputError(f"{out}: expected another folder than the session's, for the masks found in its images")
    setup = BatchSetup(instrument, session.camera, settings, arm, home, segment or SegmentSettings(), calibration)
    started = time.monotonic()
    with locked(folder):
        if resume:
            refuse_strangers(folder)
        else:
            clear(folder)
        sweep(folder)
        todo, kept = _prepare(
            folder,
            None if shard is None else out,
            setup,
            frames,
            others=[files.name for files in chosen],
            session=[files.name for files in session.frames],
            retry_failed=retry_failed,
        )
        watcher.begins(len(todo), kept)
        ran = 0
        for outcome in _outcomes(setup, todo, workers, executor, time_limit, stop):
            write_outcome(folder, outcome)
            ran += 1
            watcher.done(outcome)
        seconds = time.monotonic() - started
        timing = RunTiming(ran, round(seconds, 3), round(ran / seconds, 4)) if ran else None
        document = finish(out, timing) if shard is None else _summary(folder, timing, whole=False)
    return BatchSummary(folder, document["counts"], ran, stop.is_set() and ran < len(todo), document)


def finish(out: str | Path, timing: RunTiming | None = None) -> dict[str, Any]:
    """Write the tables and the page of the results that are there, and return the summary.

    Raises
    ------
    InputError
        No batch was run there, or a result is damaged, naming it.
    """
    out = Path(out)
    document = _summary(out, timing)
    if document["frames"]:
        results = read_results(out).frames
        write_text(out / POSES, table_text(pose_rows(results.values())))
    write_json(out / SUMMARY, document)
    if document["frames"]:
        from dvrk_cmaes.report.page import write_page

        write_page(out)
    return document


def _summary(folder: Path, timing: RunTiming | None, *, whole: bool = True) -> dict[str, Any]:
    manifest = read_manifest(folder)
    if manifest is None:
        raise InputError(f"{folder}: expected results of a batch, got none")
    there = any((folder / "frames").glob("*.json"))
    return summarize(read_results(folder).frames if there else {}, manifest, timing, whole=whole)


def _prepare(
    folder: Path,
    merged: Path | None,
    setup: BatchSetup,
    frames: Sequence[FrameFiles],
    *,
    others: Sequence[str],
    session: Sequence[str],
    retry_failed: bool,
) -> tuple[list[FrameFiles], list[Status]]:
    """Find what is to be done, write down what it is made from, and return it with the statuses of what is kept.

    ``merged`` is the folder where a shard's frames may have results from before; ``others`` are the frames of all
    shards.
    """
    if merged is None and shards_folder(folder).is_dir():
        raise InputError(f"{folder}: it has shards that are not merged; run dvrk-cmaes batch --merge {folder} first")
    digests = dict.fromkeys(others) | {files.name: frame_digests(files) for files in frames}
    manifest = manifest_of(setup, digests)
    kept: dict[str, Status] = {}
    for place in (folder, *([] if merged is None else [merged])):
        old = read_manifest(place)
        if old is None:
            continue
        check_same_settings(place, old, manifest)
        there = {name: s for name, s in whole_results(place).items() if not (retry_failed and s == "failed")}
        check_same_frames(place, old, digests, done=there, session=session)
        kept |= there
        if place == folder:
            manifest = with_frames(old, digests)
    write_manifest(folder, manifest)
    return [files for files in frames if files.name not in kept], [kept[f.name] for f in frames if f.name in kept]


def _outcomes(
    setup: BatchSetup,
    todo: Sequence[FrameFiles],
    workers: int | None,
    executor: Executor | Elsewhere | None,
    time_limit: float,
    stop: threading.Event,
) -> Iterator[FrameOutcome]:
    """Outcomes of frames as they are done."""
    if not todo:
        return
    packed = PackedSetup.of(setup)
    call = functools.partial(run_task, packed)
    if executor is None:
        most = workers or max(1, usable_cores() // setup.config.threads)
        done = through_processes(
            todo,
            call,
            start=functools.partial(prepare_process, packed),
            workers=min(most, len(todo)),
            time_limit=time_limit,
            stop=stop,
        )
    else:
        elsewhere = executor if isinstance(executor, Elsewhere) else Elsewhere(executor, lambda: 2 * usable_cores())
        done = through_executor(todo, call, elsewhere=elsewhere, stop=stop)
    for files, outcome in done:
        yield failed_outcome(setup, files, outcome.reason) if isinstance(outcome, Died) else outcome


def usable_cores() -> int:
    """Count the cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _from_anywhere(files: FrameFiles, folder: Path) -> FrameFiles:
    """Name a frame's files so that any process finds them, and in words from the session's folder."""
    mask, image, ignore = (
        None if path is None else Path(os.path.abspath(path)) for path in (files.mask, files.image, files.ignore)
    )
    notes = tuple(named_from(folder, note) for note in files.notes)
    problem = None if files.problem is None else named_from(folder, files.problem)
    return replace(files, mask=mask, image=image, ignore=ignore, notes=notes, problem=problem)
