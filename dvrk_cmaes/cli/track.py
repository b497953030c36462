"""``dvrk-cmaes track``: an instrument followed through a recording."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from cyclopts import Parameter

from dvrk_cmaes.cli.options import (
    DEFAULT_CAMERA,
    DEFAULT_INSTRUMENT,
    DEFAULT_METHOD,
    DEFAULT_PROMPTS,
    DEFAULT_READING,
    FOLDER,
    MOST_SKIPPED,
    MOST_WORKERS,
    OUTPUT,
    CameraOptions,
    DoubtfulSessionOption,
    Flag,
    InstrumentOptions,
    MethodOptions,
    PromptOptions,
    ReadingOptions,
    SessionOption,
    check_range,
)
from dvrk_cmaes.cli.session_tools import answer_by_arm, output_folder, read_calibration_of, session_tools, write_bases
from dvrk_cmaes.cli.terminal import DOUBTFUL, INTERRUPTED, Line, frames_text, note, show, stopping_on_interrupt, warn
from dvrk_cmaes.cli.track_source import DEFAULT_VIDEO, Source, VideoOptions
from dvrk_cmaes.errors import InputError
from dvrk_cmaes.io.short_text import listed

if TYPE_CHECKING:
    from dvrk_cmaes.calibration.endoscope import Place
    from dvrk_cmaes.calibration.together import Solving
    from dvrk_cmaes.results.tracked import TrackResult
    from dvrk_cmaes.runs.exchanged_tools import ArmInSession
    from dvrk_cmaes.runs.track_folder import TrackSummary


AUTO = "auto"

_MOST_REASONS = 8
_REPORT_EVERY = 5.0  # s


def track(
    session: Annotated[Path, Parameter(group=FOLDER)],
    /,
    *,
    out: Annotated[Path | None, Parameter(group=FOLDER)] = None,
    every: Annotated[int, Parameter(group=FOLDER)] = 1,
    joints: Annotated[str | None, Parameter(group=FOLDER)] = None,
    only: Annotated[tuple[str, ...], Parameter(group=FOLDER, negative=(), show_default=False)] = (),
    lag: Annotated[str, Parameter(group=FOLDER, allow_leading_hyphen=True)] = AUTO,
    fps: Annotated[float, Parameter(group=FOLDER)] = 30.0,
    causal: Annotated[Flag, Parameter(group=FOLDER)] = False,
    workers: Annotated[int | None, Parameter(group=FOLDER)] = None,
    resume: Annotated[bool, Parameter(group=FOLDER, negative="--overwrite")] = True,
    video: Annotated[bool, Parameter(group=FOLDER)] = True,
    page: Annotated[bool, Parameter(group=FOLDER)] = True,
    rerun: Annotated[Path | None, Parameter(group=FOLDER)] = None,
    evidence: Annotated[Literal["masks", "images"] | None, Parameter(group=FOLDER)] = None,
    first_mask: Annotated[Path | None, Parameter(group=FOLDER)] = None,
    prompts: PromptOptions = DEFAULT_PROMPTS,
    recording: VideoOptions = DEFAULT_VIDEO,
    calibration: SessionOption = None,
    doubtful_session: DoubtfulSessionOption = False,
    reading: ReadingOptions = DEFAULT_READING,
    camera: CameraOptions = DEFAULT_CAMERA,
    instrument: InstrumentOptions = DEFAULT_INSTRUMENT,
    method: MethodOptions = DEFAULT_METHOD,
    json: Annotated[Flag, Parameter(group=OUTPUT)] = False,
) -> int:
    """Follow an instrument through the consecutive frames of a session or a video, by masks or images, and readings.

    Keyframes over the whole recording are solved together, as by `calibrate`, those of several arms in one problem;
    every frame is then fitted with what that solution and its neighbours expect. With --causal, and where keyframes
    cannot be solved, the first frame is solved as by `estimate`, the others start from what the readings did since the
    frame before, and keyframes are solved as they come: no result depends on later frames, and none is ok before
    keyframes tell the arm's base. The table [track] of the settings file configures that.

    Exit codes: 0 all ok, 1 the work could not be done, 2 wrong usage or input, 3 finished, but a frame is doubtful or
    lost, 130 interrupted; the same command then goes on after the keyframes, or begins anew with --causal.

    Without masks, those of the keyframes are found in their images, and those of all frames by the colours that the
    keyframes tell. With --causal, the instrument is segmented in the first frame alone; in the others its mask is found
    by colours, which are learned on the way.

    Example:

    ```
    dvrk-cmaes track session --out tracks
    ```

    ```
    dvrk-cmaes track session/video.mp4 --box 250,180,639,380 --out tracks
    ```

    Parameters
    ----------
    session
        Session folder, as for `batch`, with consecutive frames, whose images may be in its video.mp4. Or a video,
        beside camera.yaml and joints.csv. Or a ROS recording, which is converted to OUT/session as by `import`.
    out
        Folder for tracks.jsonl, tracks.csv, session.json, tracks.mp4 and report.html; SESSION/tracks by default, or
        tracks beside the recording. Those of several arms are in OUT/ARM, and a video, a page and arms.json, how their
        bases lie to each other, in OUT.
    every
        Follow only every N-th frame.
    joints
        File of readings to use instead of the session's own, or none: follow by masks alone.
    only
        Arm of a session.toml with several tools: follow this one only; by default all of them. May be given several
        times.
    lag
        Lag of the images behind the readings, in seconds or frames, such as 0.13 or 4frames. auto: that of --session,
        or found while following.
    fps
        Frames a second of a session whose images have no times.
    causal
        Follow from image to image: no frame's result uses later ones. So are recordings without readings, and those
        of which fewer than 12 keyframes are usable or agree.
    workers
        Number of processes that fit the frames; by default the number of cores. With --causal, threads that solve
        keyframes.
    resume
        --resume goes on after the keyframes of an interrupted run; --overwrite begins anew.
    video
        --no-video leaves out the overlay video.
    page
        --no-page leaves out report.html, the page with curves over time and pictures.
    rerun
        File .rrd for the Rerun viewer: images, masks, meshes, camera and joints on a timeline. Needs rerun-sdk (pip
        install '.[viewer]').
    evidence
        masks or images; by default the masks of frames that have one, and the images of the others.
    first_mask
        Mask of the first frame, if that has none.
    prompts
        Where the instrument is in the first image, if that has no mask: which of two tools is followed. By default
        what boxes.csv says of it.
    recording
        The video.
    calibration
        A session.json written by `calibrate` or by this command, or the folder that has one for each of several arms:
        it is used instead of the keyframes' solution. With --causal it is followed by from the first frame on.
    doubtful_session
        Use the session.json of --session even if it predicts frames badly that it has not seen.
    reading
        How files of readings are read.
    camera
        Camera to use instead of the session's own.
    instrument
        The instrument, and the arm that carries it.
    method
        The method of frames that are searched globally.
    json
        Print only the numbers of frames by status, as JSON, on stdout.
    """
    check_range("--every", every, 1, MOST_SKIPPED)
    check_range("--workers", workers, 1, MOST_WORKERS)
    if not (math.isfinite(fps) and fps > 0):
        raise InputError(f"--fps: expected frames a second above 0, got {fps:g}")
    check_range("--fps", fps, 1e-3, 1e6, "frames a second")
    if rerun is not None:
        from dvrk_cmaes.export.rerun_file import check_rerun

        check_rerun("--rerun", rerun)
    from dvrk_cmaes.calibration.together import solved_together
    from dvrk_cmaes.instrument.setup_joints import SETUP, read_setup_joints
    from dvrk_cmaes.joints.lag import Lag
    from dvrk_cmaes.results.track_files import VIDEO
    from dvrk_cmaes.runs.track_arms import exchanged_while_followed, write_track_arms
    from dvrk_cmaes.runs.track_folder import tracking_folder
    from dvrk_cmaes.runs.track_frames import TrackSettings, used_session, with_first_mask, with_increasing_times
    from dvrk_cmaes.runs.worker import hints_of
    from dvrk_cmaes.segment.segmentation import hints_within

    seconds = None if lag == AUTO else Lag.parse("--lag", lag).in_seconds(fps)
    with output_folder(out, session if session.is_dir() else session.parent, "tracks", "track") as target:
        readings = None if joints is None or joints == "none" else Path(joints)
        source = Source.of(session, evidence, target, camera=camera.camera, joints=readings)
        tools = session_tools(source.folder, instrument, only)
        if len(tools) > 1:
            of_one = {"--first-mask": first_mask, "--rerun": rerun, "--joints FILE": readings}
            _check_of_several(of_one, calibration, prompts)
        files = () if readings is None else (readings,)
        arms: dict[str, ArmInSession] = {}
        settings: dict[str, TrackSettings] = {}
        for name, tool in tools.items():
            own = None if joints == "none" else files
            arm = source.read(tool, camera, recording, joints=own, reading=reading, ahead=not causal)
            timed, doubled = with_increasing_times(arm.session)
            if doubled:
                warn(f"left out, for they have the time of the frame before: {listed(doubled)}")
            followed, used = used_session(timed, evidence)
            arms[name] = replace(arm, session=with_first_mask(followed, first_mask))
            settings[name] = TrackSettings(
                method.resolve(),
                arm.kinematics,
                read_calibration_of(calibration, arm.body, instrument.arm, tool.tool.arm, doubtful=doubtful_session),
                seconds,
                every,
                joints != "none",
                fps,
                causal,
                used,
                (hints_of(followed.frames[0]) if prompts == DEFAULT_PROMPTS else None)
                or hints_within(prompts.resolve(), followed.frames[0].crop),
                workers,
            )

        def tracking(name: str, places: Sequence[Place]) -> Solving[TrackSummary | None]:
            if stop.is_set() and name != next(iter(arms)):
                return None
            return (
                yield from tracking_folder(
                    arms[name].session,
                    target / name,
                    arms[name].body,
                    settings[name],
                    resume=resume,
                    video=video,
                    page=page,
                    rerun=rerun,
                    stop=stop,
                    progress=_progress(name),
                    notice=partial(_notice, name),
                    arm=name,
                    places=places,
                )
            )

        with stopping_on_interrupt() as stop:
            found = solved_together({name: partial(tracking, name) for name in arms})
        finished = {name: summary for name, summary in found.items() if summary is not None}
        interrupted = len(finished) < len(arms) or any(own.interrupted for own in finished.values())
        exchanged: list[str] = []
        agree, setup = True, read_setup_joints(source.folder / SETUP)
        if len(tools) > 1 and not interrupted:
            of_arms = {name: summary.readings for name, summary in finished.items()}
            seen = {
                name: replace(arm, session=replace(arm.session, frames=arm.session.frames[::every]))
                for name, arm in arms.items()
            }
            exchanged = exchanged_while_followed(target, of_arms)
            rate = next(iter(finished.values())).frames_a_second
            if video:
                write_track_arms(target, seen, rate)
            known = {name: own.calibration for name, own in finished.items() if own.calibration is not None}
            if len(known) == len(arms):
                agree = write_bases(known, setup, target, quiet=json)
        counts = {name: summary.counts for name, summary in finished.items()}
        lines = {name: _lines(own, target / name, page=page, rerun=rerun) for name, own in finished.items()}
        answer_by_arm(counts, lines, json=json)
        if len(tools) > 1 and video and not (interrupted or json):
            show([Line(f"all arms: {target / VIDEO}")])
        for name, summary in finished.items():
            told = () if summary.calibration is None else summary.calibration.warnings
            for text in dict.fromkeys((*arms[name].session.rig.remarks, *told)):
                warn(text, name)
        for text in exchanged:
            warn(text)
        if interrupted:
            return INTERRUPTED
        doubtful = exchanged or not agree or any(set(summary.counts) - {"ok"} for summary in finished.values())
        return DOUBTFUL if doubtful else 0


def _check_of_several(of_one: Mapping[str, Path | None], calibration: Path | None, prompts: PromptOptions) -> None:
    """Raise an InputError for an option that cannot hold for several arms; ``of_one`` are files of such options."""
    given = [name for name, path in of_one.items() if path is not None]
    if prompts != DEFAULT_PROMPTS:
        given.append("--box, --point, --not-point")
    if given:
        raise InputError(f"{given[0]}: expected one arm (--only ARM), got a session of several")
    if calibration is not None and not calibration.is_dir():
        raise InputError(f"--session: expected a folder with a session.json for each arm, got {calibration}")


def _notice(arm: str, text: str) -> None:
    """Print a line about an arm on stderr; the arm is named if its name is not empty."""
    note(f"{arm}: {text}" if arm else text)


def _progress(arm: str) -> Callable[[int, int, TrackResult | None], None]:
    """Return a function that prints the rate on stderr from time to time; ``arm`` is named if it is not empty."""
    started = last = time.monotonic()
    before = 0
    name = f"{arm}: " if arm else ""

    def report(done: int, total: int, result: TrackResult | None) -> None:
        nonlocal last, before
        if result is None:
            before = done
            return
        now = time.monotonic()
        if now - last >= _REPORT_EVERY or done == total:
            last = now
            rate = (done - before) / max(now - started, 1e-9)
            note(f"{name}{done} of {total} frames, {rate:.1f} a second")

    return report


def _lines(done: TrackSummary, out: Path, *, page: bool, rerun: Path | None) -> Iterator[Line]:
    """Yield the lines of a summary."""
    import numpy as np

    from dvrk_cmaes.results.track_files import VIDEO

    total = len(done.rows)
    counts = ", ".join(f"{done.counts[name]} {name}" for name in ("ok", "doubtful", "lost") if done.counts.get(name))
    yield Line(f"{frames_text(total)}: {counts}", "bold")
    yield from reason_lines(done.rows)
    if done.calibration is not None:
        lag = done.calibration.lag
        yield Line("lag: not determined" if lag is None else f"lag: {lag.describe()}")
        offsets = ", ".join(f"{name} {np.degrees(v):+z.1f}" for name, v in list(done.calibration.offsets.items())[1:])
        yield Line(f"offsets, deg (true = reading + offset): {offsets}")
    yield Line(f"written: {out / 'tracks.jsonl'}")
    if (out / VIDEO).is_file() and not done.interrupted:
        yield Line(f"video: {out / VIDEO}")
    if page and not done.interrupted:
        yield Line(f"page: {out / 'report.html'}")
    if rerun is not None and not done.interrupted:
        yield Line(f"for the Rerun viewer: {rerun}")


def reason_lines(rows: Sequence[Mapping[str, Any]]) -> Iterator[Line]:
    """Yield a line for each kind of reason why frames are not ok, most frequent first, with these frames."""
    from dvrk_cmaes.report.template import frames_by_reason

    names = [row["frame"] for row in rows]
    kinds = frames_by_reason([row["reasons"] for row in rows])
    for kind, places in kinds[:_MOST_REASONS]:
        yield Line(f"  {kind}: {frames_text(len(places))} ({listed(_stretches(names, places))})")
    if len(kinds) > _MOST_REASONS:
        yield Line(f"  ... and {len(kinds) - _MOST_REASONS} more, in tracks.jsonl")
    if kinds:
        yield Line("  what to do about reasons: dvrk-cmaes help problems")


def _stretches(names: Sequence[str], places: Sequence[int]) -> Iterator[str]:
    """Yield the frames at increasing places, those that follow each other as ``FIRST to LAST``."""
    first = places[0]
    for place, following in zip(places, (*places[1:], None), strict=True):
        if following != place + 1:
            yield names[first] if first == place else f"{names[first]} to {names[place]}"
            first = following or 0
