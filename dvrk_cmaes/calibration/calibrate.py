"""Calibration of a session: one camera_from_base and joint offsets from all frames, and each frame's pose given these.

`calibrate_session` selects the usable frames, runs the alternating estimation and assembles the results.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, Literal, TypeVar

import numpy as np

from dvrk_cmaes.calibration.alternation import with_lag_of_modes
from dvrk_cmaes.calibration.document import SessionCalibration, describe_solution
from dvrk_cmaes.calibration.endoscope import Place
from dvrk_cmaes.calibration.endoscope_search import with_readings
from dvrk_cmaes.calibration.frame_reports import reported
from dvrk_cmaes.calibration.frame_task import LeaveOneOutPrediction, Run, SessionFrame
from dvrk_cmaes.calibration.imaging import checked_camera
from dvrk_cmaes.calibration.session_cables import SessionCables
from dvrk_cmaes.calibration.session_camera import CameraCheck, errors_of_camera
from dvrk_cmaes.calibration.session_doubts import doubts_of, resting_on, unusual_insertion
from dvrk_cmaes.calibration.session_endoscope import SessionEndoscope
from dvrk_cmaes.calibration.session_rig import rotations_of_session, turns_of
from dvrk_cmaes.calibration.session_state import LEAST_FRAMES, FoundMasks, SessionProblem, SessionState
from dvrk_cmaes.calibration.solution_trials import solve_session, with_masks_again, with_pieces_if_lost
from dvrk_cmaes.calibration.stored_frame import camera_remarks
from dvrk_cmaes.calibration.together import Begun, solved_alone, with_others
from dvrk_cmaes.config import EstimateConfig
from dvrk_cmaes.errors import InputError
from dvrk_cmaes.evidence.gather import Evidence
from dvrk_cmaes.frames.seen_view import PackedMask
from dvrk_cmaes.geometry import Float64
from dvrk_cmaes.instrument import Instrument
from dvrk_cmaes.instrument.arm import Arm
from dvrk_cmaes.joints.commanded import commanded_in, describe_commanded, with_commanded
from dvrk_cmaes.joints.lag import Lag
from dvrk_cmaes.joints.series import ReadingSeries
from dvrk_cmaes.pose.config_check import check_config
from dvrk_cmaes.pose.judge import exchanged_readings
from dvrk_cmaes.results.result import Result
from dvrk_cmaes.silhouette import Body
from dvrk_cmaes.silhouette.prepare import prepare
from dvrk_cmaes.silhouette.threads import map_threaded, single_blas_thread

T = TypeVar("T")
R = TypeVar("R")


@dataclass(frozen=True, eq=False)
class SolvedSession:
    """A session's calibration and, by frame name, results and leave-one-out predictions.

    ``results`` has all frames: the results with the session's prior, and the own results of frames that are left out.
    ``leave_one_out`` has the predictions for the frames that were fitted, whether or not they agree with the session.
    ``found_masks`` has the masks, by view, that were found again and used instead of the frames' own.
    """

    calibration: SessionCalibration
    results: dict[str, Result]
    leave_one_out: dict[str, LeaveOneOutPrediction]
    found_masks: Mapping[str, Mapping[str, PackedMask]] = field(default_factory=dict)


def calibrate_session(
    frames: Sequence[SessionFrame],
    instrument: Instrument | Body | str = "lnd",
    *,
    series: ReadingSeries | None = None,
    arm: Arm = "classic",
    refine_camera: bool = False,
    lag: Lag | Literal["auto"] | None = None,
    config: EstimateConfig | None = None,
    run: Run[Any, Any] | None = None,
    progress: Callable[[str, int], None] = lambda stage, count: None,
) -> SolvedSession:
    """Estimate a session's camera_from_base, the offsets of its joint readings, and its frames' poses given these.

    Parameters
    ----------
    frames
        Frames in the order they were taken, each with its own result (of `estimate`), whose readings must have the
        outer joints yaw, pitch, insertion and roll. Frames without these readings and failed frames are left out.
    instrument
        As in `estimate`.
    series
        All readings of the recording as functions of time, and the times of the frames' images: the lag between images
        and readings is estimated with them. By default the series is made of the frames' own readings.
    arm
        The kinematics of the outer arm.
    refine_camera
        Whether to estimate focal length and principal point beside the base, and to solve the session with them. Their
        prior is wide, 30 % and 300 px. By default they are only compared with those of the frames' camera.
    lag
        The lag of the images behind the readings that is taken out, zero for none. By default it is looked for in
        readings that have times or move smoothly from row to row, with ``auto`` in those of postures, too.
    config
        All settings; those of the calibration are in ``config.session``.
    run
        Applies a function to many tasks; by default in ``config.threads`` threads.
    progress
        Called before each stage with its name and the number of frames.

    Raises
    ------
    InputError
        Fewer than three frames are usable or agree; the arm does not move; the readings only fit another arm or tool;
        fewer than ten frames, or 5 mm of insertion, to refine the camera.
    """
    settings = EstimateConfig() if config is None else config
    body = instrument if isinstance(instrument, Body) else prepare(instrument)
    run = run or partial(in_threads, body, settings)
    problem = SessionProblem(series, body.instrument, arm, settings, run, progress, refine_camera, lag=lag)
    return solved_alone(begin_arm(frames, problem))[0]


@dataclass(frozen=True, eq=False)
class _ArmAlone:
    """An arm's session solved by itself: all ``frames``, those in use in ``state``, and why others are ``left_out``.

    ``commanded`` are the only readings of joints whose readings never move, ``started`` when this began.
    """

    frames: tuple[SessionFrame, ...]
    state: SessionState
    left_out: Mapping[str, str]
    commanded: Mapping[str, float]
    started: float


def begin_arm(
    frames: Sequence[SessionFrame], problem: SessionProblem, places: Sequence[Place] = ()
) -> Begun[tuple[SolvedSession, dict[str, Evidence]]]:
    """Solve a session by itself as `calibrate_session` does; what finishes it also returns what was found in the masks.

    That is of the first view of each frame that was fitted, by name, without its image, for drawings. ``places`` are
    those at which another arm found the endoscope.
    """
    check_config(problem.config)
    started, left_out, names = time.perf_counter(), _unusable(frames), problem.instrument.joint_names
    usable = [frame for frame in frames if frame.name not in left_out]
    series = _series_of(usable) if problem.series is None else problem.series
    readings = [frame.result.readings for frame in usable]
    commanded = commanded_in(readings, names)
    problem = replace(problem, series=series, config=with_commanded(problem.config, commanded, names))
    rotations = rotations_of_session(frame.result for frame in usable)
    if turns := turns_of(rotations):
        usable = [frame.with_turned_views(turns) for frame in usable]
    with single_blas_thread():
        state = solve_session(SessionState.of(problem, usable, rotations), places)
        if problem.config.session.masks_again:
            state = with_masks_again(state)
    only = {name: next(own[name] for own in readings if name in own) for name in commanded}
    return Begun(partial(_finished, _ArmAlone(tuple(frames), state, left_out, only, started)), state)


def _finished(alone: _ArmAlone, others: Sequence[SessionState]) -> tuple[SolvedSession, dict[str, Evidence]]:
    """Solve an arm's session with what the other arms tell, test it, and state it."""
    with single_blas_thread():
        state, check = checked_camera(with_others(alone.state, others))
    if (applied := state.lag.applied) is not None:
        option = f"taken out; other commands take it out with {applied.option}"
        state = state.noted(remarks=[f"{applied.describe()}: {option}"])
    with single_blas_thread():
        errors = errors_of_camera(check, state.stored[0].camera, state.problem.config.camera)
        reports, reasons = reported(state, errors)
    by_name = dict(zip((frame.name for frame in state.frames), reports, strict=True))
    results = {frame.name: frame.result for frame in alone.frames}
    results |= {name: report.result for name, report in by_name.items()}
    alone = replace(alone, state=state, left_out={**alone.left_out, **reasons})
    predicted = {name: report.leave_one_out for name, report in by_name.items()}
    calibration = _judged(alone, _stated(alone, check, errors, results, predicted))
    results = {name: resting_on(result, calibration) for name, result in results.items()}
    evidence = {frame.name: one.views[0].evidence for frame, one in zip(state.frames, state.stored, strict=True)}
    found_masks = (state.again or FoundMasks()).masks
    return SolvedSession(calibration, results, predicted, found_masks), evidence


def _stated(
    alone: _ArmAlone,
    check: CameraCheck,
    camera_errors: Float64,
    results: Mapping[str, Result],
    predicted: Mapping[str, LeaveOneOutPrediction],
) -> SessionCalibration:
    """State what a session that is solved tells, without doubts."""
    state, left_out, commanded = alone.state, alone.left_out, list(alone.commanded)
    settings, instrument, lag = state.problem.config, state.problem.instrument, state.lag
    names = tuple(frame.name for frame in state.frames)
    frames = tuple(name for name in names if name not in left_out)
    used = [results[name] for name in frames]
    qualities = [one.quality for one in used if one.quality is not None]
    endoscope = _endoscope(state, check)
    described = describe_solution(state.model, state.solution, check.covariance, settings)
    described["untold"] += (*state.notes.undetermined, *(() if endoscope is None else endoscope.untold))
    if lag.lag is None:
        described["untold"] += (f"lag between images and readings: {lag.undetermined}",)
    if commanded:
        described["untold"] += (f"offsets of {', '.join(commanded)} at other readings than the only one of each",)
    left_out_predictions = {name: one for name, one in predicted.items() if name in frames}
    return SessionCalibration(
        instrument=instrument.name,
        arm=state.problem.arm,
        roll_offset=instrument.roll_offset,
        frames=frames,
        left_out=dict(sorted(left_out.items())),
        leave_one_out={name: (one.iou, one.contour_px) for name, one in left_out_predictions.items()},
        leave_one_out_of_views=_of_views(left_out_predictions),
        iou=float(np.median([quality.iou for quality in qualities])) if qualities else 0.0,
        contour_px_95=float(np.median([quality.contour_px_95 for quality in qualities])) if qualities else 0.0,
        lag=lag.lag,
        lag_curve=lag.curve,
        cables=SessionCables.of(state.cables, names, lag.seconds()),
        camera=check.camera,
        camera_errors=camera_errors,
        endoscope=endoscope,
        shaft=check.shaft,
        blocks=dict(check.blocks),
        masks=state.imaging.masks,
        masks_again=(state.again or FoundMasks()).compared,
        rig=state.imaging.rig,
        commanded=dict(alone.commanded),
        remarks=(
            *camera_remarks(state.stored[0]),
            *(each.describe() for each in state.imaging.rig if each.applied),
            *([describe_commanded(commanded)] if commanded else []),
            *_exchanged_readings(used, instrument),
            *state.notes.remarks,
        ),
        seconds=time.perf_counter() - alone.started,
        config={**settings.as_dict(), "instrument": instrument.describe_limits(state.problem.arm)},
        **described,
    )


def _of_views(predicted: Mapping[str, LeaveOneOutPrediction]) -> dict[str, dict[str, tuple[float, float]]]:
    """Return the predictions of frames in each view of a rig, by view and frame; empty of one view."""
    views = dict.fromkeys(view for one in predicted.values() for view in one.views)
    if len(views) < 2:
        return {}
    return {view: {name: one.views[view] for name, one in predicted.items() if view in one.views} for view in views}


def _endoscope(state: SessionState, check: CameraCheck) -> SessionEndoscope | None:
    """Return what a session tells of an endoscope that moves; None of one that stands still."""
    given_camera = replace(state.solution, of_growth=None).covariance
    return SessionEndoscope.of(
        state.model,
        state.solution.calibration,
        given_camera,
        [frame.name for frame in state.frames],
        [frame.time for frame in state.frames],
        state.solution.covariance - given_camera + check.covariance,
    )


def _judged(alone: _ArmAlone, calibration: SessionCalibration) -> SessionCalibration:
    """Return a calibration with the doubts about the session as a whole, and with an unusual insertion remarked."""
    state, settings = alone.state, alone.state.problem.config.session
    if unusual := unusual_insertion(calibration, settings):
        calibration = replace(calibration, remarks=(*calibration.remarks, unusual))
    without_lag = state.lag.undetermined if state.lag.nowhere else ""
    pixel_scale = state.stored[0].views[0].evidence.camera.pixel_scale
    doubts = doubts_of(calibration, settings, without_lag=without_lag, pixel_scale=pixel_scale)
    return replace(calibration, doubts=doubts)


def find_lag(
    frames: Sequence[SessionFrame],
    instrument: Instrument | Body | str = "lnd",
    *,
    series: ReadingSeries | None = None,
    arm: Arm = "classic",
    config: EstimateConfig | None = None,
) -> tuple[Lag | None, str]:
    """Estimate the lag of a session's images behind its readings from the frames' own results, without fitting them.

    Parameters and errors are those of `calibrate_session`; the masks are not needed.

    Returns
    -------
    (Lag or None, str)
        The lag; or None and a text that says why the frames do not determine it.
    """
    settings = EstimateConfig() if config is None else config
    check_config(settings)
    body = instrument if isinstance(instrument, Body) else prepare(instrument)
    left_out = _unusable(frames)
    usable = [frame for frame in frames if frame.name not in left_out]
    if series is None:
        series = _series_of(usable)
    run = partial(in_threads, body, settings)
    state = SessionState.of(SessionProblem(series, body.instrument, arm, settings, run, lag="auto"), usable)
    lag = with_pieces_if_lost(with_lag_of_modes(with_readings(state))).lag
    return lag.lag, lag.undetermined


def _series_of(frames: Sequence[SessionFrame]) -> ReadingSeries | None:
    """Return the frames' own readings as functions of time."""
    return ReadingSeries.of_frames(
        {frame.name: frame.result.readings for frame in frames}, {frame.name: frame.time for frame in frames}
    )


def _exchanged_readings(used: Sequence[Result], instrument: Instrument) -> list[str]:
    """Say that the readings of both joints of the wrist may be exchanged in all frames that are used."""
    names = instrument.joint_names
    found = [[(one.joints or {}).get(name, np.nan) for name in names] for one in used]
    read = [[one.readings.get(name, np.nan) for name in names] for one in used]
    return exchanged_readings(np.array(found), np.array(read), instrument) if used else []


def in_threads(
    body: Body, config: EstimateConfig, function: Callable[[Body, EstimateConfig, T], R], tasks: Sequence[T]
) -> list[R]:
    """Apply a function to all tasks in threads."""
    return map_threaded(lambda task: function(body, config, task), tasks, config.threads)


def _unusable(frames: Sequence[SessionFrame]) -> dict[str, str]:
    """Return the reasons, by name, for the frames without a pose or the outer joints' readings.

    Raises `InputError` if there are too few others.
    """
    left_out = {frame.name: text for frame in frames if (text := frame.lacks)}
    if (usable := len(frames) - len(left_out)) < LEAST_FRAMES:
        why = "; ".join(dict.fromkeys(left_out.values())) or "no more were given"
        raise InputError(f"session: expected at least {LEAST_FRAMES} usable frames, got {usable} ({why})")
    return left_out
