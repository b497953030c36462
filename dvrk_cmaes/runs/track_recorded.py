"""A recording on disk followed with its own calibration: keyframes are solved together, then every frame is fitted."""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, Final

import numpy as np

from dvrk_cmaes.calibration.document import SessionCalibration
from dvrk_cmaes.calibration.session_state import SessionProblem, SessionState
from dvrk_cmaes.calibration.together import Begun
from dvrk_cmaes.frames.frame import FrameFiles
from dvrk_cmaes.joints.lag import Lag
from dvrk_cmaes.joints.series import ReadingSeries
from dvrk_cmaes.results.tracked import TrackResult
from dvrk_cmaes.runs.inputs import instrument_digest
from dvrk_cmaes.runs.pool import instrument_pool, run_with_body, usable_cores
from dvrk_cmaes.runs.recorded import RecordedSolution, follow_window
from dvrk_cmaes.runs.recorded_images import begin_images
from dvrk_cmaes.runs.recorded_keyframes import (
    KEYFRAMES,
    KEYFRAMES_BY_IMAGES,
    RecordedFrames,
    begin_keyframes,
    read_keyframes,
    write_keyframes,
)
from dvrk_cmaes.runs.track_clock import TrackClock, series_of
from dvrk_cmaes.runs.track_frames import TrackRun
from dvrk_cmaes.segment.segmentation import Hints

_GROUP: Final = 24  # tasks after which a run looks whether it is to stop


class _StoppedError(Exception):
    """The run is to end."""


@dataclass(frozen=True, eq=False)
class ArmInRecording:
    """An arm of a recording whose keyframes are solved, or that has a calibration: it is written, then followed.

    ``recorded`` are its frames, ``given`` a calibration that was given; ``found`` is what its keyframes tell now,
    ``kept`` what an interrupted run has left of that, or why there is nothing; both are None of a run that was stopped.
    ``opened`` are its processes.
    """

    run: TrackRun
    work: SessionProblem
    opened: ExitStack
    recorded: RecordedFrames | None = None
    given: SessionCalibration | None = None
    found: SessionCalibration | RecordedSolution | str | None = None
    kept: tuple[SessionCalibration, Any] | str | None = None

    @property
    def path(self) -> Path:
        """Where what the keyframes tell is kept."""
        return self.run.out / (KEYFRAMES if self.run.settings.evidence == "masks" else KEYFRAMES_BY_IMAGES)

    def write(self) -> None:
        """Keep what the keyframes tell, once those of all arms are solved: a run leaves that of all arms, or none."""
        if self.found is not None and not self.run.stopped:
            write_keyframes(
                self.path,
                self.found.calibration if isinstance(self.found, RecordedSolution) else self.found,
                self.found.colours if isinstance(self.found, RecordedSolution) else None,
            )

    def follow(self) -> tuple[list[TrackResult], SessionCalibration] | str | None:
        """Return the results of the frames in order, and the calibration by which they were found, with its whole lag.

        Or why the recording cannot be solved so; or None if the run was stopped.
        """
        with self.opened:
            if self.recorded is None or self.run.stopped:
                return None
            used = self.kept
            if self.found is not None:
                used = read_keyframes(self.path, colours=self.run.settings.evidence != "masks")
            assert used is not None
            if isinstance(used, str):
                return used
            solution = RecordedSolution(self.recorded, self.given or used[0], used[1])
            self.run.notice(f"fitting {len(self.recorded.files)} frames")
            try:
                results = follow_window(solution, self.work)
            except _StoppedError:
                return None
        return results, with_lag(solution.calibration, self.run.settings.lag, self.run.clock)


def begin_recording(run: TrackRun) -> Begun[ArmInRecording]:
    """Solve the keyframes of a recording by which an instrument is followed, each frame with all others.

    What an interrupted run has left is used. Finish it by `solved_together` or `solved_alone`, then write and follow.

    Raises
    ------
    InputError
        A file of a frame is wrong.
    DvrkCmaesError
        A process died.
    """
    settings, body = run.settings, run.body
    frames, series = run.frames, series_of(run.session)
    if settings.lag is not None:
        frames, series = _less_lag(frames, series, run.clock, settings.lag)
    config = replace(settings.config, threads=1)
    with ExitStack() as stack:
        count = settings.workers or usable_cores()
        processes = stack.enter_context(instrument_pool(body.instrument, count, frames))
        by_body = partial(run_with_body, processes, instrument_digest(body.instrument), config)
        in_groups = partial(_in_groups, by_body, run.stop)
        lag = None if settings.lag is None else Lag(0.0, seconds=0.0)  # that is taken out already
        work = SessionProblem(series, body.instrument, settings.arm, config, in_groups, run.notice_stage, lag=lag)
        arm = ArmInRecording(run, work, ExitStack())
        try:
            begun = _begin_solution(arm, frames, series)
        except _StoppedError:
            return Begun.of(arm)
        opened = stack.pop_all()
    return Begun(partial(_finished, begun, opened, arm), begun.state)


def _finished(
    begun: Begun[ArmInRecording], opened: ExitStack, arm: ArmInRecording, others: Sequence[SessionState]
) -> ArmInRecording:
    """Finish an arm, whose processes are ``opened``; as one without frames where the run is stopped."""
    with ExitStack() as stack:
        stack.enter_context(opened)
        try:
            found = begun.finish(others)
        except _StoppedError:
            found = arm
        return replace(found, opened=stack.pop_all())


def _begin_solution(
    arm: ArmInRecording, frames: tuple[FrameFiles, ...], series: ReadingSeries | None
) -> Begun[ArmInRecording]:
    """Use the calibration that was given, or what an interrupted run has found; or else solve the keyframes.

    Those of frames without masks are solved with the colours of instrument and surroundings.
    """
    run, work, settings = arm.run, arm.work, arm.run.settings
    if run.stopped:
        raise _StoppedError
    by_masks = settings.evidence == "masks"
    times = np.array([run.clock.times[files.name] for files in frames])
    measured = RecordedFrames.of if by_masks else RecordedFrames.of_readings
    recorded, given = measured(frames, run.session.rig, series, times), settings.calibration
    arm = replace(arm, recorded=recorded)
    if given is not None:
        if not recorded.trusted.any():
            return Begun.of(replace(arm, kept="no frame has readings of the outer joints that are not frozen"))
        given = given if settings.lag is None else replace(given, lag=None)
        arm = replace(arm, given=given)
    if given is not None and by_masks:
        return Begun.of(replace(arm, kept=(given, None)))
    if (kept := read_keyframes(arm.path, colours=not by_masks)) is not None:
        run.notice(f"keyframes: solved by an interrupted run ({arm.path})")
        return Begun.of(replace(arm, kept=kept))
    if by_masks:
        return begin_keyframes(recorded, work, run.places).then(lambda found: replace(arm, found=found))
    begun = begin_images(recorded, given, settings.hints or Hints(), work, run.places)
    return begun.then(lambda pair: replace(arm, recorded=pair[0], found=pair[1]))


def _in_groups(
    run: Callable[..., list[Any]], stop: threading.Event | None, function: Callable[..., Any], tasks: Sequence[Any]
) -> list[Any]:
    """Apply a function to all tasks, some at a time; raises `_StoppedError` between them if the run is to stop."""
    values: list[Any] = []
    for first in range(0, len(tasks), _GROUP):
        if stop is not None and stop.is_set():
            raise _StoppedError
        values += run(function, tasks[first : first + _GROUP])
    return values


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


def with_lag(calibration: SessionCalibration, given: float | None, clock: TrackClock) -> SessionCalibration:
    """Return a calibration with the lag that was given added to the one that it has found beside that."""
    if given is None:
        return calibration
    found = calibration.applied_lag
    beside = 0.0 if found is None else found.in_seconds(1 / clock.interval)
    std = 0.0 if found is None or found.std_frames is None else found.std_frames * clock.interval
    factor = 1.0 if clock.unit == "s" else 1.0 / clock.interval
    interval = clock.interval if clock.unit == "s" else 1.0
    lag = Lag.of((given + beside) * factor, std * factor, clock.unit, interval, applied=True)
    return replace(calibration, lag=lag)
