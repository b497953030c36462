"""Estimate the frames of a session that have no result yet; write each result, and at the end tables and page."""

from __future__ import annotations

import functools
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, closing
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from dvrk_cmaes.config import TrustConfig
from dvrk_cmaes.errors import InputError
from dvrk_cmaes.export.pose_texts import table_text
from dvrk_cmaes.frames.frame import FrameFiles
from dvrk_cmaes.io.json_file import write_json, write_text
from dvrk_cmaes.io.output import Output, output, remove
from dvrk_cmaes.io.short_text import in_order
from dvrk_cmaes.joints.prior import commanded_in, describe_commanded, with_commanded
from dvrk_cmaes.pose.config_check import check_config
from dvrk_cmaes.results.folder import SUMMARY, ResultsFolder, check_output, read_results
from dvrk_cmaes.results.pose_rows import pose_rows
from dvrk_cmaes.results.result import Result, Status
from dvrk_cmaes.runs.agreement import compare_bases, expected_elsewhere
from dvrk_cmaes.runs.backgrounds import by_view, with_backgrounds
from dvrk_cmaes.runs.frame import (
    ArmInSession,
    FrameOutcome,
    failed_outcome,
    relative_text,
    run_task,
    shared,
    write_outcome,
)
from dvrk_cmaes.runs.manifest import (
    COMMAND,
    POSES,
    TABLES,
    check_same_frames,
    check_same_settings,
    chosen_frames,
    earlier_results,
    manifest_of,
    read_manifest,
    results_of,
)
from dvrk_cmaes.runs.pool import Executors, WorkerDied, Workers, pool_of, usable_cores
from dvrk_cmaes.runs.pool import run as run_tasks
from dvrk_cmaes.runs.summary import summarize
from dvrk_cmaes.segment.segmentation import SegmentSettings


@dataclass(frozen=True, eq=False)
class BatchSummary:
    """Summary of a batch run.

    ``ran`` is the number of frames estimated by this run. ``document`` is the content of summary.json, ``results`` are
    all results in the folder by frame.
    """

    ran: int
    interrupted: bool
    document: dict[str, Any]
    results: dict[str, Result]


def run_batch(
    arm: ArmInSession, out: str | Path, *, workers: Workers, pattern: str | None = None, resume: bool = True
) -> BatchSummary:
    """Estimate the frames of an arm that have no result in a folder yet, and write results, tables and page.

    The results do not depend on workers, executor or order, but where masks are found in images those of frames that do
    not agree with most others depend on these. Worker processes are spawned, so a script that calls this function must
    do so below ``if __name__ == "__main__":``.

    Parameters
    ----------
    arm
        The arm. The workers must find the session's files under the same paths; the threads are those of each worker.
    out
        Folder of the results.
    workers
        What estimates the frames.
    pattern
        Shell pattern (``*``, ``?``, ``[..]``) of the names of the frames to do.
    resume
        Keep the results that are there, but for failed ones. If False, all are removed first.

    Raises
    ------
    InputError
        The settings are invalid, files of these names cannot be written, or the folder has results of other inputs or
        settings.
    DvrkCmaesError
        Another batch is writing to the folder, the disk is full, or workers cannot be started or were lost.
    """
    out, session, method = Path(out), arm.session, arm.method
    check_config(method.config)
    names = arm.body.instrument.joint_names
    commanded = commanded_in([files.readings for files in session.frames], names)
    notes = (describe_commanded(commanded),) if commanded else ()
    local = functools.partial(relative_text, session.folder)
    noted = (
        replace(files, notes=(*map(local, files.notes), *notes), problem=files.problem and local(files.problem))
        for files in session.frames
    )
    frames = chosen_frames([*noted], pattern)
    for files in frames:
        check_output(out, files.name)
    masks = with_backgrounds(method.segment or SegmentSettings(), by_view(session.frames, session.rig))
    method = replace(method, config=with_commanded(method.config, commanded, names), segment=masks)
    arm = replace(arm, method=method)
    started = time.monotonic()
    with output(out, COMMAND) as own:
        if not resume:
            own.refuse((*TABLES, *results_of([files.name for files in frames], session.rig.names)))
            own.remove_stale()
            own.describe({})
        todo, kept = _prepare(out, own, arm, frames)
        if kept:
            workers.notice(f"results are there of {len(kept)} frames, {len(todo)} are to be done")
        for text in masks.notes:
            workers.notice(text)
        ran, statuses = 0, Counter[str](kept)
        workers.report(ran, len(todo))
        for outcome in outcomes(arm, todo, workers):
            write_outcome(out, outcome)
            ran += 1
            statuses[outcome.result.status] += 1
            workers.report(ran, len(todo), f", {statuses['doubtful']} doubtful, {statuses['failed']} failed")
        looked = not todo and (out / SUMMARY).is_file()  # which is written after that
        whole = ran == len(todo) and (looked or _look_again(out, arm, workers))
        finished = finish(out, (ran, time.monotonic() - started), method.config.trust)
    document, interrupted = finished.summary or {}, workers.stop.is_set() and not whole
    return BatchSummary(ran, interrupted, document, finished.frames)


def finish(out: str | Path, ran: tuple[int, float] = (0, 0.0), trust: TrustConfig | None = None) -> ResultsFolder:
    """Write the tables and the page of the results in a folder, and return these results with their new summary.

    Each result is parsed once. ``ran`` are the number of frames that were just estimated, and the time, s. Bases are
    compared by the limit of ``trust``, by default that of new settings.

    Raises
    ------
    InputError
        The folder has no results of a batch, or a result is damaged; the message has its path.
    """
    out = Path(out)
    manifest = read_manifest(out)
    if manifest is None:
        raise InputError(f"{out}: expected results of a batch, got none")
    results = ResultsFolder(out, {}, None, None)
    if any((out / "frames").glob("*.json")):
        results = read_results(out, summary=False)  # which is replaced
        limit = (trust or TrustConfig()).largest_base_deg
        results = replace(results, frames=compare_bases(out, results.frames, limit))
        write_text(out / POSES, table_text(pose_rows(results.frames.values())))
    results = replace(results, summary=summarize(results.frames, manifest, ran, results.session))
    write_json(out / SUMMARY, results.summary)
    if results.frames:
        from dvrk_cmaes.report.page import write_page

        write_page(out, results)
    return results


def _prepare(
    folder: Path, own: Output, arm: ArmInSession, frames: Sequence[FrameFiles]
) -> tuple[list[FrameFiles], list[Status]]:
    """Write the manifest, and return the frames to do and the statuses of the frames whose results are kept."""
    own.refuse(TABLES)
    session = [files.name for files in arm.session.frames]
    manifest, old = manifest_of(arm, frames), read_manifest(folder)
    digests = manifest["frames"]
    kept: dict[str, Status] = {}
    if old is not None:
        kept = earlier_results(folder, digests, session)
        if kept:
            check_same_settings(folder, old, manifest)
            check_same_frames(folder, old, digests, done=kept)
        manifest["frames"] = in_order({**old["frames"], **digests})
    todo = [files for files in frames if files.name not in kept]
    own.refuse(results_of([files.name for files in todo], arm.session.rig.names))
    own.describe(manifest)
    return todo, [kept[files.name] for files in frames if files.name in kept]


def _look_again(out: Path, arm: ArmInSession, workers: Workers) -> bool:
    """Find masks again in images that do not agree with most others, where these expect the tool; whether in all."""
    if all(files.has_mask for files in arm.session.frames):
        return True
    again = expected_elsewhere(arm, read_results(out, summary=False).frames, workers.notice)
    for name in results_of([files.name for files in again], arm.session.rig.names):
        remove(out / name)  # if the batch ends before it has others, it is resumed with these frames
    written = [write_outcome(out, outcome) for outcome in outcomes(arm, again, workers)]
    return len(written) == len(again)


def outcomes(arm: ArmInSession, todo: Sequence[FrameFiles], workers: Workers) -> Iterator[FrameOutcome]:
    """Yield the outcomes of frames in the order of completion, by the workers that are given or by its own."""
    given, stop = workers.executor, workers.stop
    call = functools.partial(run_task, *shared(arm))
    with ExitStack() as opened:
        if given is None:
            most = workers.count or max(1, usable_cores() // arm.method.config.threads)
            given = opened.enter_context(pool_of(min(most, len(todo))))
        used = given if isinstance(given, Executors) else Executors(given, lambda: 2 * usable_cores())
        done = run_tasks(used, todo, call, time_limit=workers.time_limit, stop=stop)
        for files, outcome in opened.enter_context(closing(done)):
            yield failed_outcome(arm, files, outcome.reason) if isinstance(outcome, WorkerDied) else outcome
