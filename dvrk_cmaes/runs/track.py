"""Arms followed through a session folder: tracks.jsonl, tracks.csv, session.json, overlay video and page.

A recording with readings is solved by its keyframes, then all frames are fitted; otherwise each image is followed from
the one before. An interrupted run is begun anew.
"""

from __future__ import annotations

import threading
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, suppress
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, Final

import numpy as np

from dvrk_cmaes.calibration.document import SessionCalibration, read_calibration
from dvrk_cmaes.calibration.session_problem import ArmSetup
from dvrk_cmaes.calibration.together import Begun, Outcome
from dvrk_cmaes.errors import InputError
from dvrk_cmaes.frames.frame import FrameFiles
from dvrk_cmaes.geometry import Float64
from dvrk_cmaes.io.atomic import write_json, write_text
from dvrk_cmaes.io.encode import encoded
from dvrk_cmaes.io.output import output, remove
from dvrk_cmaes.joints.commanded import commanded_in, describe_commanded, with_commanded
from dvrk_cmaes.joints.lag import Lag
from dvrk_cmaes.joints.series import ReadingSeries
from dvrk_cmaes.pose.doubts import NO_READINGS
from dvrk_cmaes.report.track_page import PAGE
from dvrk_cmaes.results.folder import SESSION
from dvrk_cmaes.results.paths import check_writable
from dvrk_cmaes.results.track_files import TABLE, TRACKS, VIDEO, line_of, read_tracks, write_table
from dvrk_cmaes.results.tracked import TrackResult
from dvrk_cmaes.runs.frame import ArmInSession
from dvrk_cmaes.runs.keyframes import begin_images, begin_keyframes
from dvrk_cmaes.runs.manifest import (
    Manifest,
    check_same_frames,
    check_same_settings,
    frame_stamps,
    manifest_of,
    read_manifest,
)
from dvrk_cmaes.runs.pool import pool_of, run_with_body, usable_cores
from dvrk_cmaes.runs.recording import RecordedFrames, RecordedSolution, follow_window
from dvrk_cmaes.runs.solver_process import SolverProcess
from dvrk_cmaes.runs.track_inputs import TrackClock, files_of_views, read_arrays, series_of
from dvrk_cmaes.runs.track_outputs import write_outputs
from dvrk_cmaes.segment.segmentation import Hints
from dvrk_cmaes.track import Tracker
from dvrk_cmaes.track.keyframe_problem import SolutionSchedule
from dvrk_cmaes.track.view_segmenter import EvidenceKind

_GROUP: Final = 24  # tasks after which a run looks whether it is to stop
_SAME_TIME: Final = 1e-9  # s


class _StoppedError(Exception):
    """The run is to end."""


@dataclass(frozen=True, eq=False)
class TrackSettings:
    """What is followed, how, and what is written: as the options of ``dvrk-cmaes track``.

    ``workers`` is the number of processes that fit a recording with its own calibration; by default that of the cores.
    """

    lag: float | None = None
    every: int = 1
    use_joints: bool = True
    causal: bool = False
    evidence: EvidenceKind | None = None
    workers: int | None = None
    resume: bool = True
    video: bool = True
    page: bool = True
    rerun: Path | None = None


class TrackedArm:
    """An arm of a session that is followed: begin it with all others of the session, which are finished together.

    Parameters
    ----------
    arm
        The arm; the hints of its method are those of the first frame.
    out
        Folder of the results.
    settings
        What is followed and how.
    notice
        Called with a line about each stage of a recording that is solved by its keyframes, or why it is not.

    stop
        Once this event is set, the run ends soon.
    report
        Called with the number of frames done and that of all of a stage.

    ``frames`` are those that are followed. Once they are, ``rows`` are those of tracks.jsonl, ``calibration`` is what
    they rest on, with its whole lag, and ``readings`` has those of each joint at the frames, less the lag, NaN without.
    """

    def __init__(
        self,
        arm: ArmInSession,
        out: Path,
        settings: TrackSettings,
        *,
        notice: Callable[[str], None],
        stop: threading.Event,
        report: Callable[..., None],
    ) -> None:
        every, joints = arm.session.frames[:: settings.every], arm.body.instrument.joint_names
        self.frames = tuple(replace(files, problem=None, unread=False) if files.unread else files for files in every)
        self.clock = TrackClock.of(
            arm.session, self.frames, arm.method.config.track.frames_a_second, use_joints=settings.use_joints
        )
        readings = [files.readings for files in self.frames] if settings.use_joints else []
        commanded = commanded_in(readings, joints)
        self._remarks = (describe_commanded(commanded),) if commanded else ()
        self.arm = arm.with_config(with_commanded(arm.method.config, commanded, joints))
        self.session, self.body, self.out, self.settings = arm.session, arm.body, out, settings
        self._notice, self._stop, self._report, self._finished = notice, stop, report, False
        given = arm.method.session
        self._given = given if given is None or settings.lag is None else replace(given, lag=None)
        self._work: ArmSetup | None = None
        self.rows: list[dict[str, Any]] = []
        self.calibration: SessionCalibration | None = None
        self.readings: Mapping[str, Float64] = {}

    @property
    def counts(self) -> dict[str, int]:
        """Numbers of frames by status."""
        return dict(Counter(row["status"] for row in self.rows))

    @property
    def interrupted(self) -> bool:
        """Whether the run was stopped before the end."""
        return len(self.rows) < len(self.frames)

    @property
    def frames_a_second(self) -> float:
        """Frames a second that are followed."""
        return 1 / (self.clock.interval * self.settings.every)

    def begin(self) -> Begun[TrackedArm]:
        """Open the folder, and solve the keyframes; what `solved_together` finishes follows the arm, and writes all.

        Raises
        ------
        InputError
            A file of a frame is wrong, the folder cannot be written to, or it has results of other settings.
        DvrkCmaesError
            Another run is writing there, or a process died.
        """
        settings = self.settings
        for text in self._remarks:
            self._notice(f"warning: {text}")
        check_writable(self.out)
        begun: Begun[RecordedSolution | str | None] = Begun.of(None)
        with ExitStack() as stack:
            self._open(stack)
            if settings.use_joints and not (settings.causal or self._finished):
                with suppress(_StoppedError):
                    begun = self._begin_keyframes(stack)
            return Begun(partial(self._finish, begun), begun.arm).within(stack.pop_all())

    def _open(self, stack: ExitStack) -> None:
        """Open the folder; results of a run that was finished are read."""
        out, resume = self.out, self.settings.resume
        own = stack.enter_context(output(out, "track"))
        own.refuse((TRACKS, TABLE, VIDEO, PAGE, SESSION))
        manifest, old = self._manifest(), read_manifest(out)
        if old is not None and resume:
            check_same_settings(out, old, manifest)
            check_same_frames(out, old, manifest["frames"], done=manifest["frames"])
            self._read_finished()
        for name in (SESSION, TABLE, *(() if self._finished else (TRACKS,))):
            remove(out / name)
        own.describe(manifest)

    def _read_finished(self) -> None:
        """Read rows and calibration of a recording that was followed to the end, as its table tells."""
        tracks, session = self.out / TRACKS, self.out / SESSION
        if tracks.exists() and (self.out / TABLE).exists():
            rows = read_tracks(tracks)
            if [row["frame"] for row in rows] == [files.name for files in self.frames]:
                self.rows, self._finished = rows, True
                self.calibration = read_calibration(session) if session.exists() else None

    def _begin_keyframes(self, stack: ExitStack) -> Begun[RecordedSolution | str | None]:
        """Use the calibration that was given, or else solve the keyframes."""
        settings, method = self.settings, self.arm.method
        frames, series = self.frames, series_of(self.session)
        lag, given = None, self._given
        if settings.lag is not None:
            frames, series = _less_lag(frames, series, self.clock, settings.lag)
            lag = Lag(0.0, seconds=0.0)  # that is taken out already
        config = replace(method.config, threads=1)
        pool = stack.enter_context(pool_of(self.body, settings.workers or usable_cores(), frames))
        run = partial(self._in_groups, partial(run_with_body, pool, self.body, config))
        work = ArmSetup(series, self.body.instrument, method.arm, config, run, self._stage, lag=lag)
        if self._stop.is_set():
            raise _StoppedError
        by_masks = settings.evidence == "masks"
        times = np.array([self.clock.times[files.name] for files in frames])
        measured = RecordedFrames.of if by_masks else RecordedFrames.of_readings
        recorded = measured(frames, self.session.rig, series, times)
        self._work = work
        if given is not None and not recorded.trusted.any():
            return Begun.of("no frame has readings of the outer joints that are not frozen")
        if given is not None and by_masks:
            return Begun.of(RecordedSolution(recorded, given))
        return (
            begin_keyframes(recorded, work)
            if by_masks
            else begin_images(recorded, given, method.hints or Hints(), work)
        )

    def _finish(self, begun: Begun[RecordedSolution | str | None], outcome: Outcome | None) -> TrackedArm:
        """Finish the keyframes of the arm, whose folder and processes are open, follow it, and write everything."""
        found = None
        with suppress(_StoppedError):
            found = begun.finish(outcome)
        if not self._finished:
            if not self._by_keyframes(found):
                self._forwards()
            if self.rows:
                write_text(self.out / TRACKS, "".join(line_of(row) for row in self.rows))
        calibration = self.calibration
        lag = None if calibration is None else calibration.applied_lag
        late = (self.settings.lag or 0.0) if lag is None else lag.in_seconds(1 / self.clock.interval)
        if calibration is not None:
            new = tuple(text for text in self._remarks if text not in calibration.remarks)
            self.calibration = calibration = replace(calibration, remarks=(*calibration.remarks, *new))
        if calibration is not None and self.rows:
            write_json(self.out / SESSION, calibration.to_dict())
        times = np.array([self.clock.times[files.name] for files in self.frames]) - late
        self.readings = self.clock.readings_at(times, self.arm.method.config.track.reading_gap)
        if not self.interrupted:
            write_table(self.out / TABLE, self.rows, self.body.instrument.joint_names)
            if self.rows:
                write_outputs(self)
        return self

    def _by_keyframes(self, found: RecordedSolution | str | None) -> bool:
        """Follow a recording with the calibration of its keyframes, without rows if it is stopped.

        Returns False, after a line that says why, if every frame is to be followed from those before it only.
        """
        if self.settings.causal:
            return False
        because = "without readings"
        if self.settings.use_joints:
            if self._work is None or found is None or self._stop.is_set():
                return True
            if isinstance(found, RecordedSolution):
                with suppress(_StoppedError):
                    self._fit_all(found, self._work)
                return True
            because = found
        self._notice(f"followed from image to image, as by --causal: {because}")
        return False

    def _fit_all(self, solution: RecordedSolution, work: ArmSetup) -> None:
        """Fit all frames of a recording by the solution of its keyframes."""
        self._stage("fitting", len(self.frames))
        results = follow_window(solution, work)
        self.rows = [self._row(files, result) for files, result in zip(self.frames, results, strict=True)]
        self.calibration = _with_lag(solution.calibration, self.settings.lag, self.clock)

    def _forwards(self) -> None:
        """Follow the frames from image to image."""
        settings, method, total = self.settings, self.arm.method, len(self.frames)
        tracker = Tracker(
            self.session.rig,
            self.body,
            method.session,
            method.config,
            arm=method.arm,
            lag=settings.lag,
            evidence=settings.evidence,
            hints=method.hints,
        )
        with ExitStack() as stack:
            self._report(0, total)
            schedule = None
            if settings.use_joints and self.clock.outer_read:  # which alone tell of a base
                threads = settings.workers or usable_cores()
                solver = stack.enter_context(SolverProcess(self.body, threads=threads))
                schedule = SolutionSchedule(tracker, solver)
            for files, result in self._steps(tracker, schedule):
                self.rows.append(self._row(files, result))
                self._report(len(self.rows), total)
                if self._stop.is_set():
                    break
            else:
                if schedule is not None:
                    schedule.finish()
        found = tracker.calibration
        self.calibration = None if found is None else _with_lag(found, settings.lag, self.clock)

    def _steps(self, tracker: Tracker, schedule: SolutionSchedule | None) -> Iterator[tuple[FrameFiles, TrackResult]]:
        """Follow the frames; readings are given to the tracker when their time has come.

        ``schedule`` has the tracker's keyframes solved meanwhile. InputError for a wrong file of a frame.
        """
        rig, readings, fed = self.session.rig, self.clock.readings, 0
        for files in self.frames:
            time = self.clock.times[files.name]
            while fed < len(readings) and readings[fed][0] <= time + _SAME_TIME:
                tracker.add_readings(*readings[fed])
                fed += 1
            if files.problem is not None:
                raise InputError(files.problem)
            masks, images, ignored = {}, {}, {}
            for name, of_view in files_of_views(files, rig).items():
                image, masks[name], ignored[name] = read_arrays(of_view, rig.view(name).camera)
                used = self.settings.evidence != "masks" or of_view.mask is None
                images[name] = image if used else None
            if schedule is not None:
                schedule.before_step(time)
            result = tracker.step(time, masks, images, ignored)
            if schedule is not None:
                schedule.after_step(time)
            yield files, result

    def _row(self, files: FrameFiles, result: TrackResult) -> dict[str, Any]:
        """Return the row of a frame in tracks.jsonl; without any readings, it says that nothing tells the mode."""
        if not self.clock.readings and self.body.instrument.has_twin and result.status == "doubtful":
            result = replace(result, reasons=(NO_READINGS, *result.reasons))
        return result.to_dict(files.name, timed=self.clock.unit == "s")

    def _stage(self, stage: str, frames: int) -> None:
        """Say at which stage the run is."""
        self._notice(f"{stage} {frames} frames" if stage == "fitting" else f"{stage}: {frames} frames")

    def _in_groups(
        self, run: Callable[..., list[Any]], function: Callable[..., Any], tasks: Sequence[Any]
    ) -> list[Any]:
        """Apply a function to all tasks, some at a time; raises `_StoppedError` between them if the run is to stop."""
        values: list[Any] = []
        for first in range(0, len(tasks), _GROUP):
            if self._stop.is_set():
                raise _StoppedError
            values += run(function, tasks[first : first + _GROUP])
            self._report(len(values), len(tasks))
        return values

    def _manifest(self) -> Manifest:
        """Return what the results depend on."""
        names = ("lag", "every", "use_joints", "causal", "evidence")
        followed = {name: encoded(getattr(self.settings, name)) for name in names}
        digests = {files.name: frame_stamps(files) for files in self.frames}
        return manifest_of(self.arm, digests) | {"track": {**followed, "hints": encoded(self.arm.method.hints)}}


def _less_lag(
    frames: tuple[FrameFiles, ...], series: ReadingSeries | None, clock: TrackClock, seconds: float
) -> tuple[tuple[FrameFiles, ...], ReadingSeries | None]:
    """Return the frames with the readings of the times of their images less a given lag, and the series so shifted."""
    if series is None or seconds == 0.0:
        return frames, series
    shift = seconds if series.unit == "s" else seconds / clock.interval
    lag = Lag(shift / series.interval, seconds=seconds)
    read = tuple(
        replace(own, readings=series.of_frame(own.name, lag) if own.name in series.frames else {}) for own in frames
    )
    return read, replace(series, frames={name: time - shift for name, time in series.frames.items()})


def _with_lag(calibration: SessionCalibration, given: float | None, clock: TrackClock) -> SessionCalibration:
    """Return a calibration with the lag that was given added to the one that it has found besides."""
    if given is None:
        return calibration
    found = calibration.applied_lag
    besides = 0.0 if found is None else found.in_seconds(1 / clock.interval)
    std = 0.0 if found is None or found.std_frames is None else found.std_frames * clock.interval
    factor, interval = (1.0, clock.interval) if clock.unit == "s" else (1.0 / clock.interval, 1.0)
    lag = Lag.of((given + besides) * factor, std * factor, clock.unit, interval, applied=True)
    return replace(calibration, lag=lag)
