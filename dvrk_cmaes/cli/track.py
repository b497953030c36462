"""``dvrk-cmaes track``: an instrument followed through a recording."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from cyclopts import Parameter

from dvrk_cmaes.cli.options import (
    AUTO,
    FOLDER,
    NO_READINGS,
    OUTPUT,
    CalibrationOptions,
    CameraOptions,
    EveryNth,
    Flag,
    Processes,
    PromptOptions,
    SessionOptions,
    options,
)
from dvrk_cmaes.cli.session_tools import (
    ArmReport,
    found_lines,
    open_session,
    output_folder,
    reason_lines,
    report_arms,
)
from dvrk_cmaes.cli.terminal import (
    DOUBTFUL,
    INTERRUPTED,
    Line,
    attended,
    note,
    show,
    warn,
)
from dvrk_cmaes.errors import InputError
from dvrk_cmaes.io.short_text import counted, listed, no_folder

if TYPE_CHECKING:
    from dvrk_cmaes.frames.video_frames import Video
    from dvrk_cmaes.runs.frame import ArmInSession
    from dvrk_cmaes.runs.pool import Workers
    from dvrk_cmaes.runs.track import TrackedArm

_TOLERANCE = 0.05  # s, as of import


@options(group=FOLDER)
class TrackOptions:
    """What is followed, and what is written.

    Parameters
    ----------
    out
        Folder for tracks.jsonl, tracks.csv, session.json, tracks.mp4 and report.html; SESSION/tracks by default, or
        tracks beside the recording. Those of several arms are in OUT/ARM, and a video and arms.json, how their bases
        lie to each other, in OUT.
    every
        Follow only every N-th frame.
    joints
        File of readings to use instead of the session's own, or none: follow by masks alone.
    lag
        Lag of the images behind the readings, in seconds or frames, such as 0.13 or 4frames. auto: that of --session,
        or found while following.
    causal
        Follow from image to image: no frame's result uses later ones. So are recordings without readings, and those
        of which fewer than 12 keyframes are usable or agree.
    workers
        Number of processes that fit the frames; by default the number of cores. With --causal, threads that solve
        keyframes.
    video
        --no-video leaves out the overlay video.
    page
        --no-page leaves out report.html, the page with the recording, curves over time and places to look at.
    rerun
        File .rrd for the Rerun viewer: images, masks, meshes, camera and joints on a timeline. Needs rerun-sdk.
    evidence
        masks or images; by default the masks of frames that have one, and the images of the others.
    first_mask
        Mask of the first frame, if that has none.
    """

    out: Path | None = None
    every: EveryNth = 1
    joints: str | None = None
    lag: Annotated[str, Parameter(allow_leading_hyphen=True)] = AUTO
    causal: Flag = False
    workers: Processes = None
    video: bool = True
    page: bool = True
    rerun: Path | None = None
    evidence: Literal["masks", "images"] | None = None
    first_mask: Path | None = None

    @property
    def readings(self) -> Path | None:
        """The file of readings that is given."""
        return None if self.joints is None or self.joints == NO_READINGS else Path(self.joints)

    def check_for_several(self, place: PromptOptions) -> None:
        """Raise an InputError for an option that cannot hold for several arms."""
        of_one = {"--first-mask": self.first_mask, "--rerun": self.rerun, "--joints FILE": self.readings}
        given = [name for name, path in of_one.items() if path is not None]
        if place != PromptOptions():
            given.append("--box, --point")
        if given:
            raise InputError(f"{given[0]}: expected one arm (--only ARM), got a session of several")

    def arm(self, name: str, arm: ArmInSession, target: Path, place: PromptOptions, by: Workers) -> TrackedArm:
        """Say how an arm of a recording is followed; ``place`` is where it is in the first image."""
        from dvrk_cmaes.joints.lag import Lag
        from dvrk_cmaes.runs.track import TrackedArm, TrackSettings
        from dvrk_cmaes.runs.track_inputs import used_session, with_increasing_times

        timed, doubled = with_increasing_times(arm.session)
        if doubled:
            warn(f"left out, for they have the time of the frame before: {listed(doubled)}")
        used, evidence = used_session(timed, self.evidence)
        first = used.frames[0]
        first = first if place == PromptOptions() else replace(first, prompts=place.hints())
        first = first if self.first_mask is None else replace(first, mask=self.first_mask)
        arm = replace(arm, session=replace(used, frames=(first, *used.frames[1:])))
        rate = arm.method.config.track.frames_a_second
        same = ("every", "causal", "video", "page", "rerun")
        settings = TrackSettings(
            lag=None if self.lag == AUTO else Lag.parse("--lag", self.lag).in_seconds(rate),
            evidence=evidence,
            **{field: getattr(self, field) for field in same},
        )
        by = by if not name else replace(by, notice=lambda text: note(f"{name}: {text}"))
        return TrackedArm(arm, target / name, settings, by)


def track(
    session: Annotated[Path, Parameter(group=FOLDER)],
    /,
    *,
    follow: TrackOptions = TrackOptions(),
    place: PromptOptions = PromptOptions(),
    calibrated: CalibrationOptions = CalibrationOptions(),
    given: SessionOptions = SessionOptions(),
    json: Annotated[Flag, Parameter(group=OUTPUT)] = False,
) -> int:
    """Follow an instrument through the consecutive frames of a session or a video, by masks or images, and readings.

    Keyframes over the whole recording are solved together, as by `calibrate`, those of several arms in one problem;
    every frame is then fitted with what that solution and its neighbours expect. With --causal, and where keyframes
    cannot be solved, the first frame is solved as by `estimate`, the others start from what the readings did since the
    frame before, and keyframes are solved as they come: no result depends on later frames, and none is ok before
    keyframes determine the arm's base.

    Exit codes: 0 all ok, 1 the work could not be done, 2 wrong usage or input, 3 finished, but a frame is doubtful or
    lost, 130 interrupted. What an earlier run wrote to OUT is replaced at the end, and stays where the command
    fails. An interrupted run with --causal leaves the rows of tracks.jsonl so far, which no other run continues.

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
    follow
        What is followed, and what is written.
    place
        Where the instrument is in the first image, if that has no mask: which of two tools is followed. By default
        what boxes.csv says of it.
    calibrated
        A calibration that is used instead of the keyframes' solution; with --causal, from the first frame on.
    given
        The arms, the camera, the instrument and the settings, of which those of [track] are of this command.
    json
        Print only the numbers of frames by status, as JSON, on stdout.
    """
    from dvrk_cmaes.calibration.together import solved_together
    from dvrk_cmaes.instrument.setup_joints import SETUP, read_setup_joints
    from dvrk_cmaes.results.tracked import VIDEO
    from dvrk_cmaes.runs.track_outputs import write_track_arms

    if follow.rerun is not None:
        from dvrk_cmaes.export.rerun_file import check_rerun

        check_rerun("--rerun", follow.rerun)
    with output_folder(follow.out, session if session.is_dir() else session.parent, "tracks", "track") as target:
        folder, video = _session_of(session, follow, target, given.camera)
        files = () if follow.joints is None else (Path(follow.joints),)
        read = open_session(folder, given, calibrated, joints=files, video=video, ahead=not follow.causal)
        setup = read_setup_joints(folder / SETUP) if len(read) > 1 else {}
        if len(read) > 1:
            follow.check_for_several(place)
        with attended(count=follow.workers) as by:
            arms = {name: follow.arm(name, arm, target, place, by) for name, arm in read.items()}
            solved_together({name: arm.begin for name, arm in arms.items()})
        interrupted = any(arm.interrupted for arm in arms.values())
        compared = len(arms) > 1 and not interrupted
        if compared and follow.video:
            write_track_arms(target, arms)
            if not json:
                show([Line(f"all arms: {target / VIDEO}")])
        reports = {name: _report_of(arm, compared=compared) for name, arm in arms.items()}
        code = report_arms(reports, target, setup, json=json, followed=True)
    return INTERRUPTED if interrupted else code


def _session_of(path: Path, follow: TrackOptions, out: Path, camera: CameraOptions) -> tuple[Path, Video | None]:
    """Return the session folder of a path, and the video that has its images.

    Of a ROS recording the session is written in ``out``, in place of an earlier one. The video of a session counts
    where it has no images, and its masks are not all that is asked for. InputError if there is nothing at the path, it
    is neither, or it holds links that leave it.
    """
    from dvrk_cmaes.frames.video_frames import SUFFIXES, Video, own_video
    from dvrk_cmaes.io.files import check_own, check_own_folder
    from dvrk_cmaes.recording.topics import is_bag

    if path.suffix.lower() in SUFFIXES and not path.is_dir():
        return path.parent, Video(path)
    if is_bag(path):
        from dvrk_cmaes.recording.bag import open_bag
        from dvrk_cmaes.recording.recording import Asked
        from dvrk_cmaes.recording.write_session import write_session

        check_own_folder(path)
        recording, folder = open_bag(path, Asked(camera=camera.camera, joints=follow.readings)), out / "session"
        write_session(recording, folder, tolerance=_TOLERANCE, overwrite=folder.exists())
        return folder, None
    if not path.is_dir():
        raise InputError(f"{path}: {no_folder(path)}; expected a session folder, a video or a ROS recording")
    video = own_video(path) if follow.evidence == "images" or not (path / "masks").is_dir() else None
    check_own(path, [video])
    return path, None if video is None else Video(video)


def _report_of(arm: TrackedArm, *, compared: bool) -> ArmReport:
    """Return what is said of an arm, and, if all are ``compared``, its results."""
    from dvrk_cmaes.runs.track_outputs import followed_results

    known, counts = arm.calibration, arm.counts
    warnings = (*arm.session.rig.remarks, *arm.remarks, *(() if known is None else known.warnings))
    to_compare = (followed_results(arm), known) if compared else ()
    return ArmReport(counts, _lines(arm), warnings, DOUBTFUL if set(counts) - {"ok"} else 0, *to_compare)


def _lines(arm: TrackedArm) -> Iterator[Line]:
    """Yield the lines about an arm that was followed."""
    from dvrk_cmaes.results.tracked import VIDEO

    counts = ", ".join(f"{arm.counts[name]} {name}" for name in ("ok", "doubtful", "lost") if arm.counts.get(name))
    yield Line(f"{counted(len(arm.rows), 'frame')}: {counts or 'interrupted'}", "bold")
    yield from reason_lines({row["frame"]: row["reasons"] for row in arm.rows})
    if arm.calibration is not None:
        yield from found_lines(arm.calibration)
    if arm.rows:
        yield Line(f"written: {arm.out / 'tracks.jsonl'}")
    if not arm.interrupted:
        if (arm.out / VIDEO).is_file():
            yield Line(f"video: {arm.out / VIDEO}")
        if arm.settings.page:
            yield Line(f"page: {arm.out / 'report.html'}")
        if arm.settings.rerun is not None:
            yield Line(f"for the Rerun viewer: {arm.settings.rerun}")
