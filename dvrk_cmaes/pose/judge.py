"""What the rules of `pose.doubts` ask of a pose: of its views, of its modes and readings, and of its session."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from dvrk_cmaes.camera import Camera
from dvrk_cmaes.camera.rig import mirrored_place
from dvrk_cmaes.config import SessionConfig, TrustConfig
from dvrk_cmaes.evidence.jaw_tips import shaft_width
from dvrk_cmaes.geometry import Bool, Float64, Posed, apply
from dvrk_cmaes.instrument import Instrument
from dvrk_cmaes.joints.prior import Readings
from dvrk_cmaes.pose.doubts import (
    LIMITS,
    NO_READINGS,
    Kind,
    far_from_readings,
    joints_far_from_recording,
    mask_cut_straight,
    mask_not_explained,
    mode_in_doubt,
    overlap_too_low,
    pose_not_expected,
    readings_against_outline,
    reasons,
    shaft_not_found,
    tip_out_of_view,
    tips_not_accurate,
    view_mirrored,
    view_turned,
    wrist_or_jaws_off,
)
from dvrk_cmaes.pose.expected_error import mode_weights, tip_probability
from dvrk_cmaes.pose.refine.gauss_newton import Fit
from dvrk_cmaes.pose.search.starts import is_twin
from dvrk_cmaes.pose.views import FrameView, overlap
from dvrk_cmaes.results.result import ExpectedError, Quality, ViewCheck

_LEAST_OVERLAP = 0.3  # IoU of a view, above which it shows the pose from its own side
_WRIST: Final = ("wrist_pitch", "wrist_yaw")
_EXCHANGED_RAD, _EXCHANGED_FACTOR = np.deg2rad(15.0), 3.0
"""How far the wrist is from its readings, rad and in distances from the exchanged ones, where they may be exchanged.

Both are root mean squares over the frames of one recording.

In 13 made recordings with rough masks, that is so of 3 of 780 frames with right columns, of 45 % with exchanged ones.
"""
_CLEAR = 4.0  # standard deviations of a rotation
_END: Final = 0.85  # of the way from the jaws' axis to a tip, where right masks show the jaw's end
_MINOR = 0.15  # probability that may be missing from the modes found, before they are not named


def judge(
    modes: Sequence[Fit],
    views: Sequence[FrameView],
    checks: Sequence[ViewCheck],
    error: ExpectedError,
    of_mode: float,
    readings: Readings,
    trust: TrustConfig,
) -> tuple[list[str], list[str], float]:
    """List the reasons, in words, for which the first of all modes is doubtful, and remarks on single views.

    ``checks`` are those of the views, in their order, ``error`` the expected error and ``of_mode`` the probability of
    the first mode. Also returns the probability that the tips are within the limit.
    """
    at, main, instrument = modes[0].at, views[0].name, views[0].renderer.body.instrument
    of_views, remarks = doubts_in_views(at, views, [check.quality for check in checks], error, trust)
    further = list(zip(checks[1:], views[1:], strict=True))
    mirrored = reasons(*(view_mirrored(one.name, main, _mirrored_overlap(at, one, view)) for one, view in further))
    turned = ((one.name, main, float(np.linalg.norm(one.rotation_deg)), one.significance) for one, _ in further)
    off = (np.abs(at.joints - readings.values) / readings.sigma).tolist()
    found = [
        *mirrored,
        *of_views,
        *(() if mirrored else reasons(*(view_turned(*one, trust) for one in turned))),
        *reasons(
            mode_in_doubt(error, of_mode, _rival(modes, of_mode, instrument), trust),
            readings_against_outline(modes[0].outline_score - min(mode.outline_score for mode in modes), trust),
            NO_READINGS if np.isnan(readings.values).all() else None,
        ),
        *far_from_readings(instrument.joint_names, off, trust),
        *reasons(shaft_not_found(instrument.shaft is None or any(view.evidence.shaft_edges for view in views))),
    ]
    return found, remarks, tip_probability(error.of_tips_mm, trust.tip_mm, of_mode=of_mode)


def _rival(modes: Sequence[Fit], of_mode: float, instrument: Instrument) -> str:
    """Say which mode is the most probable after the first, whose probability is given."""
    if len(modes) < 2 or mode_weights(modes)[1:].max() < 1 - of_mode - _MINOR:
        return "the mask says too little"
    other = min(modes[1:], key=lambda mode: mode.score)
    twin = instrument.has_twin and is_twin(instrument, modes[0].at, other.at)
    return f"{'the mirror twin' if twin else 'another pose'} explains the frame nearly as well"


def doubts_in_views(
    at: Posed,
    views: Sequence[FrameView],
    qualities: Sequence[Quality],
    error: ExpectedError,
    trust: TrustConfig,
    kind: Kind = "alone",
) -> tuple[list[str], list[str]]:
    """List the reasons for which a pose is doubtful that hold in every view, and remarks for those that do not.

    What one view shows well is not in doubt because another view is occluded, cut or has the tips outside: a reason
    that does not hold in every view is a remark that names the view. ``qualities`` are those of the pose in each view,
    in their order, ``error`` is the error that is expected of it.
    """
    of_views = [
        doubts_in_view(
            *(kind, at.seen_from(view.view_from_camera), view.renderer.body.instrument, view.evidence.camera),
            *(error, trust, quality),
        )
        for view, quality in zip(views, qualities, strict=True)
    ]
    kinds = [{_kind(reason) for reason in own} for own in of_views]
    everywhere = set.intersection(*kinds)
    found = [reason for reason in of_views[0] if _kind(reason) in everywhere]
    remarks = [
        f"view {view.name}: {reason}"
        for view, own in zip(views, of_views, strict=True)
        for reason in own
        if _kind(reason) not in everywhere
    ]
    return found, remarks


def doubts_in_view(
    kind: Kind,
    seen: Posed,
    instrument: Instrument,
    camera: Camera,
    error: ExpectedError,
    trust: TrustConfig,
    quality: Quality,
) -> list[str]:
    """List the reasons, in words, of a pose in the camera of a view, of whose mask it has a ``quality``."""
    limits, tips = LIMITS[kind], apply(seen.pose, instrument.tips(seen.joints))
    outside = outside_image(tips, camera) if instrument.jaw_tips else np.zeros(1, dtype=np.bool_)
    width = shaft_width(instrument, camera, seen.pose)
    # by itself a frame of a wide image is not trusted farther: depths were 6 mm off with contours 3 px off
    distal_scale = 1.0 if kind == "alone" else camera.pixel_scale
    bend_px = trust.largest_bend_px * camera.pixel_scale
    bend_px = np.inf if width is None else max(bend_px, trust.largest_bend_share * width)
    return reasons(
        overlap_too_low(quality, 1 - limits.factor * (1 - trust.least_iou)),
        wrist_or_jaws_off(quality, limits.factor * trust.largest_distal_px * distal_scale),
        mask_cut_straight(quality, limits.factor * bend_px),
        tip_out_of_view(limits, outside.tolist()),
        tips_not_accurate(error, trust),
    )


def doubts_of_agreement(
    kind: Kind,
    misfit: float,
    config: SessionConfig,
    quality: Quality,
    usual: tuple[float, float],
    pixel_scale: float,
) -> list[str]:
    """List the reasons, in words, for which a pose is not what its session expects.

    ``misfit`` is the squared distance from what is expected, by the covariance, per parameter; ``quality`` that of the
    pose, ``usual`` the session's medians of ``iou`` and ``contour_px_95``, and ``pixel_scale`` that of the camera.
    """
    limits, (iou, px) = LIMITS[kind], usual
    most_px = max(limits.largest_px * pixel_scale, limits.contour_factor * px)
    of_mask = mask_not_explained(quality, iou - limits.overlap_loss, most_px)
    return reasons(of_mask, pose_not_expected(limits, misfit, config.largest_misfit))


def _kind(reason: str) -> str:
    """Return the kind of a reason: its text before the first colon."""
    return reason.split(":")[0]


def far_joints(found: Posed, expected: Posed, spread: Float64, names: Sequence[str]) -> list[str]:
    """Say that the joints of an image are far from what its recording expects; empty if they are not.

    Where something hides the end of an instrument, the edges that are left are explained by other joints.

    Parameters
    ----------
    found, expected
        The pose and joints that were found, and what calibration and readings expect.
    spread : (D, D)
        Covariance of the expected ones.
    names
        Names of the J joints.
    """
    off = found.joints - expected.joints
    deviations = off / np.sqrt(np.diag(spread)[-len(off) :])
    worst = int(np.abs(deviations).argmax())
    mean_square = float(np.mean(deviations**2))
    return reasons(joints_far_from_recording(names[worst], float(np.degrees(off[worst])), mean_square))


def outside_image(points: Float64, camera: Camera) -> Bool:
    """Return which points (K, 3) in a camera's frame are outside its image; all of them if one is behind the camera."""
    if (points[:, 2] <= 0).any():
        return np.ones(len(points), dtype=np.bool_)
    pixels = camera.project(points)
    return np.asarray(((pixels < -0.5) | (pixels > [camera.width - 0.5, camera.height - 0.5])).any(axis=1))


def jaw_end_missing(view: FrameView, at: Posed) -> bool:
    """Return whether the mask of a view shows nothing where the silhouette of a pose has the end of a jaw.

    Jaws that are curved or have openings, such as a ProGrasp's, may have nothing there either.
    """
    instrument, evidence, seen = view.renderer.body.instrument, view.evidence, at.seen_from(view.view_from_camera)
    if not instrument.jaw_tips or not instrument.hinges:
        return False
    hinge = instrument.chain.forward(seen.joints, [instrument.hinges[-1]])[0, :3, 3]
    points = apply(seen.pose, hinge + _END * (instrument.tips(seen.joints) - hinge))
    inside = points[~outside_image(points, evidence.camera)]
    u, v = np.rint(evidence.camera.project(inside)).astype(int).T
    missing = ~evidence.mask[v, u] & (evidence.weight[v, u] > 0)
    return bool(missing.any() and (missing & view.silhouette(at)[v, u]).any())


def _mirrored_overlap(at: Posed, check: ViewCheck, view: FrameView) -> float:
    """Return the overlap of a view with a pose as seen from the other side of the first view; 0 if it shows the pose.

    Where the pose is a compromise of both views, the view would have to be turned by more than the angle between the
    two as seen from the instrument, and a degree: it is then taken for one on the other side, with an overlap of 1.
    """
    distances = np.linalg.norm(view.view_from_camera[:3, 3]), np.linalg.norm(at.pose[:3, 3])
    between = float(np.degrees(np.arctan2(*distances)))
    if float(np.linalg.norm(check.rotation_deg)) > max(between, 1.0) and check.significance > _CLEAR:
        return 1.0
    if check.quality.iou > _LEAST_OVERLAP:
        return 0.0
    mirrored = replace(view, view_from_camera=mirrored_place(view.view_from_camera))
    return overlap([mirrored], [mirrored.silhouette(at)])


def exchanged_readings(found: Float64, read: Float64, instrument: Instrument) -> list[str]:
    """Say that the readings of both joints of the wrist may be exchanged; empty where they do not seem to be.

    Parameters
    ----------
    found : (N, J)
        The joints that were found in N frames whose readings are those of one recording, rad.
    read : (N, J)
        Their readings, rad; NaN where there is none.
    instrument
        The instrument.
    """
    if not set(_WRIST) <= set(instrument.joint_names):
        return []
    index = [instrument.joint_names.index(name) for name in _WRIST]
    has_reading = ~np.isnan(read[:, index]).any(axis=1)
    wrist, as_read = found[has_reading][:, index], read[has_reading][:, index]
    if not has_reading.any():
        return []
    far, near = (np.linalg.norm(wrist - values, axis=1) for values in (as_read, as_read[:, ::-1]))
    rms = float(np.sqrt(np.mean(far**2)))
    if not (rms > _EXCHANGED_RAD and rms > _EXCHANGED_FACTOR * float(np.sqrt(np.mean(near**2)))):
        return []
    worst = int(far.argmax())
    texts = [" and ".join(f"{value:.0f}" for value in np.degrees(values[worst])) for values in (wrist, as_read)]
    return [
        f"readings of {' and '.join(_WRIST)} may be exchanged: found {texts[0]} deg, read {texts[1]}: check the "
        "order of the columns or joint names"
    ]
