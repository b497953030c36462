"""A recording on disk followed with its own calibration: keyframes are solved together, then every frame is fitted."""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import Any, Final

import numpy as np

from dvrk_cmaes.calibration.document import SessionCalibration
from dvrk_cmaes.calibration.session_state import SessionProblem
from dvrk_cmaes.calibration.together import Solving
from dvrk_cmaes.frames.frame import FrameFiles
from dvrk_cmaes.joints.lag import Lag
from dvrk_cmaes.joints.series import ReadingSeries
from dvrk_cmaes.results.tracked import TrackResult
from dvrk_cmaes.runs.inputs import instrument_digest
from dvrk_cmaes.runs.instrument_processes import instrument_processes, run_with_body
from dvrk_cmaes.runs.processes import usable_cores
from dvrk_cmaes.runs.recorded import RecordedSolution, follow_window
from dvrk_cmaes.runs.recorded_images import solving_images
from dvrk_cmaes.runs.recorded_keyframes import (
    KEYFRAMES,
    KEYFRAMES_BY_IMAGES,
    RecordedFrames,
    read_keyframes,
    solving_keyframes,
    write_keyframes,
)
from dvrk_cmaes.runs.track_clock import TrackClock, series_of
from dvrk_cmaes.runs.track_frames import TrackRun
from dvrk_cmaes.segment.segmentation import Hints

_GROUP: Final = 24  # tasks after which a run looks whether it is to stop


class _StoppedError(Exception):
    """The run is to end."""


def following_recorded(run: TrackRun) -> Solving[tuple[list[TrackResult], SessionCalibration] | str | None]:
    """Follow an instrument through a recording, each frame with all others; OUT/keyframes.json keeps the calibration.

    What an interrupted run has left there is used. Run it by `solved_together` or `solved_alone`.

    Returns
    -------
    tuple or str or None
        The results of the frames in order, and the calibration by which they were found, with its whole lag; or why the
        recording cannot be solved so; or None if the run was stopped.

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
    with instrument_processes(body.instrument, settings.workers or usable_cores(), frames) as processes:
        by_body = partial(run_with_body, processes, instrument_digest(body.instrument), config)
        in_groups = partial(_in_groups, by_body, run.stop)
        lag = None if settings.lag is None else Lag(0.0, seconds=0.0)  # that is taken out already
        work = SessionProblem(series, body.instrument, settings.arm, config, in_groups, run.notice_stage, lag=lag)
        try:
            solved = yield from _solving(run, frames, series, work)
            if isinstance(solved, str):
                return solved
            run.notice(f"fitting {len(frames)} frames")
            results = follow_window(solved, work)
        except _StoppedError:
            return None
    return results, with_lag(solved.calibration, settings.lag, run.clock)


def _solving(
    run: TrackRun, frames: tuple[FrameFiles, ...], series: ReadingSeries | None, work: SessionProblem
) -> Solving[RecordedSolution | str]:
    """Return the calibration that was given, that an interrupted run has found, or that of the keyframes.

    That of frames without masks is with the colours of instrument and surroundings. A text says why there is none. What
    was found is written once all arms are solved: an interrupted run leaves the solutions of all arms, or none.
    """
    if run.stop is not None and run.stop.is_set():
        raise _StoppedError
    settings, by_masks = run.settings, run.settings.evidence == "masks"
    times = np.array([run.clock.times[files.name] for files in frames])
    measured = RecordedFrames.of if by_masks else RecordedFrames.of_readings
    recorded, given = measured(frames, run.session.rig, series, times), settings.calibration
    if given is not None:
        if not recorded.trusted.any():
            return "no frame has readings of the outer joints that are not frozen"
        given = given if settings.lag is None else replace(given, lag=None)
    path = run.out / (KEYFRAMES if by_masks else KEYFRAMES_BY_IMAGES)
    used: tuple[SessionCalibration, Any] | str | None
    found: SessionCalibration | RecordedSolution | str | None = None
    if given is not None and by_masks:
        used = given, None
    elif (used := read_keyframes(path, colours=not by_masks)) is not None:
        run.notice(f"keyframes: solved by an interrupted run ({path})")
    elif by_masks:
        found = yield from solving_keyframes(recorded, work, run.places)
    else:
        hints = settings.hints or Hints()
        recorded, found = yield from solving_images(recorded, given, hints, work, run.places)
    yield None  # for arms with solutions that are kept or given, too: all wait for each other equally often
    if run.stop is not None and run.stop.is_set():
        raise _StoppedError
    if found is not None:
        solved = found.calibration if isinstance(found, RecordedSolution) else found
        write_keyframes(path, solved, found.colours if isinstance(found, RecordedSolution) else None)
        used = read_keyframes(path, colours=not by_masks)
    yield None
    assert used is not None
    return used if isinstance(used, str) else RecordedSolution(recorded, given or used[0], used[1])


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
