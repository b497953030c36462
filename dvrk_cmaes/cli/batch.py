"""``dvrk-cmaes batch``: estimation of all frames of a session folder on processes or a cluster."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

from dvrk_cmaes.cli.options import (
    AUTO,
    DEFAULT_CAMERA,
    DEFAULT_INSTRUMENT,
    DEFAULT_METHOD,
    DEFAULT_PROMPTS,
    DEFAULT_READING,
    DEFAULT_SEGMENT,
    FOLDER,
    METHOD,
    MOST_WORKERS,
    OUTPUT,
    WORKERS,
    CameraOptions,
    DoubtfulSessionOption,
    Flag,
    InstrumentOptions,
    MethodOptions,
    PromptOptions,
    ReadingOptions,
    SegmentOptions,
    SessionOption,
    check_range,
    parse_pixel,
)
from dvrk_cmaes.cli.terminal import (
    DOUBTFUL,
    INTERRUPTED,
    STATUS_STYLES,
    Line,
    exit_code,
    frames_text,
    print_error,
    show,
    stopping_on_interrupt,
    warn,
)
from dvrk_cmaes.errors import InputError

if TYPE_CHECKING:
    from dvrk_cmaes.calibration.document import SessionCalibration
    from dvrk_cmaes.config import EstimateConfig
    from dvrk_cmaes.frames.label import Label
    from dvrk_cmaes.joints.lag import Lag
    from dvrk_cmaes.runs.batch import BatchSummary, Workers
    from dvrk_cmaes.runs.exchanged_tools import ArmInSession

_MOST_LISTED = 10
_LONGEST_FRAME = 1e6  # s, of --time-limit


def batch(
    session: Annotated[Path, Parameter(group=FOLDER)],
    /,
    *,
    out: Annotated[Path | None, Parameter(group=FOLDER)] = None,
    frames: Annotated[str | None, Parameter(group=FOLDER)] = None,
    resume: Annotated[bool, Parameter(group=FOLDER, negative="--overwrite")] = True,
    retry_failed: Annotated[Flag, Parameter(group=FOLDER)] = False,
    joints: Annotated[tuple[Path, ...], Parameter(group=FOLDER, negative=(), show_default=False)] = (),
    label: Annotated[str | None, Parameter(group=FOLDER)] = None,
    pick: Annotated[str | None, Parameter(group=FOLDER, allow_leading_hyphen=True)] = None,
    only: Annotated[tuple[str, ...], Parameter(group=FOLDER, negative=(), show_default=False)] = (),
    workers: Annotated[int | None, Parameter(group=WORKERS)] = None,
    scheduler: Annotated[str | None, Parameter(group=WORKERS)] = None,
    time_limit: Annotated[float, Parameter(group=WORKERS)] = 600.0,
    lag: Annotated[str | None, Parameter(group=METHOD, allow_leading_hyphen=True)] = None,
    calibration: SessionOption = None,
    doubtful_session: DoubtfulSessionOption = False,
    reading: ReadingOptions = DEFAULT_READING,
    camera: CameraOptions = DEFAULT_CAMERA,
    instrument: InstrumentOptions = DEFAULT_INSTRUMENT,
    method: MethodOptions = DEFAULT_METHOD,
    segment: SegmentOptions = DEFAULT_SEGMENT,
    prompts: PromptOptions = DEFAULT_PROMPTS,
    json: Annotated[Flag, Parameter(group=OUTPUT)] = False,
) -> int:
    """Estimate all frames of a session folder, and write a result and an overlay of each, tables and an HTML report.

    If the command is interrupted or killed, the same command continues with the missing frames. A frame that cannot be
    estimated gets a failed result with its reason, and the command continues with the other frames. Of several arms, a
    tool that is clearly in front of another one is solved again, with that one as background.

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
        ignore.
    out
        Folder for the results; SESSION/results by default.
    frames
        Estimate only the frames whose names match this shell pattern, e.g. "00*"; all frames by default.
    resume
        --resume keeps existing results, which must have been made from the same files with the same settings;
        --overwrite removes them first.
    retry_failed
        Estimate failed frames again.
    joints
        File of readings to use instead of the session's own, or none, to use none. May be given several times.
    label
        Part of masks of labels that is the instrument: a value (the index, in images with a palette), several such as
        10,20,30, a colour such as '#00ff00', or any, for all values but 0. They are in masks or else in labels.
    pick
        Pixel u,v on the instrument in all frames: use only the connected region of the mask, or of the label, there.
    only
        Arm of a session.toml with several tools: estimate this one only; by default all of them. May be given several
        times.
    workers
        Number of worker processes; by default the number of cores.
    scheduler
        Address of a Dask scheduler, e.g. tcp://head:8786: use its workers instead of local processes.
    time_limit
        Seconds after which a frame is stopped and marked as failed; for local processes only.
    lag
        Lag of the images behind the readings, in seconds or frames, such as 0.13 or 4frames: each frame gets the
        readings of that much earlier. By default, and with auto, it is that of --session; otherwise none is taken out.
    calibration
        A session.json written by `calibrate`, or the folder it wrote, which has one for each of several arms: start
        each frame from the pose that it predicts, and search globally only if that does not explain the mask.
    doubtful_session
        Use the session.json of --session even if it predicts frames badly that it has not seen.
    reading
        How files of readings are read.
    camera
        Camera to use instead of the session's own.
    instrument
        The instrument.
    method
        The method. Each worker uses one thread unless --threads is given.
    segment
        Segmentation of the images of frames without a mask.
    prompts
        Prompts for the segmentation of all frames without a mask and without a row in the session's boxes.csv.
    json
        Print only summary.json, on stdout.
    """
    if workers is not None and (workers < 1 or scheduler is not None):
        got = f"{workers}" if scheduler is None else "--scheduler too"
        raise InputError(f"--workers: expected a whole number of at least 1, and no --scheduler, got {got}")
    if not time_limit > 0:
        raise InputError(f"--time-limit: expected seconds above 0, got {time_limit:g}")
    check_range("--time-limit", time_limit, 0, _LONGEST_FRAME, "seconds")
    check_range("--workers", workers, 1, MOST_WORKERS)
    from dvrk_cmaes.frames.label import parse_label

    wanted = None if label is None else parse_label("--label", label)
    picked = None if pick is None else parse_pixel("pick", pick)
    if lag == AUTO and calibration is None:
        raise InputError("--lag: expected a number, or auto with --session (calibrate finds the lag), got auto alone")
    from dvrk_cmaes.cli.session_tools import output_folder, read_calibration_of, session_tools
    from dvrk_cmaes.joints.lag import Lag
    from dvrk_cmaes.runs.arms import write_arms
    from dvrk_cmaes.runs.batch import Workers
    from dvrk_cmaes.runs.exchanged_tools import FoundFrame, exchanged_arms

    given = lag if lag in (None, AUTO) else Lag.parse("--lag", str(lag))
    settings = replace(method.resolve(), threads=method.threads or 1)
    tools = session_tools(session, instrument, only)
    with output_folder(out, session, "results", "batch") as results:
        if len(tools) > 1 and calibration is not None and not calibration.is_dir():
            raise InputError(f"--session: expected the folder that calibrate wrote for all arms, got {calibration}")
        arms: dict[str, ArmInSession] = {}
        finished: dict[str, BatchSummary] = {}
        calibrations: dict[str, SessionCalibration | None] = {}
        for name, tool in tools.items():
            arm = tool.read(session, camera, joints=joints, reading=reading, labelled=wanted is not None)
            arms[name] = _with_masks_of(arm, wanted, picked, prompts)
            calibrations[name] = read_calibration_of(
                calibration, arms[name].body, instrument.arm, tool.tool.arm, doubtful=doubtful_session
            )
        options: dict[str, Any] = {"pattern": frames, "retry_failed": retry_failed, "resume": resume}
        options["segment"] = segment.resolve()
        at_work = Workers(workers, time_limit=time_limit)
        for name, arm in arms.items():
            finished[name] = done = _run(
                arm, results / name, settings, calibrations[name], scheduler, at_work, given, options
            )
            if done.interrupted:
                break
        exchanged: list[str] = []
        if len(finished) > 1 and not done.interrupted:
            exchanged = exchanged_arms(
                {
                    name: {frame: FoundFrame.of(result) for frame, result in summary.results.items()}
                    for name, summary in finished.items()
                }
            )
            for text in exchanged:
                warn(text)
        _report_all(finished, json)
        stopped = next((summary for summary in finished.values() if summary.interrupted), None)
        if stopped is not None:
            again = "the same command" if resume else "the same command without --overwrite"
            left = f"{stopped.counts['missing']} of {stopped.counts['frames']} frames are left"
            print_error(f"interrupted: {left}; {again} goes on from here")
            return INTERRUPTED
        if len(finished) > 1:
            write_arms(results, arms)
            if not json:
                show([Line(f"all arms: {results / 'overlays'}")])
        code = exit_code(frame["status"] for done in finished.values() for frame in done.document["frames"].values())
        return DOUBTFUL if exchanged and code == 0 else code


def _report_all(finished: Mapping[str, BatchSummary], json: bool) -> None:
    """Print the summaries of all arms."""
    from dvrk_cmaes.cli.session_tools import answer_by_arm
    from dvrk_cmaes.joints.commanded import describe_commanded

    documents = {name: done.document for name, done in finished.items()}
    lines = {name: _lines(done.document, done.folder) for name, done in finished.items()}
    answer_by_arm(documents, lines, json=json)
    for name, done in finished.items():
        commanded = done.document.get("commanded")
        texts = [*done.setup.rig.remarks, *([describe_commanded(commanded)] if commanded else [])]
        texts += done.document.get("rig_doubts", ())
        for text in texts:
            warn(text, name)


def _with_masks_of(
    arm: ArmInSession, label: Label | None, pick: tuple[float, float] | None, prompts: PromptOptions
) -> ArmInSession:
    """Return an arm's session with the label of the instrument in the masks, and prompts where there is no mask."""
    from dvrk_cmaes.frames.boxes import FramePrompts

    session = arm.session
    if label is not None:
        session = replace(session, frames=tuple(files.changed(label=label) for files in session.frames))
    if pick is not None:
        session = replace(session, frames=tuple(replace(files, pick=pick) for files in session.frames))
    if prompts != DEFAULT_PROMPTS:
        hints = prompts.resolve()
        session = session.with_prompts(FramePrompts(hints.box, tuple(hints.points), tuple(hints.not_points)))
    return replace(arm, session=session)


def _run(
    arm: ArmInSession,
    out: Path,
    settings: EstimateConfig,
    calibration: SessionCalibration | None,
    scheduler: str | None,
    workers: Workers,
    lag: Lag | str | None,
    options: Mapping[str, Any],
) -> BatchSummary:
    """Run the batch of an arm's session, with progress on stderr; ``options`` are arguments of `run_batch`."""
    from dvrk_cmaes.cli.batch_progress import progress
    from dvrk_cmaes.runs.batch import run_batch
    from dvrk_cmaes.runs.cluster import dask_executor

    if calibration is not None and lag in (None, AUTO):
        lag = calibration.applied_lag
    session = arm.session if lag is None or isinstance(lag, str) else arm.session.with_lag(lag)
    with ExitStack() as stack:
        executor = None if scheduler is None else stack.enter_context(dask_executor(scheduler, session.folder))
        stop, reporter = stack.enter_context(stopping_on_interrupt()), stack.enter_context(progress())
        workers = replace(workers, executor=executor, stop=stop, progress=reporter)
        return run_batch(
            session,
            out,
            arm.body.instrument,
            config=settings,
            arm=arm.kinematics,
            calibration=calibration,
            workers=workers,
            **options,
        )


def _lines(document: dict[str, Any], folder: Path) -> Iterator[Line]:
    """Yield the lines of a summary: doubtful and failed frames, counts, medians, rate, and the files written."""
    counts, medians, timing = document["counts"], document["medians"], document["timing"]
    for status in ("failed", "doubtful"):
        listed = [(name, frame["reasons"]) for name, frame in document["frames"].items() if frame["status"] == status]
        for name, reasons in listed[:_MOST_LISTED]:
            more = f" (and {len(reasons) - 1} more)" if len(reasons) > 1 else ""
            yield Line(f"{name}: {status}: {reasons[0]}{more}", STATUS_STYLES[status].removeprefix("bold "))
        if len(listed) > _MOST_LISTED:
            yield Line(f"... and {len(listed) - _MOST_LISTED} more that are {status}")
    words = [
        f"{counts[name]} {name}" for name in ("ok", "doubtful", "failed", "missing") if counts[name] or name == "ok"
    ]
    yield Line(f"{frames_text(counts['frames'])}: {', '.join(words)}", "bold")
    if medians["iou"] is not None:
        yield Line(f"medians: IoU {medians['iou']:.3f}, contour {medians['contour_px_median']:.1f} px")
    if timing["run"] is not None:
        run = timing["run"]
        yield Line(f"{frames_text(run['frames'])} in {run['seconds']:.1f} s, {run['frames_per_second']:.2f} a second")
    where = f"results: {folder / 'frames'}   overlays: {folder / 'overlays'}"
    yield Line(f"{where}   table: {folder / 'poses.csv'}   page: {folder / 'report.html'}")
