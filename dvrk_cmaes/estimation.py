"""The package's main function: the pose of the instrument from a mask, a camera and joint readings."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from time import perf_counter

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dvrk_cmaes._version import __version__
from dvrk_cmaes.calibration.document import SessionCalibration
from dvrk_cmaes.calibration.prediction import fit_session_pose
from dvrk_cmaes.camera import Camera
from dvrk_cmaes.config import EstimateConfig
from dvrk_cmaes.evidence.gather import gather_evidence
from dvrk_cmaes.evidence.joint_prior import describe_limits, split_readings
from dvrk_cmaes.instrument import Instrument
from dvrk_cmaes.instrument.arm import Arm, find_camera_from_base
from dvrk_cmaes.pose.config_check import check_config
from dvrk_cmaes.pose.expected_error import locate_tips
from dvrk_cmaes.pose.find_pose import FoundPose, find_pose
from dvrk_cmaes.results.result import Result, Source
from dvrk_cmaes.silhouette import Body, Renderer
from dvrk_cmaes.silhouette.prepare import decimated_body, prepare


def estimate(
    mask: NDArray[np.bool_],
    camera: Camera,
    joints: Mapping[str, float] | None = None,
    instrument: Instrument | Body | str = "lnd",
    *,
    ignore: NDArray[np.bool_] | None = None,
    keypoints: ArrayLike | None = None,
    arm: Arm = "classic",
    session: SessionCalibration | None = None,
    frame: str = "",
    time: float | None = None,
    config: EstimateConfig | None = None,
    warnings: Sequence[str] = (),
) -> Result:
    """Estimate the pose of the instrument in the camera and its true joint values from one mask.

    May be called from several threads at once. Reads no files, except those of an instrument that is given by name.

    Parameters
    ----------
    mask
        (H, W) bool, True on the instrument, of the camera's size.
    camera
        Intrinsics and distortion.
    joints
        Readings by joint name, rad (insertion: m), used as measurements with a standard deviation. Any may be missing.
        The outer joints yaw, pitch, insertion and roll, if all are given, yield ``camera_from_base``.
    instrument
        A bundled instrument's name, a URDF's path, a loaded `Instrument`, or a prepared `Body`.
    ignore
        (H, W) bool, pixels that count neither way.
    keypoints
        (2, 2) px, the jaw tips in either order.
    arm
        ``classic`` or ``si``: the kinematics of the outer arm.
    session
        Calibration of the session that the frame belongs to. The pose that it predicts is refined first; only if that
        does not explain the mask is the frame searched as without a session. Where the prediction holds, the
        calibration's arm is used instead of ``arm``, and ``camera_from_base`` is computed with the joints' offsets.
        If its camera was refined, the same change is applied to ``camera``.
    frame, time, warnings
        The frame's name, the time of its image, s, and warnings to add; they are copied into the result.
    config
        All settings. The defaults are chosen for images of 640 x 480 pixels.

    Returns
    -------
    Result
        Pose, joints, quality, covariance and alternatives. Its status is ``doubtful``, with reasons, where the
        evidence does not determine the pose.

    Raises
    ------
    InputError
        Arrays of the wrong size, an empty or full mask, an unknown joint, arm, search or refinement method, values
        that are not finite, or settings outside their range.
    """
    settings = EstimateConfig() if config is None else config
    check_config(settings)
    body = instrument if isinstance(instrument, Body) else prepare(instrument)
    decimated = decimated_body(body, settings.search.detail_m)
    started = perf_counter()
    model, given = body.instrument, dict(joints or {})
    if session is not None:
        camera = session.corrected(camera)
    readings, unused, outside = split_readings(model, given, settings)
    evidence = gather_evidence(
        np.asarray(mask, dtype=np.bool_),
        camera,
        model,
        ignore=None if ignore is None else np.asarray(ignore, dtype=np.bool_),
        keypoints=None if keypoints is None else np.asarray(keypoints, dtype=np.float64),
        seed=settings.seed,
    )
    renderer = Renderer(body, camera, threads=settings.threads)
    predicted = None if session is None else fit_session_pose(session, renderer, evidence, readings, given, settings)
    source: Source
    if session is not None and isinstance(predicted, FoundPose):
        found, source, arm = predicted, "session", session.arm
        base = found.camera_from_base
    else:
        found, source = find_pose(renderer, decimated, evidence, readings, settings), "frame"
        base = find_camera_from_base(found.camera_from_root, given, arm, roll_offset=model.roll_offset)
    tips, tips_px = locate_tips(model, camera, found.camera_from_root, found.joints)
    return Result(
        frame=frame,
        status="doubtful" if found.reasons else "ok",
        reasons=found.reasons,
        instrument=model.name,
        root_link=model.root_link,
        camera_from_root=found.camera_from_root,
        joints=dict(zip(model.joint_names, found.joints.tolist(), strict=True)),
        readings=given,
        warnings=(*warnings, *outside, *([predicted] if isinstance(predicted, str) else ())),
        unused=(*evidence.unused, *unused),
        camera_from_base=base,
        source=source,
        quality=found.quality,
        time=time,
        tips=tips,
        tips_px=tips_px,
        covariance=found.covariance,
        expected_error=found.expected_error,
        mode_probability=found.mode_probability,
        alternatives=found.alternatives,
        seconds=perf_counter() - started,
        evaluations=found.evaluations,
        rays=found.rays,
        seed=settings.seed,
        version=__version__,
        config={**settings.as_dict(), "instrument": describe_limits(model, arm)},
        model=model,
    )
