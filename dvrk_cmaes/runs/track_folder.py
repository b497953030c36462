"""Following an instrument through a session folder: tracks.jsonl, tracks.csv, session.json, overlay video and page.

What an interrupted run has solved of a recording's keyframes is used again; frames are followed anew, from the first.
"""

from __future__ import annotations

import threading
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from dvrk_cmaes.calibration.document import SessionCalibration, read_calibration
from dvrk_cmaes.calibration.endoscope import Place
from dvrk_cmaes.calibration.session_state import SessionState
from dvrk_cmaes.calibration.together import Begun
from dvrk_cmaes.frames.session_folder import Session
from dvrk_cmaes.geometry import Float64
from dvrk_cmaes.io.atomic import write_json, write_text
from dvrk_cmaes.io.output import appended, not_written, output, remove
from dvrk_cmaes.joints.commanded import commanded_in, describe_commanded, with_commanded
from dvrk_cmaes.report.track_page import PAGE
from dvrk_cmaes.results.folder import SESSION
from dvrk_cmaes.results.paths import check_writable
from dvrk_cmaes.results.track_files import TABLE, TRACKS, VIDEO, line_of, read_tracks, write_table
from dvrk_cmaes.results.tracked import TrackResult
from dvrk_cmaes.runs.inputs import frame_stamps
from dvrk_cmaes.runs.manifest import (
    Manifest,
    check_same_frames,
    check_same_settings,
    manifest_of,
    read_manifest,
)
from dvrk_cmaes.runs.pool import usable_cores
from dvrk_cmaes.runs.recorded_keyframes import KEYFRAMES, KEYFRAMES_BY_IMAGES
from dvrk_cmaes.runs.solver_process import SolverProcess
from dvrk_cmaes.runs.track_clock import TrackClock
from dvrk_cmaes.runs.track_frames import TrackRun, TrackSettings, followed
from dvrk_cmaes.runs.track_pictures import write_outputs
from dvrk_cmaes.runs.track_recorded import ArmInRecording, begin_recording, with_lag
from dvrk_cmaes.runs.worker import BatchSetup
from dvrk_cmaes.silhouette import Body
from dvrk_cmaes.track.solution_schedule import SolutionSchedule

Followed = tuple[list[dict[str, Any]], SessionCalibration | None]
"""The rows of the frames that were followed, and the calibration with its whole lag."""


@dataclass(frozen=True, eq=False)
class TrackSummary:
    """The rows of tracks.jsonl, whether the run was stopped before the end, and what was found.

    ``frames_a_second`` are those that were followed; ``readings`` those of each joint at the frames, less the lag.
    """

    rows: list[dict[str, Any]]
    interrupted: bool
    calibration: SessionCalibration | None
    frames_a_second: float
    readings: Mapping[str, Float64]

    @property
    def counts(self) -> dict[str, int]:
        """Numbers of frames by status."""
        return dict(Counter(row["status"] for row in self.rows))


@dataclass(frozen=True, eq=False)
class ArmToFollow:
    """An arm whose folder is open, to be written and followed once all arms are begun and solved.

    ``done`` are the rows and the calibration of one that was followed to the end before; ``recording`` is one that is
    followed by its keyframes, None of one that is followed from image to image; ``remarks`` are on its calibration.
    """

    run: TrackRun
    opened: ExitStack
    remarks: tuple[str, ...]
    video: bool
    page: bool
    rerun: Path | None
    done: Followed | None = None
    recording: ArmInRecording | None = None

    def write(self) -> None:
        """Keep what the keyframes of the arm tell."""
        if self.recording is not None:
            self.recording.write()

    def follow(self) -> TrackSummary:
        """Follow the arm and write everything to its folder."""
        run = self.run
        with self.opened:
            rows, calibration = self.done or self._by_keyframes() or _forwards(run)
            lag = None if calibration is None else calibration.applied_lag
            late = (run.settings.lag or 0.0) if lag is None else lag.in_seconds(1 / run.clock.interval)
            interrupted = len(rows) < len(run.frames)
            if calibration is not None:
                new = tuple(text for text in self.remarks if text not in calibration.remarks)
                calibration = replace(calibration, remarks=(*calibration.remarks, *new))
            if calibration is not None and rows:
                write_json(run.out / SESSION, calibration.to_dict())
            readings = _readings(run, late)
            if not interrupted:
                write_table(run.out / TABLE, rows, run.body.instrument.joint_names)
                if rows and (self.video or self.page or self.rerun is not None):
                    write_outputs(run, rows, readings, calibration, video=self.video, page=self.page, rerun=self.rerun)
        return TrackSummary(rows, interrupted, calibration, run.frames_a_second, readings)

    def _by_keyframes(self) -> Followed | None:
        """Follow a recording with the calibration of its keyframes, and write the rows, none if it is stopped.

        Returns None, after a line that says why, if every frame is to be followed from those before it only.
        """
        run, because = self.run, "without readings"
        if run.settings.causal:
            return None
        if self.recording is not None:
            found = self.recording.follow()
            if found is None:
                return [], None
            if not isinstance(found, str):
                results, calibration = found
                rows = [run.row(files, result) for files, result in zip(run.frames, results, strict=True)]
                write_text(run.out / TRACKS, "".join(line_of(row) for row in rows))
                run.progress(len(rows), len(rows), results[-1] if results else None)
                return rows, calibration
            because = found
        run.notice(f"followed from image to image, as by --causal: {because}")
        return None


def begin_tracking(
    session: Session,
    out: Path,
    body: Body,
    settings: TrackSettings,
    *,
    resume: bool = True,
    video: bool = True,
    page: bool = True,
    rerun: Path | None = None,
    stop: threading.Event | None = None,
    progress: Callable[[int, int, TrackResult | None], None] = lambda done, total, result: None,
    notice: Callable[[str], None] = lambda text: None,
    arm: str = "",
    places: Sequence[Place] = (),
) -> Begun[ArmToFollow]:
    """Open a folder to which an instrument that is followed is written, and solve the keyframes of its recording.

    Finish it by `solved_together` with the other arms of a recording, then write and follow each; `track_folder` does
    so with one arm.

    Parameters
    ----------
    session, body, settings
        The session; the instrument; what is followed and how.
    out
        Folder of the results.
    resume
        Go on with what an interrupted run left; if False, begin anew.
    video, page
        Whether to draw the overlay video; whether to write the page.
    rerun
        Path of a recording for the Rerun viewer that is written, too.
    stop
        When set, the run ends after the frame it is at.
    progress
        Called after each frame with the number of frames done, that of all, and the frame's result; at the start, with
        the number of frames that are there already and None.
    notice
        Called with a line about each stage of a recording that is solved by its keyframes, or why it is not.
    arm
        The name of the arm, if it is one of several.
    places
        Those at which another arm found the endoscope.

    Raises
    ------
    InputError
        A file of a frame is wrong, the folder cannot be written to, or it has results of other settings.
    DvrkCmaesError
        Another run is writing there.
    """
    every = session.frames[:: settings.every]
    frames = tuple(replace(files, problem=None, unread=False) if files.unread else files for files in every)
    clock = TrackClock.of(session, frames, settings.frames_a_second, use_joints=settings.use_joints)
    joints = body.instrument.joint_names
    commanded = commanded_in([files.readings for files in frames], joints) if settings.use_joints else []
    config = with_commanded(settings.config, commanded, joints)
    settings = replace(settings, config=config, outer_read=clock.outer_read)
    remarks = (describe_commanded(commanded),) if commanded else ()
    for text in remarks:
        notice(f"warning: {text}")
    check_writable(out)
    with ExitStack() as stack:
        own = stack.enter_context(output(out, "track", replaces=not resume))
        own.refuse((TRACKS, TABLE, VIDEO, PAGE, SESSION))
        run = TrackRun(session, out, body, settings, frames, clock, stop, progress, notice, arm, places)
        manifest = _manifest(run)
        old = read_manifest(out)
        if old is not None and resume:
            check_same_settings(out, old, manifest)
            names = list(manifest["frames"])
            check_same_frames(out, old, manifest["frames"], done=names, session=names)
        kept = old is not None and resume
        if not kept:
            for name in (KEYFRAMES, KEYFRAMES_BY_IMAGES):
                remove(out / name)
        done = _finished(run) if kept else None
        for name in (SESSION, TABLE):
            remove(out / name)
        own.describe(manifest)
        followed: Begun[ArmInRecording | None] = Begun.of(None)
        if done is None and run.settings.use_joints and not run.settings.causal:
            followed = begin_recording(run)
        opened = stack.pop_all()
    arm_to_follow = ArmToFollow(run, ExitStack(), remarks, video, page, rerun, done)
    return Begun(partial(_with_keyframes, arm_to_follow, followed, opened), followed.state)


def _with_keyframes(
    arm: ArmToFollow, begun: Begun[ArmInRecording | None], opened: ExitStack, others: Sequence[SessionState]
) -> ArmToFollow:
    """Finish the keyframes of an arm whose folder is ``opened``."""
    with ExitStack() as stack:
        stack.enter_context(opened)
        recording = begun.finish(others)
        return replace(arm, opened=stack.pop_all(), recording=recording)


def _forwards(run: TrackRun) -> Followed:
    """Follow the frames from image to image, and write the row of each when it is there; returns rows and calibration.

    The calibration has its whole lag.
    """
    rows, tracker = list[dict[str, Any]](), run.settings.tracker(run.session.rig, run.body)
    total = len(run.frames)
    run.progress(0, total, None)
    with ExitStack() as stack:
        schedule = None
        if run.settings.keeps_keyframes:
            threads = run.settings.workers or usable_cores()
            solver = stack.enter_context(SolverProcess(run.body.instrument, threads=threads))
            schedule = SolutionSchedule(tracker, solver)
        append = stack.enter_context(_lines(run.out))
        shown, rig = run.settings.evidence != "masks", run.session.rig
        for files, result in followed(tracker, run.frames, run.clock, rig, with_images=shown, schedule=schedule):
            rows.append(run.row(files, result))
            append(rows[-1])
            run.progress(len(rows), total, result)
            if run.stop is not None and run.stop.is_set():
                break
        else:
            if schedule is not None:
                schedule.finish()
    found = tracker.calibration
    return rows, None if found is None else with_lag(found, run.settings.lag, run.clock)


def _finished(run: TrackRun) -> Followed | None:
    """Return rows and calibration of a recording that was followed to the end, as its table tells; None otherwise."""
    tracks, session = run.out / TRACKS, run.out / SESSION
    if not (tracks.exists() and (run.out / TABLE).exists()):
        return None
    rows = read_tracks(tracks)
    if [row["frame"] for row in rows] != [files.name for files in run.frames]:
        return None
    return rows, read_calibration(session) if session.exists() else None


def _readings(run: TrackRun, late: float) -> dict[str, Float64]:
    """Return the readings of each joint at the times of the frames less a lag, s; NaN where there are none."""
    times = np.array([run.clock.times[files.name] for files in run.frames]) - late
    return run.clock.readings_at(times, run.settings.config.track.reading_gap)


def _manifest(run: TrackRun) -> Manifest:
    """Return what the results depend on."""
    session, settings = run.session, run.settings
    own = run.body.instrument, session.rig, settings.config, settings.arm, session.folder
    followed = {
        "lag": settings.lag,
        "every": settings.every,
        "joints": settings.use_joints,
        "frames_a_second": settings.frames_a_second,
        "causal": settings.causal,
        "evidence": settings.evidence,
        "hints": None if settings.hints is None else settings.hints.to_dict(),
    }
    digests = {files.name: frame_stamps(files) for files in run.frames}
    return manifest_of(BatchSetup(*own, calibration=settings.calibration), digests) | {"track": followed}


@contextmanager
def _lines(out: Path) -> Iterator[Callable[[dict[str, Any]], None]]:
    """Begin tracks.jsonl, and give a function that appends a row."""
    path = out / TRACKS
    try:
        with appended(path, b"") as file:

            def append(row: dict[str, Any]) -> None:
                file.write(line_of(row).encode())

            yield append
    except OSError as error:
        raise not_written(path, error, "results") from None
