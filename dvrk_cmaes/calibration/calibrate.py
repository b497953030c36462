"""Solve a session's frames together: one camera_from_base and one offset a joint, and every frame again with these.

What can be used is sorted out here, and what was found is put together; the work itself is `dvrk_cmaes.calibration.alternation`.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.calibration.alternation import LEAST_FRAMES, Run, SessionRounds
from dvrk_cmaes.calibration.document import SessionCalibration, describe_solution
from dvrk_cmaes.calibration.frame_task import SessionFrame
from dvrk_cmaes.calibration.model import outer_readings
from dvrk_cmaes.config import EstimateConfig
from dvrk_cmaes.errors import InputError
from dvrk_cmaes.evidence.joint_prior import describe_limits
from dvrk_cmaes.instrument import Instrument
from dvrk_cmaes.instrument.arm import Arm
from dvrk_cmaes.pose.config_check import check_config
from dvrk_cmaes.pose.parallel import each
from dvrk_cmaes.results.paths import FramePictures
from dvrk_cmaes.results.result import Result
from dvrk_cmaes.silhouette import Body
from dvrk_cmaes.silhouette.prepare import prepare

Float64 = NDArray[np.float64]
T = TypeVar("T")
R = TypeVar("R")


@dataclass(frozen=True, eq=False)
class SolvedSession:
    """A session's calibration, and all its frames' results by name: solved again, or as they were.

    ``pictures`` by name, where they were asked for.
    """

    calibration: SessionCalibration
    results: dict[str, Result]
    pictures: dict[str, FramePictures]


def calibrate_session(
    frames: Sequence[SessionFrame],
    instrument: Instrument | Body | str = "lnd",
    *,
    arm: Arm = "classic",
    config: EstimateConfig | None = None,
    run: Run[Any, Any] | None = None,
    draw: bool = False,
    progress: Callable[[str, int], None] = lambda stage, count: None,
) -> SolvedSession:
    """Calibrate a session: camera_from_base, and the offsets of its joint readings.

    Parameters
    ----------
    frames
        Frames in the order they were taken, each with its own result (of `estimate`), whose readings must have the
        outer joints yaw, pitch, insertion and roll. Frames without, and failed ones, are left out.
    instrument
        As in `estimate`.
    arm
        The kinematics of the outer arm.
    config
        All settings; ``config.session`` says how frames hang together.
    run
        How to apply a function to many tasks; unless given, on the configuration's threads.
    draw
        Draw each frame, too: its result, and what the other frames predict.
    progress
        Told the stage and the number of frames that it is about to solve.

    Raises
    ------
    InputError
        Fewer than three usable frames; an arm that does not move; readings that only fit another arm or tool.
    """
    settings = EstimateConfig() if config is None else config
    check_config(settings)
    body = instrument if isinstance(instrument, Body) else prepare(instrument)
    started = time.perf_counter()
    if run is None:
        run = partial(_in_threads, body, settings)
    usable, left_out = _usable(frames, body.instrument)
    work = SessionRounds(usable, body.instrument, arm, settings, run, progress)
    work.choose()
    work.settle()
    reports, reasons = work.report(draw)
    results = {frame.name: frame.result for frame in frames}
    results |= {frame.name: one.result for frame, one in zip(work.frames, reports, strict=True)}
    left_out |= reasons
    used = [results[frame.name].quality for frame in work.frames if frame.name not in left_out]
    known = [quality for quality in used if quality is not None]
    described = describe_solution(work.model, work.solution, settings)
    calibration = SessionCalibration(
        instrument=body.instrument.name,
        arm=arm,
        roll_offset=body.instrument.roll_offset,
        frames=tuple(frame.name for frame in work.frames if frame.name not in left_out),
        left_out=dict(sorted(left_out.items())),
        leave_one_out={
            frame.name: (one.left_out_iou, one.left_out_px)
            for frame, one in zip(work.frames, reports, strict=True)
            if frame.name not in left_out
        },
        iou=float(np.median([quality.iou for quality in known])) if known else 0.0,
        contour_px_95=float(np.median([quality.contour_px_95 for quality in known])) if known else 0.0,
        lag=work.lag,
        warnings=tuple(work.warnings),
        seconds=time.perf_counter() - started,
        config={**settings.as_dict(), "instrument": describe_limits(body.instrument, arm)},
        **described,
    )
    pictures = {one.result.frame: one.pictures for one in reports if one.pictures is not None}
    return SolvedSession(calibration, results, pictures)


def _in_threads(
    body: Body, config: EstimateConfig, function: Callable[[Body, EstimateConfig, T], R], tasks: Sequence[T]
) -> list[R]:
    return each(lambda task: function(body, config, task), tasks, config.threads)


def _usable(frames: Sequence[SessionFrame], instrument: Instrument) -> tuple[list[SessionFrame], dict[str, str]]:
    """Sort out frames that say nothing about the base, with the reason."""
    left_out = {}
    for frame in frames:
        if frame.result.camera_from_root is None or frame.result.covariance is None:
            left_out[frame.name] = "no pose: " + "; ".join(frame.result.reasons or ("the frame failed",))
        elif np.isnan(outer_readings([frame.result.readings])).any():
            left_out[frame.name] = "no readings of all outer joints (yaw, pitch, insertion, roll)"
    usable = [frame for frame in frames if frame.name not in left_out]
    if len(usable) < LEAST_FRAMES:
        why = "; ".join(dict.fromkeys(left_out.values())) or "no more were given"
        raise InputError(f"session: expected at least {LEAST_FRAMES} usable frames, got {len(usable)} ({why})")
    return usable, left_out
