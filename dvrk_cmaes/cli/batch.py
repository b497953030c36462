"""``dvrk-cmaes batch``: estimation of all frames of a session folder on processes or a cluster."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

from dvrk_cmaes.cli.options import (
    FOLDER,
    OUTPUT,
    CalibrationOptions,
    Flag,
    Pixel,
    Processes,
    ReadingOptions,
    SegmentOptions,
    SessionOptions,
    check_range,
    options,
)
from dvrk_cmaes.cli.session_tools import (
    ArmReport,
    open_session,
    output_folder,
    pictures_at,
    reason_lines,
    report_arms,
)
from dvrk_cmaes.cli.terminal import (
    INTERRUPTED,
    Line,
    attended,
    exit_code,
    print_error,
)
from dvrk_cmaes.errors import InputError
from dvrk_cmaes.io.short_text import counted

if TYPE_CHECKING:
    from dvrk_cmaes.runs.batch import BatchSummary
    from dvrk_cmaes.runs.frame import ArmInSession

_LONGEST_FRAME = 1e6  # s, of --time-limit


@options(group=FOLDER)
class BatchOptions:
    """What is estimated, by what, and where results go.

    Parameters
    ----------
    out
        Folder for the results; SESSION/results by default.
    frames
        Estimate only the frames whose names match this shell pattern, e.g. "00*"; all frames by default.
    resume
        --resume, as by default, keeps existing results but those of failed frames; they must have been made from the
        same files with the same settings. --overwrite removes all first.
    joints
        File of readings to use instead of the session's own, or none, to use none. May be given several times.
    label
        Part of masks of labels that is the instrument: a value (the index, in images with a palette), several such as
        10,20,30, a colour such as '#00ff00', or any, for all values but 0. They are in masks or else in labels.
    pick
        Pixel u,v on the instrument in all frames: use only the connected region of the mask, or of the label, there.
    workers
        Number of worker processes; by default the number of cores.
    scheduler
        Address of a Dask scheduler, e.g. tcp://head:8786: use its workers instead of local processes.
    time_limit
        Seconds after which a frame is stopped and marked as failed; for local processes only.
    lag
        Lag of the images behind the readings, in seconds or frames, such as 0.13 or 4frames, or 0: each frame gets the
        readings of that much earlier. By default it is that of --session; otherwise none is taken out.
    """

    out: Path | None = None
    frames: str | None = None
    resume: Annotated[bool, Parameter(negative="--overwrite", show_default=False)] = True
    joints: Annotated[tuple[Path, ...], Parameter(negative=(), show_default=False)] = ()
    label: str | None = None
    pick: Pixel = None
    workers: Processes = None
    scheduler: str | None = None
    time_limit: float = 600.0
    lag: Annotated[str | None, Parameter(allow_leading_hyphen=True)] = None

    def check(self) -> None:
        """Raise an InputError for values that are not valid, or do not fit together."""
        if self.workers is not None and self.scheduler is not None:
            raise InputError("--workers: expected no --scheduler with it, got both")
        check_range("--time-limit", self.time_limit, 1e-3, _LONGEST_FRAME, "seconds")

    def asked(self, arm: ArmInSession, prompts: SegmentOptions) -> ArmInSession:
        """Return an arm with what is asked of its masks, of the images without one, and of the lag."""
        from dvrk_cmaes.frames.label import parse_label
        from dvrk_cmaes.joints.lag import Lag

        session, method = arm.session, replace(arm.method, segment=prompts.resolve())
        if self.label is not None:
            label = parse_label("--label", self.label)
            session = replace(session, frames=tuple(files.changed(label=label) for files in session.frames))
        if self.pick is not None:
            session = replace(session, frames=tuple(replace(files, pick=self.pick) for files in session.frames))
        if any((prompts.box, prompts.point, prompts.not_point)):
            session = session.with_prompts(prompts.hints())
        lag = None if method.session is None else method.session.applied_lag
        lag = lag if self.lag is None else Lag.parse("--lag", self.lag)
        return replace(arm, session=session if lag is None else session.with_lag(lag), method=method)


def batch(
    session: Annotated[Path, Parameter(group=FOLDER)],
    /,
    *,
    wanted: BatchOptions = BatchOptions(),
    calibrated: CalibrationOptions = CalibrationOptions(),
    reading: ReadingOptions = ReadingOptions(),
    given: SessionOptions = SessionOptions(),
    segment: SegmentOptions = SegmentOptions(),
    json: Annotated[Flag, Parameter(group=OUTPUT)] = False,
) -> int:
    """Estimate all frames of a session folder, and write a result and an overlay of each, tables and an HTML report.

    If the command is interrupted or killed, the same command continues with the missing frames. A frame that cannot be
    estimated gets a failed result with its reason, and the command continues with the other frames.

    Exit codes: 0 all ok, 1 the work could not be done, or every frame failed, 2 wrong usage or input, 3 finished, but a
    frame is doubtful or failed, 130 interrupted.

    Example:

    ```
    dvrk-cmaes batch session --out results
    ```

    On a Dask cluster:

    ```
    dvrk-cmaes batch session --out results --scheduler tcp://head:8786
    ```

    Parameters
    ----------
    session
        Session folder: camera.yaml, joints.csv, masks/FRAME.png (or images/FRAME.png alone), and optionally images and
        ignore. Or a folder of pictures, one picture of it, or a pattern in quotes, such as "pictures/*.jpg".
    wanted
        What is estimated, by what, and where results go.
    calibrated
        A calibration that is used: each frame starts from the pose that it predicts, and is searched globally only if
        that does not explain the mask.
    reading
        How files of readings are read.
    given
        Arms, camera, instrument and settings. Each worker uses one thread unless the settings file says otherwise.
    segment
        Segmentation of the images of frames without a mask, with prompts for those without a row in boxes.csv.
    json
        Print only summary.json, on stdout.
    """
    from dvrk_cmaes.frames.session_folder import labels_of
    from dvrk_cmaes.runs.batch import run_batch
    from dvrk_cmaes.runs.cluster import dask_executor

    wanted.check()
    session, pictures = pictures_at(session if wanted.scheduler is None else session.absolute())
    with output_folder(wanted.out, session, "results", "batch") as results:
        masks = None if wanted.label is None else labels_of(session)
        read = open_session(session, given, calibrated, joints=wanted.joints, reading=reading, masks=masks)
        arms = {name: wanted.asked(arm, segment) for name, arm in read.items()}
        finished: dict[str, BatchSummary] = {}
        pattern, resume = wanted.frames or pictures, wanted.resume
        with ExitStack() as stack:
            address, count, limit = wanted.scheduler, wanted.workers, wanted.time_limit
            cluster = None if address is None else stack.enter_context(dask_executor(address, session))
            by = stack.enter_context(attended(count=count, time_limit=limit, executor=cluster))
            for name, arm in arms.items():
                done = run_batch(arm, results / name, pattern=pattern, resume=resume, workers=by)
                finished[name] = done
                if done.interrupted:
                    break
        reports = {name: _report_of(arms[name], each, results / name) for name, each in finished.items()}
        code = report_arms(reports, results, {}, json=json)
    if not done.interrupted:
        return code
    again = "the same command" if wanted.resume else "the same command without --overwrite"
    counts = done.document["counts"]
    print_error(f"interrupted: {counts['missing']} of {counts['frames']} frames are left; {again} goes on from here")
    return INTERRUPTED


def _report_of(arm: ArmInSession, done: BatchSummary, out: Path) -> ArmReport:
    """Return what is said of an arm; one that was interrupted is not compared with others."""
    from dvrk_cmaes.joints.prior import describe_commanded

    commanded, results = done.document.get("commanded"), done.results
    warnings = [*arm.session.rig.remarks, *([describe_commanded(commanded)] if commanded else [])]
    warnings += done.document.get("rig_doubts", ())
    code = exit_code(result.status for result in results.values())
    return ArmReport(done.document, _lines(done.document, out), warnings, code, {} if done.interrupted else results)


def _lines(document: dict[str, Any], folder: Path) -> Iterator[Line]:
    """Yield the lines of a summary: doubtful and failed frames, counts, medians, rate, and the files written."""
    counts, medians, timing = document["counts"], document["medians"], document["timing"]
    yield from reason_lines({name: frame["reasons"] for name, frame in document["frames"].items()})
    words = [
        f"{counts[name]} {name}" for name in ("ok", "doubtful", "failed", "missing") if counts[name] or name == "ok"
    ]
    yield Line(f"{counted(counts['frames'], 'frame')}: {', '.join(words)}", "bold")
    if medians["iou"] is not None:
        yield Line(f"medians: IoU {medians['iou']:.3f}, contour {medians['contour_px_median']:.1f} px")
    if (run := timing["run"]) is not None:
        rate = f"{run['frames_per_second']:.2f} a second"
        yield Line(f"{counted(run['frames'], 'frame')} in {run['seconds']:.1f} s, {rate}")
    where = f"results: {folder / 'frames'}   overlays: {folder / 'overlays'}"
    yield Line(f"{where}   table: {folder / 'poses.csv'}   page: {folder / 'report.html'}")
