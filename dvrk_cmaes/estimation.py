"""The one function that wires the stages: from a mask, a camera and joint readings to a pose with its trust."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dvrk_cmaes._version import __version__
from dvrk_cmaes.calibration.document import SessionCalibration
from dvrk_cmaes.calibration.prediction import SessionPose, try_session
from dvrk_cmaes.camera import Camera
from dvrk_cmaes.config import EstimateConfig
from dvrk_cmaes.evidence.gather import gather_evidence
from dvrk_cmaes.evidence.joint_prior import describe_limits, reading_distance, split_readings
from dvrk_cmaes.geometry import inverse
from dvrk_cmaes.instrument import Instrument
from dvrk_cmaes.instrument.arm import OUTER_JOINTS, Arm, base_from_root
from dvrk_cmaes.pose.config_check import check_config
from dvrk_cmaes.pose.quality import judge, measure_quality
from dvrk_cmaes.pose.refine.coarse_to_fine import LocalSearch, is_twin
from dvrk_cmaes.pose.search.global_search import find_candidates
from dvrk_cmaes.results.result import Alternative, Result
from dvrk_cmaes.silhouette import Body, Renderer
from dvrk_cmaes.silhouette.prepare import lightened, prepare

Float64 = NDArray[np.float64]


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
    config: EstimateConfig | None = None,
    warnings: Sequence[str] = (),
) -> Result:
    """Estimate the pose of the instrument in the camera and its true joint values from one mask.

    Safe to call from several threads; touches no files but those of an instrument given by name.

    Parameters
    ----------
    mask
        (H, W) bool, True on the instrument, of the camera's size.
    camera
        Intrinsics and distortion.
    joints
        Readings by name, rad (insertion in m): evidence with a spread, not the truth. Any may be missing. The outer
        arm's yaw, pitch, insertion and roll, if all are given, yield ``camera_from_base``.
    instrument
        A bundled instrument's name, a URDF's path, a loaded `Instrument`, or a prepared `Body`.
    ignore
        (H, W) bool, pixels that count neither way.
    keypoints
        (2, 2) px, the jaw tips in either order.
    arm
        ``classic`` or ``si``: the kinematics of the outer arm.
    session
        The calibration of the session that the frame belongs to: what it expects is tried first, and if that explains
        the mask, nothing else is. Its arm holds, then, and ``camera_from_base`` has the joints' offsets taken out.
    frame, warnings
        Written into the result.
    config
        All settings; the defaults suit a 640 x 480 endoscope.

    Returns
    -------
    Result
        Pose, joints, quality, covariance, alternatives; ``doubtful`` with reasons where the evidence does not suffice.

    Raises
    ------
    InputError
        Wrong sizes, an empty or full mask, an unknown joint, arm, search or refinement, values that are not finite,
        settings that make no sense.
    """
    settings = EstimateConfig() if config is None else config
    check_config(settings)
    body = instrument if isinstance(instrument, Body) else prepare(instrument)
    light = lightened(body, settings.search.detail_m)
    started = time.perf_counter()
    model = body.instrument
    given = dict(joints or {})
    readings, unused, outside = split_readings(model, given, settings)
    outer = [given.get(name) for name in OUTER_JOINTS]
    tips = None if keypoints is None else np.asarray(keypoints, dtype=np.float64)
    mask = np.asarray(mask, dtype=np.bool_)
    ignored = None if ignore is None else np.asarray(ignore, dtype=np.bool_)
    evidence = gather_evidence(mask, camera, model, ignore=ignored, keypoints=tips, seed=settings.seed)

    renderer = Renderer(body, camera, threads=settings.threads)
    notes: list[str] = []
    if session is not None:
        known = try_session(session, renderer, evidence, readings, given, settings)
        if isinstance(known, SessionPose):
            return Result(
                frame=frame,
                status="doubtful" if known.doubts else "ok",
                reasons=known.doubts,
                instrument=model.name,
                root_link=model.root_link,
                camera_from_root=known.camera_from_root,
                joints=dict(zip(model.joint_names, known.joints.tolist(), strict=True)),
                readings=given,
                warnings=(*warnings, *outside),
                unused=(*evidence.unused, *unused),
                camera_from_base=known.camera_from_base,
                source="session",
                quality=known.quality,
                covariance=known.covariance,
                seconds=time.perf_counter() - started,
                evaluations=known.evaluations + renderer.poses,
                rays=known.rays + renderer.rays,
                seed=settings.seed,
                version=__version__,
                config={**settings.as_dict(), "instrument": describe_limits(model, session.arm)},
            )
        notes.append(known)
    coarse = Renderer(light, camera, threads=settings.threads)
    candidates, search = find_candidates(coarse, evidence, readings, settings)
    local = LocalSearch(renderer, coarse, evidence, readings, settings)
    modes = local.refine(candidates)
    best = modes[0]

    qualities, confirming = measure_quality(
        renderer,
        evidence,
        readings,
        modes,
        settings.weights,
        decay=settings.decay_px,
        field=settings.distance_field,
    )
    reasons = judge(best, modes, qualities[0], evidence, readings, model, settings.trust)
    covariance = np.asarray(np.linalg.inv(best.information), dtype=np.float64)
    names = model.joint_names

    def alternative(i: int) -> Alternative:
        mode = modes[i]
        return Alternative(
            camera_from_root=mode.camera_from_root,
            joints=dict(zip(names, mode.joints.tolist(), strict=True)),
            loss=qualities[i].loss,
            iou=qualities[i].iou,
            relation="mirror twin" if model.has_twin and is_twin(model, best, mode) else "other mode",
            reading_distance_deg=reading_distance(readings, mode.joints),
        )

    base = None
    if all(value is not None for value in outer):
        reached = base_from_root(np.array(outer, dtype=np.float64), arm, roll_offset=model.roll_offset)
        base = np.asarray(best.camera_from_root @ inverse(reached))
    return Result(
        frame=frame,
        status="doubtful" if reasons else "ok",
        reasons=tuple(reasons),
        instrument=model.name,
        root_link=model.root_link,
        camera_from_root=best.camera_from_root,
        joints=dict(zip(names, best.joints.tolist(), strict=True)),
        readings=given,
        warnings=(*warnings, *outside, *notes),
        unused=(*evidence.unused, *unused),
        camera_from_base=base,
        quality=qualities[0],
        covariance=covariance,
        alternatives=tuple(alternative(i) for i in range(1, len(modes))),
        seconds=time.perf_counter() - started,
        evaluations=search.evaluations + local.silhouettes + renderer.poses,
        rays=search.renderer.rays + local.rays + renderer.rays + confirming,
        seed=settings.seed,
        version=__version__,
        config={**settings.as_dict(), "instrument": describe_limits(model, arm)},
    )
