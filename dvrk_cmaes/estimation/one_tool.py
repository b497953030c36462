"""The package's main function: the pose of the instrument from a mask, a camera and joint readings."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from dvrk_cmaes.camera import Camera, Rig
from dvrk_cmaes.camera.fields import known_mistakes
from dvrk_cmaes.camera.rig import remarks_on_cameras
from dvrk_cmaes.config import EstimateConfig, __version__
from dvrk_cmaes.frames.seen_view import SeenView, left_out_views, seen_views, shown_views
from dvrk_cmaes.geometry import Bool, inverse
from dvrk_cmaes.instrument import Instrument
from dvrk_cmaes.instrument.arm import Arm, check_arm, find_camera_from_base
from dvrk_cmaes.io.arguments import check_type
from dvrk_cmaes.joints.prior import Readings, split_readings
from dvrk_cmaes.pose.config_check import check_config
from dvrk_cmaes.pose.expected_error import locate_tips
from dvrk_cmaes.pose.find_pose import FoundPose, find_pose
from dvrk_cmaes.pose.judge import exchanged_readings
from dvrk_cmaes.pose.search.starts import PoseCandidate
from dvrk_cmaes.pose.views import HELD, FrameView, held_in, without
from dvrk_cmaes.results.parts import posed
from dvrk_cmaes.results.result import Result, Source, modes_of
from dvrk_cmaes.silhouette import Body, Renderer
from dvrk_cmaes.silhouette.prepare import decimated_body, prepare
from dvrk_cmaes.silhouette.threads import single_blas_thread

if TYPE_CHECKING:
    from dvrk_cmaes.calibration.document import SessionCalibration
    from dvrk_cmaes.segment.segmentation import SegmentSettings

_ROUGH_PX = 1.5  # of the contour at wrist and jaws (rms, at 640 px of width), from which held things are sought


@dataclass(frozen=True, eq=False)
class FrameMethod:
    """How a frame is solved: the kinematics of its arm, the settings, and the calibration of its session.

    ``segment`` is the model by which masks are found in images of frames without.
    """

    arm: Arm
    config: EstimateConfig
    session: SessionCalibration | None = None
    segment: SegmentSettings | None = None


def estimate(
    mask: Bool | Mapping[str, Bool | None],
    camera: Camera | Rig,
    joints: Mapping[str, float] | None = None,
    instrument: Instrument | Body | str | Path = "lnd",
    *,
    ignore: Bool | Mapping[str, Bool | None] | None = None,
    keypoints: ArrayLike | Mapping[str, ArrayLike | None] | None = None,
    arm: Arm = "classic",
    session: SessionCalibration | None = None,
    start: Result | None = None,
    frame: str = "",
    time: float | None = None,
    config: EstimateConfig | None = None,
    warnings: Sequence[str] = (),
) -> Result:
    """Estimate the pose of the instrument in the camera and its true joint values from one mask, or one of each view.

    May be called from several threads at once. Reads no files, except those of an instrument that is given by name.

    Parameters
    ----------
    mask
        (H, W) bool, True on the instrument, of the camera's size. With a rig, the masks by name of the view; a view
        without a mask, or with an empty one, is not used.
    camera
        Intrinsics and distortion. Or a rig of several cameras: the pose is then in the first one's frame, whether or
        not that has a mask.
    joints
        Readings by joint name, rad (insertion: m), used as measurements with a standard deviation. Any may be missing.
        The outer joints yaw, pitch, insertion and roll, if all are given, yield ``camera_from_base``.
    instrument
        A bundled instrument's name, a URDF's path, a loaded `Instrument`, or a prepared `Body`.
    ignore
        (H, W) bool, pixels that count neither way; by view with a rig.
    keypoints
        (2, 2) px, the jaw tips in either order; by view with a rig.
    arm
        ``classic`` or ``si``: the kinematics of the outer arm.
    session
        Calibration of the session that the frame belongs to. The pose that it predicts is refined first; only if that
        does not explain the mask is the frame searched as without a session. Where the prediction holds, the
        calibration's arm is used instead of ``arm``, and ``camera_from_base`` is computed with the joints' offsets.
        If its camera was refined, the same change is applied to ``camera``.
    start
        An earlier result of the frame, from other evidence: its pose and its alternatives are refined instead of those
        of a search.
    frame
        The frame's name, for the result.
    time
        The time of the image, s, for the result.
    config
        All settings. The defaults are chosen for images of 640 x 480 pixels.
    warnings
        Warnings to add to those of the result.

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
    return estimate_views(
        seen_views(mask, camera, ignore, keypoints),
        joints,
        instrument,
        FrameMethod(arm, EstimateConfig() if config is None else config, session),
        named=isinstance(camera, Rig),
        start=start,
        frame=frame,
        time=time,
        warnings=warnings,
    )


@single_blas_thread()
def estimate_views(
    seen: Sequence[SeenView],
    joints: Mapping[str, float] | None,
    instrument: Instrument | Body | str | Path,
    method: FrameMethod,
    *,
    named: bool,
    start: Result | None = None,
    frame: str = "",
    time: float | None = None,
    warnings: Sequence[str] = (),
) -> Result:
    """Estimate the pose of the instrument in the first of some views, as `estimate` does.

    ``named``: whether the result says which views were used, and which not.
    """
    settings, arm, session = method.config, method.arm, method.session
    body = _prepared(instrument, method, start)
    bodies = body, decimated_body(body, settings.search.detail_m)
    started = perf_counter()
    model, given = body.instrument, {} if joints is None else joints
    if session is not None:
        seen = session.corrected_views(seen)
    reference, shown = seen[0], shown_views(seen)
    readings, unused, outside = split_readings(model, given, settings)
    given = {name: float(value) for name, value in given.items()}
    views: Sequence[FrameView] = _frame_views(shown, body, settings)
    predicted = None
    if session is not None and shown[0] is reference:
        from dvrk_cmaes.calibration.prediction import fit_session_pose

        predicted = fit_session_pose(session, views, readings, given, settings, frame=frame, time=time)
    source: Source
    if session is not None and isinstance(predicted, FoundPose):
        found, source, arm = predicted, "session", session.arm
        base = found.camera_from_base
    else:
        found, views, source = *_searched(shown, views, bodies, readings, settings, start), "frame"
        base = find_camera_from_base(found.at.pose, given, arm, roll_offset=model.roll_offset)
    tips, tips_px = locate_tips(model, reference.camera, found.at)
    of_cameras = remarks_on_cameras(seen)
    reasons = (*(known_mistakes(of_cameras) if session is None else ()), *found.reasons)
    result = Result(
        frame=frame,
        status="doubtful" if reasons else "ok",
        reasons=reasons,
        **model.stated,
        **found.stated,
        camera_from_root=found.at.pose,
        joints=dict(zip(model.joint_names, found.at.joints.tolist(), strict=True)),
        readings=given,
        warnings=(*warnings, *outside, *([predicted] if isinstance(predicted, str) else ()), *found.notes),
        remarks=(*of_cameras, *exchanged_readings(found.at.joints[None], readings.values[None], model)),
        unused=(*(left_out_views(seen) if named else ()), *_unused_evidence(views), *unused),
        camera_from_base=base,
        source=source,
        time=time,
        tips=tips,
        tips_px=tips_px,
        views=tuple(view.name for view in views) if named else (),
        view_fits=found.views if len(views) > 1 else (),
        seconds=perf_counter() - started,
        seed=settings.seed,
        version=__version__,
        config={**settings.as_dict(), "instrument": model.describe_limits(arm)},
        model=model,
        renderer=Renderer(body, reference.camera),
    )
    if session is None:
        return result
    from dvrk_cmaes.calibration.session_doubts import resting_on

    return resting_on(result, session)


def _prepared(instrument: Instrument | Body | str | Path, method: FrameMethod, start: Result | None) -> Body:
    """Prepare an instrument, and check the method for it and what to start from; `InputError` as `estimate`."""
    check_config(method.config)
    check_arm(method.arm)
    body = prepare(instrument)
    if method.session is not None:
        _check_session(method.session, body.instrument.name, None if method.arm == "classic" else method.arm)
    if start is not None:
        check_type("start", start, Result, "a Result")
    return body


def _searched(
    seen: Sequence[SeenView],
    views: Sequence[FrameView],
    bodies: tuple[Body, Body],
    readings: Readings,
    settings: EstimateConfig,
    start: Result | None,
) -> tuple[FoundPose, Sequence[FrameView]]:
    """Search a frame for the pose, or refine the modes of its ``start``; again without what the jaws hold, if they do.

    ``bodies`` are that of full detail and the decimated one. Returns the pose in the rig's reference camera, and the
    views by which it was found.
    """
    (body, decimated), model = bodies, bodies[0].instrument
    modes = () if start is None else _modes(start, seen[0], model)
    found = find_pose(views, decimated, readings, settings, modes)
    if (free := _without_held(seen, views, found, body, settings)) is not None:
        views = free
        modes = [PoseCandidate(found.at, 0.0)]
        modes += [PoseCandidate(posed(mode, model.joint_names), k) for k, mode in enumerate(found.alternatives, 1)]
        found = find_pose(views, decimated, readings, settings, modes)
        found = replace(found, notes=(*found.notes, HELD))
    return _in_camera(found, seen[0]), views


def _modes(start: Result, view: SeenView, model: Instrument) -> list[PoseCandidate]:
    """Return the pose of a result and its alternatives, the best first, in a view's camera; none without a pose."""
    if start.camera_from_root is None:
        return []
    modes = enumerate(modes_of(start, model.joint_names))
    return [PoseCandidate(mode.seen_from(view.view_from_camera), float(k)) for k, mode in modes]


def _check_session(session: SessionCalibration, instrument: str, arm: Arm | None) -> None:
    """Raise an InputError for what is not a calibration, or not of the instrument, or not of an arm that is given.

    The solver of sessions is imported only where there is one.
    """
    from dvrk_cmaes.calibration.document import CALIBRATION_EXPECTED, SessionCalibration, check_made_for

    check_type("session", session, SessionCalibration, CALIBRATION_EXPECTED)
    check_made_for("session", session, instrument, arm)


def _frame_views(seen: Sequence[SeenView], body: Body, settings: EstimateConfig) -> list[FrameView]:
    """Gather the evidence of each view, and make its renderer; poses are in the first one of them."""
    first, views = seen[0], list[FrameView]()
    for view in seen:
        seed, threads = settings.seed, settings.threads
        found = FrameView.of(view, body, view.ignore, view.keypoints, seed=seed, threads=threads)
        place = np.eye(4) if view is first else view.view_from_camera @ inverse(first.view_from_camera)
        views.append(replace(found, view_from_camera=place))
    return views


def _without_held(
    seen: Sequence[SeenView], views: Sequence[FrameView], found: FoundPose, body: Body, settings: EstimateConfig
) -> list[FrameView] | None:
    """Return the views without what the jaws hold, which counts neither way; None where nothing is found."""
    if found.quality.distal_px < _ROUGH_PX * views[0].evidence.camera.pixel_scale:
        return None
    held = [held_in(view, found.at) for view in views]
    if all(part is None for part in held):
        return None
    hidden = [without(view, part) for view, part in zip(seen, held, strict=True)]
    return _frame_views(hidden, body, settings)


def _in_camera(found: FoundPose, view: SeenView) -> FoundPose:
    """Return what was found in a view's camera in the reference camera of its rig."""
    if np.array_equal(view.view_from_camera, np.eye(4)):
        return found
    camera_from_view = inverse(view.view_from_camera)
    others = tuple(
        replace(other, camera_from_root=camera_from_view @ other.camera_from_root) for other in found.alternatives
    )
    return replace(found, at=found.at.seen_from(camera_from_view), alternatives=others)


def _unused_evidence(views: Sequence[FrameView]) -> tuple[str, ...]:
    """Describe the evidence that is missing, with the view's name where there are several."""
    if len(views) == 1:
        return views[0].evidence.unused
    return tuple(f"view {view.name}: {text}" for view in views for text in view.evidence.unused)
