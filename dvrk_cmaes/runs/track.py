"""Arms followed through a session folder: tracks.jsonl, tracks.csv, session.json, overlay video and page.

A recording with readings is solved by its keyframes, then all frames are fitted; otherwise each image is followed from
the one before.
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Mapping
from contextlib import ExitStack, suppress
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any, Final

from dvrk_cmaes.calibration.document import SessionCalibration
from dvrk_cmaes.calibration.session_problem import ArmSetup
from dvrk_cmaes.calibration.together import Begun, Outcome
from dvrk_cmaes.errors import InputError
from dvrk_cmaes.estimation.image_frame import segment_view
from dvrk_cmaes.frames.frame import FrameFiles
from dvrk_cmaes.frames.seen_view import SeenView
from dvrk_cmaes.geometry import Float64
from dvrk_cmaes.instrument.arm import OUTER_JOINTS
from dvrk_cmaes.io.encode import encoded
from dvrk_cmaes.io.json_file import write_json, write_text
from dvrk_cmaes.io.output import Output, output
from dvrk_cmaes.joints.prior import commanded_in, describe_commanded, with_commanded
from dvrk_cmaes.pose.doubts import NO_READINGS
from dvrk_cmaes.report.track_page import PAGE
from dvrk_cmaes.results.folder import SESSION
from dvrk_cmaes.results.tracked import TABLE, TRACKS, VIDEO, TrackResult, line_of, write_table
from dvrk_cmaes.runs.frame import ArmInSession
from dvrk_cmaes.runs.keyframes import begin_solution
from dvrk_cmaes.runs.manifest import manifest_of
from dvrk_cmaes.runs.pool import StoppedError, Workers, pool_of, run_in, usable_cores
from dvrk_cmaes.runs.recording import RecordedFrames, RecordedSolution, follow_window
from dvrk_cmaes.runs.solver_process import SolverProcess
from dvrk_cmaes.runs.track_inputs import EvidenceKind, files_of_views, read_arrays
from dvrk_cmaes.runs.track_outputs import write_outputs
from dvrk_cmaes.segment.segmentation import SegmentSettings
from dvrk_cmaes.track import Tracker
from dvrk_cmaes.track.keyframe_problem import SolutionSchedule

_SAME_TIME: Final = 1e-9  # s


@dataclass(frozen=True, eq=False)
class TrackSettings:
    """What is followed, how, and what is written: as the options of ``dvrk-cmaes track``."""

    lag: float | None = None
    every: int = 1
    causal: bool = False
    evidence: EvidenceKind | None = None
    video: bool = True
    page: bool = True
    rerun: Path | None = None


@dataclass(eq=False)
class TrackedArm:
    """An arm of a session that is followed: begin it with all others of the session, which are finished together.

    Parameters
    ----------
    arm
        The arm.
    out
        Folder of the results.
    settings
        What is followed and how.
    by
        What fits a recording with its own calibration, and hears of each stage, or why there is none.

    ``recorded`` has the frames that are followed. Once they are, ``rows`` are those of tracks.jsonl, ``calibration`` is
    what they rest on, with its whole lag, and ``readings`` has those of each joint at the frames, less the lag, NaN
    without. ``remarks`` are about the readings.
    """

    arm: ArmInSession
    out: Path
    settings: TrackSettings
    by: Workers
    rows: list[dict[str, Any]] = field(default_factory=list)
    calibration: SessionCalibration | None = None
    readings: Mapping[str, Float64] = field(default_factory=dict)
    remarks: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        self.session, self.body, settings = self.arm.session, self.arm.body, self.settings
        method, joints = self.arm.method, self.body.instrument.joint_names
        recorded = RecordedFrames.of(self.session, method.config.track.frames_a_second, settings.every)
        frames = (replace(own, problem=None) if own.without_reading else own for own in recorded.files)
        self.recorded = recorded = replace(recorded, files=tuple(frames))
        if commanded := commanded_in([files.readings for files in recorded.files], joints):
            self.remarks = (describe_commanded(commanded),)
        self.arm = self.arm.with_config(with_commanded(method.config, commanded, joints))
        self._lag = None if settings.lag is None else recorded.lag(settings.lag, 0.0)
        given = method.session
        self._given = given if given is None or self._lag is None else replace(given, lag=self._lag)

    @property
    def counts(self) -> dict[str, int]:
        """Numbers of frames by status."""
        return dict(Counter(row["status"] for row in self.rows))

    @property
    def interrupted(self) -> bool:
        """Whether the run was stopped before the end."""
        return len(self.rows) < len(self.recorded.files)

    @property
    def frames_a_second(self) -> float:
        """Frames a second that are followed."""
        return 1 / (self.recorded.interval * self.settings.every)

    def begin(self) -> Begun[TrackedArm]:
        """Open the folder, and solve the keyframes; what `solved_together` finishes follows the arm, and writes all.

        Raises
        ------
        InputError
            A file of a frame is wrong, or the folder cannot be written to.
        DvrkCmaesError
            Another run is writing there, or a process died.
        """
        if self.by.stop.is_set():
            return Begun.of(self)
        begun: Begun[RecordedSolution | str | None] = Begun.of(None)
        with ExitStack() as stack:
            own = stack.enter_context(output(self.out, "track"))
            own.refuse((TRACKS, TABLE, VIDEO, PAGE, SESSION, *own.files))
            if self.recorded.series.times and not self.settings.causal:
                with suppress(StoppedError):
                    begun = self._begin_keyframes(stack)
            return Begun(partial(self._finish, own, begun), begun.arm).within(stack.pop_all())

    def _begin_keyframes(self, stack: ExitStack) -> Begun[RecordedSolution | str | None]:
        """Use the calibration that was given, or else solve the keyframes."""
        settings, method, recorded, by = self.settings, self.arm.method, self.recorded, self.by
        config = replace(method.config, threads=1)
        pool = stack.enter_context(pool_of(by.count or usable_cores(), recorded.files))
        series, instrument, run = recorded.series, self.body.instrument, run_in(pool, self.body, config, by)
        work = ArmSetup(series, instrument, method.arm, config, run, by.stage, lag=self._lag)
        if self._given is not None and not recorded.trusted.any():
            return Begun.of("no frame has readings of the outer joints that are not frozen")
        return begin_solution(recorded, self._given, work, by.notice, by_masks=settings.evidence == "masks")

    def _finish(self, own: Output, begun: Begun[RecordedSolution | str | None], outcome: Outcome | None) -> TrackedArm:
        """Finish the keyframes of the arm, whose folder and processes are open, follow it, and write everything.

        What an earlier run wrote is there until it is replaced; what is not replaced is removed at the end.
        """
        with suppress(StoppedError):
            self._follow(begun.finish(outcome))
        names = ("lag", "every", "causal", "evidence")
        followed = {name: encoded(getattr(self.settings, name)) for name in names}
        followed |= {"use_joints": bool(self.recorded.series.times), "hints": encoded(self.recorded.files[0].hints)}
        own.describe(manifest_of(self.arm, self.recorded.files) | {"track": followed})
        if self.rows:
            write_text(self.out / TRACKS, "".join(line_of(row) for row in self.rows))
        known, late = self.calibration, self.settings.lag or 0.0
        if known is not None:
            self.calibration = known = replace(known, remarks=tuple(dict.fromkeys((*known.remarks, *self.remarks))))
            late = late if known.applied_lag is None else known.applied_lag.in_seconds(1 / self.recorded.interval)
            if self.rows:
                write_json(self.out / SESSION, known.to_dict())
        self.readings = self.recorded.readings_before(late)
        if not self.interrupted:
            write_table(self.out / TABLE, self.rows, self.body.instrument.joint_names)
            write_outputs(self)
        own.remove_stale()
        return self

    def _follow(self, found: RecordedSolution | str | None) -> None:
        """Follow by the solution of the keyframes, or from image to image after a line that says why there is none."""
        if self.by.stop.is_set():
            return
        if isinstance(found, RecordedSolution):
            results = follow_window(found)
            self.rows = [self._row(files, result) for files, result in zip(self.recorded.files, results, strict=True)]
            self.calibration = found.calibration
            return
        if not self.settings.causal:
            self.by.notice(f"followed from image to image, as by --causal: {found or 'without readings'}")
        self._forwards()

    def _forwards(self) -> None:
        """Follow the frames from image to image; readings are given to the tracker when their time has come."""
        settings, method, recorded = self.settings, self.arm.method, self.recorded
        readings, count = deque(recorded.rows()), len(recorded.files)
        tracker = Tracker(self.session.rig, self.body, method.session, method.config, arm=method.arm, lag=settings.lag)
        with ExitStack() as stack:
            self.by.report(0, count)
            solver = None
            if set(OUTER_JOINTS) <= {*recorded.series.times}:  # which alone determine a base
                solver = stack.enter_context(SolverProcess(self.body, threads=self.by.count or usable_cores()))
            schedule = SolutionSchedule(tracker, solver)
            for files, time in zip(recorded.files, recorded.times.tolist(), strict=True):
                while readings and readings[0][0] <= time + _SAME_TIME:
                    tracker.add_readings(*readings.popleft())
                seen = self._seen(files)
                schedule.before_step(time)
                self.rows.append(self._row(files, tracker.step(time, *seen)))
                schedule.after_step(time)
                self.by.report(len(self.rows), count)
                if self.by.stop.is_set():
                    break
            else:
                schedule.finish()
        self.calibration, lag = tracker.calibration, tracker.lag
        if self.calibration is not None and settings.lag is not None and lag is not None:
            self.calibration = replace(self.calibration, lag=recorded.lag(*lag))

    def _seen(self, files: FrameFiles) -> tuple[dict[str, Any], dict[str, Any], dict[str, Any]]:
        """Return masks, images and ignored pixels of a frame by view; InputError for a file that is wrong."""
        if files.problem is not None:
            raise InputError(files.problem)
        masks, images, ignored = dict[str, Any](), dict[str, Any](), dict[str, Any]()
        for name, of_view in files_of_views(files, self.session.rig).items():
            image, masks[name], ignored[name] = read_arrays(of_view, self.session.rig.view(name).camera)
            images[name] = None if self.settings.evidence == "masks" else image
        first = self.session.rig.names[0]
        if files is self.recorded.files[0] and masks.get(first) is None and images.get(first) is not None:
            view = SeenView.of(self.session.rig.views[0], None, image=images[first])
            mask = segment_view(view, files, files.hints, self.body, SegmentSettings()).mask
            masks[first] = mask if mask.any() else None
        return masks, images, ignored

    def _row(self, files: FrameFiles, result: TrackResult) -> dict[str, Any]:
        """Return the row of a frame in tracks.jsonl; without any readings, it says that nothing determines the mode."""
        if not self.recorded.series.times and self.body.instrument.has_twin and result.status == "doubtful":
            result = replace(result, reasons=(NO_READINGS, *result.reasons))
        return result.to_dict(files.name, timed=self.recorded.series.unit == "s")
