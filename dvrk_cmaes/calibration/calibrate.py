"""Calibration of a session: one camera_from_base and joint offsets from all frames, and each frame's pose given these.

`calibrate_session` selects the usable frames, runs the alternating estimation and assembles the results.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, TypeVar

import numpy as np

from dvrk_cmaes.calibration.blocks import BASE_AXES, OBSERVABLE, OUTER_OFFSETS
from dvrk_cmaes.calibration.cables import SessionCables
from dvrk_cmaes.calibration.document import Agreement, SessionCalibration
from dvrk_cmaes.calibration.masks_and_sizes import MARGIN, covariance_of_margin
from dvrk_cmaes.calibration.model import ROLL, SessionModel, outer_readings
from dvrk_cmaes.calibration.session_camera import rotations_of_session, turns_of
from dvrk_cmaes.calibration.session_doubts import doubts_of, resting_on, unusual_insertion
from dvrk_cmaes.calibration.session_endoscope import UNDETERMINED_ROTATION, SessionEndoscope
from dvrk_cmaes.calibration.session_frame import (
    NOT_READ,
    FrameReport,
    LeaveOneOutPrediction,
    ReportTask,
    Run,
    SessionFrame,
    camera_remarks,
    report_task,
)
from dvrk_cmaes.calibration.session_problem import LEAST_FRAMES, ArmSession, ArmSetup
from dvrk_cmaes.calibration.solve import leave_one_out
from dvrk_cmaes.calibration.together import Begun, Outcome, solved_alone
from dvrk_cmaes.config import EstimateConfig, SessionConfig
from dvrk_cmaes.errors import InputError
from dvrk_cmaes.evidence.gather import Evidence
from dvrk_cmaes.geometry import Float64, inverse
from dvrk_cmaes.instrument import Instrument
from dvrk_cmaes.instrument.arm import Arm
from dvrk_cmaes.io.arguments import check_type
from dvrk_cmaes.joints.lag import Lag
from dvrk_cmaes.joints.prior import commanded_in, describe_commanded, with_commanded
from dvrk_cmaes.joints.series import ReadingSeries
from dvrk_cmaes.pose.config_check import check_config
from dvrk_cmaes.pose.doubts import reading_slipped, reasons
from dvrk_cmaes.pose.judge import exchanged_readings
from dvrk_cmaes.pose.refine.information import times
from dvrk_cmaes.results.result import Result
from dvrk_cmaes.silhouette import Body
from dvrk_cmaes.silhouette.prepare import prepare
from dvrk_cmaes.silhouette.threads import map_threaded, single_blas_thread

_UNDETERMINED_POSITION = 5e-3  # m, standard deviation of the base, above which its place is not determined

T = TypeVar("T")
R = TypeVar("R")


@dataclass(frozen=True, eq=False)
class SolvedSession:
    """A session's calibration and, by frame name, results and leave-one-out predictions.

    ``results`` has all frames: the results with the session's prior, and the own results of frames that are left out.
    ``leave_one_out`` has the predictions for the frames that were fitted, whether or not they agree with the session.
    """

    calibration: SessionCalibration
    results: dict[str, Result]
    leave_one_out: dict[str, LeaveOneOutPrediction]


def calibrate_session(
    frames: Sequence[SessionFrame],
    instrument: Instrument | Body | str = "lnd",
    *,
    series: ReadingSeries | None = None,
    arm: Arm = "classic",
    refine_camera: bool = False,
    lag: Lag | None = None,
    config: EstimateConfig | None = None,
    run: Run[Any, Any] | None = None,
    progress: Callable[[str, int], None] = lambda stage, count: None,
) -> SolvedSession:
    """Estimate a session's camera_from_base, the offsets of its joint readings, and its frames' poses given these.

    Parameters
    ----------
    frames
        Frames in the order they were taken, each with its own result (of `estimate`). Failed frames, and those without
        readings of the outer joints yaw, pitch, insertion and roll, are left out.
    instrument
        As in `estimate`.
    series
        All readings of the recording as functions of time, with the times of the frames' images, by which the lag is
        estimated; by default those of the frames themselves.
    arm
        The kinematics of the outer arm.
    refine_camera
        Whether to estimate focal length and principal point with the base, with a wide prior of 30 % and 300 px, and to
        solve the session with them. By default they are only compared with those of the frames' camera.
    lag
        The lag of the images that is taken out, zero for none; by default looked for in readings that move smoothly.
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
    for frame in frames:
        check_type("frames", frame, SessionFrame, "SessionFrames")
    settings, body = config or EstimateConfig(), instrument if isinstance(instrument, Body) else prepare(instrument)
    run = run or partial(in_threads, body, settings)
    setup = ArmSetup(series, body.instrument, arm, settings, run, progress, refine_camera, lag=lag)
    return solved_alone(begin_arm(frames, setup))[0]


def begin_arm(frames: Sequence[SessionFrame], setup: ArmSetup) -> Begun[tuple[SolvedSession, dict[str, Evidence]]]:
    """Select the usable frames of an arm, to be solved as `calibrate_session` does; what finishes it states the result.

    Also returned is what was found in the masks, of the first view of each frame that was fitted, by name, without its
    image, for drawings.
    """
    check_config(setup.config)
    started, names = time.perf_counter(), setup.instrument.joint_names
    left_out = {frame.name: text for frame in frames if (text := frame.lacks)}
    _check_number(len(frames) - len(left_out), left_out.values())
    usable = [frame for frame in frames if frame.name not in left_out]
    readings = {frame.name: frame.result.readings for frame in usable}
    series = setup.series or ReadingSeries.of_frames(readings, {frame.name: frame.time for frame in usable})
    commanded = commanded_in([*readings.values()], names)
    setup = replace(setup, series=series, config=with_commanded(setup.config, commanded, names))
    rotations = rotations_of_session(frame.result for frame in usable)
    if turns := turns_of(rotations):
        usable = [frame.with_turned_views(turns) for frame in usable]
    only = {name: next(own[name] for own in readings.values() if name in own) for name in commanded}
    arm = replace(ArmSession.of(setup, usable, rotations), left_out=left_out)
    return Begun(partial(_finished, tuple(frames), only, started), arm)


def _finished(
    frames: Sequence[SessionFrame], commanded: Mapping[str, float], started: float, outcome: Outcome | None
) -> tuple[SolvedSession, dict[str, Evidence]]:
    """State what was found of an arm with ``frames``.

    ``commanded`` are the only readings of joints whose readings never move, ``started`` when this began.
    """
    assert outcome is not None
    if isinstance(outcome, Exception):
        raise outcome
    with single_blas_thread():
        reports, left_out = reported(outcome)
    arm, settings = replace(outcome, left_out=left_out), outcome.setup.config.session
    by_name = dict(zip((frame.name for frame in arm.frames), reports, strict=True))
    results = {frame.name: frame.result for frame in frames}
    results |= {name: report.result for name, report in by_name.items()}
    predicted = {name: report.leave_one_out for name, report in by_name.items()}
    calibration = _stated(arm, commanded, results, predicted)
    if unusual := unusual_insertion(calibration, settings):
        calibration = replace(calibration, remarks=(*calibration.remarks, unusual))
    doubts = doubts_of(
        calibration,
        settings,
        without_lag=arm.lag.undetermined if arm.lag.nowhere else "",
        pixel_scale=arm.stored[0].views[0].evidence.camera.pixel_scale,
        ends_lacking=[by_name[name].end_missing for name in calibration.frames],
    )
    calibration = replace(calibration, doubts=doubts, seconds=time.perf_counter() - started)
    results = {name: resting_on(result, calibration) for name, result in results.items()}
    evidence = {frame.name: one.views[0].evidence for frame, one in zip(arm.frames, arm.stored, strict=True)}
    return SolvedSession(calibration, results, predicted), evidence


def _stated(
    arm: ArmSession,
    commanded: Mapping[str, float],
    results: Mapping[str, Result],
    predicted: Mapping[str, LeaveOneOutPrediction],
) -> SessionCalibration:
    """State what a session that is solved shows, without doubts."""
    model, calibration, lag, settings = arm.model, arm.calibration, arm.lag, arm.setup.config
    frames = tuple(frame.name for frame in arm.frames if frame.name not in arm.left_out)
    used = [results[name] for name in frames]
    qualities = [[one.quality.iou, one.quality.contour_px_95] for one in used if one.quality is not None]
    iou, contour_px_95 = np.median(qualities or [[0.0, 0.0]], axis=0).tolist()
    names = (*OUTER_OFFSETS, *model.names)
    own = slice(len(BASE_AXES) + len(names))
    # those who expect images of the session add what errors of all masks do to what is seen there
    given_camera = arm.solution.covariance[own, own]
    covariance = given_camera + arm.checked.covariance[own, own]
    endoscope = SessionEndoscope.of(arm)
    return SessionCalibration(
        instrument=arm.setup.instrument.name,
        camera_from_base=calibration.camera_from_base,
        offsets=dict(zip(names, calibration.offsets.tolist(), strict=True)),
        axes=(*BASE_AXES, *names),
        covariance=covariance,
        covariance_given_camera=given_camera,
        spreads=model.spreads,
        frames=frames,
        left_out=dict(sorted(arm.left_out.items())),
        leave_one_out={name: Agreement(one.iou, one.contour_px) for name, one in predicted.items() if name in frames},
        iou=iou,
        contour_px_95=contour_px_95,
        lag=lag.lag,
        lag_curve=lag.curve,
        cables=SessionCables.of(arm.cables),
        camera_errors=arm.checked.errors,
        endoscope=endoscope,
        blocks={**arm.checked.blocks, **arm.rig},
        commanded=dict(commanded),
        undetermined=_undetermined(arm, np.sqrt(np.diag(covariance)), endoscope, [*commanded]),
        remarks=_remarks(arm, used, [*commanded]),
        arm=arm.setup.arm,
        roll_offset=arm.setup.instrument.roll_offset,
        seed=settings.seed,
        config=arm.stated_settings,
    )


def _undetermined(
    arm: ArmSession, std: Float64, endoscope: SessionEndoscope | None, commanded: Sequence[str]
) -> tuple[str, ...]:
    """Describe what a session does not determine, by the standard deviations (K,) of its base and offsets."""
    texts, model, names = [], arm.model, (*OUTER_OFFSETS, *arm.model.names)
    if std[:3].max() > _UNDETERMINED_POSITION:
        texts.append(f"place of the base: standard deviation {std[:3].max() * 1e3:.1f} mm")
    if std[3:6].max() > UNDETERMINED_ROTATION:
        texts.append(
            f"rotation of the base: standard deviation {np.degrees(std[3:6].max()):.1f} deg; the arm hardly turns, and "
            "its rotation cannot be distinguished from the offset of roll"
        )
    for name, deviation, before in zip(names, std[6:], model.offset_std, strict=True):
        if deviation > OBSERVABLE * before:
            amount = f"{deviation * 1e3:.2f} mm" if name == "insertion" else f"{np.degrees(deviation):.1f} deg"
            texts.append(f"offset of {name}: standard deviation {amount}, as wide as expected beforehand")
    texts += [*arm.undetermined, *([] if endoscope is None else endoscope.undetermined)]
    if arm.lag.lag is None:
        texts.append(f"lag between images and readings: {arm.lag.undetermined}")
    if commanded:
        texts.append(f"offsets of {', '.join(commanded)} at other readings than the only one of each")
    return tuple(texts)


def _remarks(arm: ArmSession, used: Sequence[Result], commanded: Sequence[str]) -> tuple[str, ...]:
    """Return what was put right or is unusual; ``used`` are the results of the frames that agree."""
    instrument, of_joints = arm.setup.instrument, ([one.joints or {} for one in used], [one.readings for one in used])
    found, read = (
        np.array([[own.get(name, np.nan) for name in instrument.joint_names] for own in each]) for each in of_joints
    )
    return (
        *camera_remarks(arm.stored[0]),
        *(found.text for found in arm.rig.values() if found.applied),
        *([describe_commanded(commanded)] if commanded else []),
        *exchanged_readings(found, read, instrument),
        *arm.remarks,
    )


def in_threads(
    body: Body, config: EstimateConfig, function: Callable[[Body, EstimateConfig, T], R], tasks: Sequence[T]
) -> list[R]:
    """Apply a function to all tasks in threads."""
    return map_threaded(lambda task: function(body, config, task), tasks, config.threads)


def check_outer_joints(readings: Sequence[Mapping[str, float]]) -> None:
    """Refuse frames of which too few have readings of all outer joints, before they are estimated; InputError."""
    missing = int(np.isnan(outer_readings(readings)).any(axis=1).sum())
    _check_number(len(readings) - missing, [NOT_READ] * missing)


def _check_number(usable: int, why: Iterable[str]) -> None:
    """Raise `InputError` for too few usable frames, with the reasons why others are not."""
    if usable < LEAST_FRAMES:
        reasons = "; ".join(dict.fromkeys(why)) or "no more were given"
        raise InputError(f"session: expected at least {LEAST_FRAMES} usable frames, got {usable} ({reasons})")


def reported(arm: ArmSession) -> tuple[list[FrameReport], dict[str, str]]:
    """Return the reports of the frames in use, and by name the reason for each frame that is left out.

    The evidence of the arm, which is solved, is as seen by the camera that is used. Raises InputError if too few frames
    agree with the calibration.
    """
    setup, model, solution = arm.setup, arm.model, arm.solution
    setup.progress("leaving one out", len(arm.frames))
    disagreements = arm.disagreements
    arm.check_agreement(disagreements)
    named = zip(arm.frames, disagreements, strict=True)
    reasons = {**arm.left_out, **{frame.name: text for frame, text in named if text}}
    covariances = _covariances(arm)
    bases, tasks = model.base_from_root(arm.calibration.offsets), []
    for i, (frame, disagreement) in enumerate(zip(arm.frames, disagreements, strict=True)):
        task = ReportTask(
            arm.stored[i],
            frame.result if disagreement or frame.brief else replace(frame.result, config=arm.stated_settings),
            arm.fits[i],
            covariances[i],
            model.subset([i]).predict(leave_one_out(solution, i))[0],
            np.asarray(arm.fits[i].at.pose @ inverse(bases[i])),
            (*([disagreement] if disagreement else ()), *_describe_slips(model, i, setup.config.session)),
            agree=not disagreement,
            camera_errors=arm.checked.errors,
            brief=frame.brief,
        )
        tasks.append(task)
    return setup.run(report_task, tasks), reasons


def _covariances(arm: ArmSession) -> Float64:
    """Compute the covariance (N, D, D) of each frame's pose and joints, with that of the calibration and of the margin.

    Axes are the changes of the root's pose in its own axes and the joints, m and rad.
    """
    solution, by_margin = arm.solution, np.array([fit.by_margin for fit in arm.fits])
    frames = arm.outlines(keep_all=True).eliminated
    moved = frames.gain @ arm.model.jacobian(solution.calibration)
    own = times(frames.covariance, by_margin)
    of_margin = covariance_of_margin(arm.checked.blocks.get(MARGIN), own, moved, new=0.0)
    return np.asarray(frames.covariance + moved @ solution.covariance @ np.swapaxes(moved, 1, 2) + of_margin)


def _describe_slips(model: SessionModel, i: int, config: SessionConfig) -> list[str]:
    """Describe the joints whose readings have a large error in one frame, one text for each joint."""
    sigmas = model.inflation[i] * config.tail
    degrees = np.degrees(sigmas * model.deviations[ROLL:-6])
    errors = zip(("roll", *model.names), degrees.tolist(), sigmas.tolist(), strict=True)
    return reasons(*(reading_slipped(*error) for error in errors))
