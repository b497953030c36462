"""A recording on disk followed with its own calibration: keyframes are solved together, then every frame is fitted."""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, Final

import numpy as np

from dvrk_cmaes.calibration.document import SessionCalibration
from dvrk_cmaes.frames.frame import FrameFiles
from dvrk_cmaes.frames.session_folder import Session
from dvrk_cmaes.joints.lag import Lag
from dvrk_cmaes.joints.series import ReadingSeries
from dvrk_cmaes.results.tracked import TrackResult
from dvrk_cmaes.runs.digests import instrument_digest
from dvrk_cmaes.runs.instrument_processes import instrument_processes, run_with_body
from dvrk_cmaes.runs.processes import usable_cores
from dvrk_cmaes.runs.recorded import fit_all, predict
from dvrk_cmaes.runs.recorded_keyframes import (
    KEYFRAMES,
    RecordedFrames,
    read_keyframes,
    solve_keyframes,
    write_keyframes,
)
from dvrk_cmaes.runs.recorded_results import judge_all, results_of, smooth_frames
from dvrk_cmaes.runs.track_clock import TrackClock, series_of
from dvrk_cmaes.runs.track_frames import TrackSettings
from dvrk_cmaes.silhouette import Body

_GROUP: Final = 24  # tasks after which a run looks whether it is to stop


class _StoppedError(Exception):
    """The run is to end."""


@dataclass(frozen=True, eq=False)
class RecordedTracks:
    """Results of the frames in order, and the calibration by which they were found, with its whole lag."""

    results: list[TrackResult]
    calibration: SessionCalibration


def why_causal(settings: TrackSettings) -> str | None:
    """Say why a recording cannot be solved by its keyframes at all; None if it can be tried."""
    if settings.evidence != "masks":
        return "without masks of all frames"
    if not settings.use_joints:
        return "without readings"
    return None


def follow_recorded(
    session: Session,
    frames: tuple[FrameFiles, ...],
    clock: TrackClock,
    body: Body,
    settings: TrackSettings,
    out: Path,
    *,
    stop: threading.Event | None = None,
    notice: Callable[[str], None] = lambda text: None,
) -> RecordedTracks | str | None:
    """Follow an instrument through a recording, each frame with all others; OUT/keyframes.json keeps the calibration.

    Parameters
    ----------
    session, frames, clock
        The session, those of its frames that are followed, and their times.
    body, settings
        The instrument; what is followed and how.
    out
        Folder for keyframes.json; what an interrupted run has left there is used.
    stop
        When set, the run ends soon.
    notice
        Called with a line about each stage.

    Returns
    -------
    RecordedTracks or str or None
        The results; or why the recording cannot be solved so; or None if the run was stopped.

    Raises
    ------
    InputError
        A file of a frame is wrong.
    DvrkCmaesError
        A process died.
    """
    series = series_of(session)
    if settings.lag is not None:
        frames, series = _less_lag(frames, series, clock, settings.lag)
    times = np.array([clock.times[files.name] for files in frames])
    recorded = RecordedFrames.of(frames, session.rig, series, times)
    workers = settings.workers or usable_cores()
    config = replace(settings.config, threads=1)
    with instrument_processes(body.instrument, workers, frames) as processes:
        by_body = partial(run_with_body, processes, instrument_digest(body.instrument), config)
        run = partial(_in_groups, by_body, stop)
        try:
            calibration = _calibration(recorded, body, settings, out, run, notice)
            if isinstance(calibration, str):
                return calibration
            notice(f"fitting {len(frames)} frames")
            predicted = predict(recorded, calibration, body.instrument.joint_names)
            fits = fit_all(recorded, calibration, predicted, run)
            smoothed = smooth_frames(recorded, predicted, fits, calibration, body.instrument)
            judged = judge_all(smoothed, fits, run)
        except _StoppedError:
            return None
    results = results_of(recorded, calibration, predicted, fits, smoothed, judged, body, config)
    return RecordedTracks(results, _with_lag(calibration, settings.lag, clock))


def _calibration(
    recorded: RecordedFrames,
    body: Body,
    settings: TrackSettings,
    out: Path,
    run: Callable[..., list[Any]],
    notice: Callable[[str], None],
) -> SessionCalibration | str:
    """Return the calibration that was given, that an interrupted run has found, or that of the keyframes."""
    if settings.calibration is not None:
        given = settings.calibration
        if not recorded.trusted.any():
            return "no frame has readings of the outer joints that are not frozen"
        return given if settings.lag is None else replace(given, lag=None)
    found = read_keyframes(out)
    if found is None:
        found = solve_keyframes(
            recorded,
            body,
            settings.arm,
            replace(settings.config, threads=1),
            run,
            lambda stage, count: notice(f"{stage}: {count} frames"),
        )
        found = write_keyframes(out, found)
    else:
        notice(f"keyframes: solved by an interrupted run ({out / KEYFRAMES})")
    return found


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


def _with_lag(calibration: SessionCalibration, given: float | None, clock: TrackClock) -> SessionCalibration:
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
