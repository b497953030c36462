"""Reasons for which the pose of a frame is doubtful: its mode is in doubt, an input is wrong, or it is not accurate.

All commands ask the same of a frame, with the limits of its row of `OF_FRAMES`: of one that is estimated by itself or
fitted with a session's calibration, of a keyframe, and of an image that is followed. What is asked of sessions is in
`calibration.session_doubts`. A rough mask alone is no reason: it makes the expected error larger, which counts once it
is beyond the limit.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final, Literal

import numpy as np

from dvrk_cmaes.camera import Camera
from dvrk_cmaes.camera.rig import mirrored_place
from dvrk_cmaes.config import SessionConfig, TrustConfig
from dvrk_cmaes.evidence.gather import Evidence
from dvrk_cmaes.evidence.straight_cut import shaft_width
from dvrk_cmaes.geometry import Bool, Float64, Posed, apply
from dvrk_cmaes.instrument import Instrument
from dvrk_cmaes.joints.prior import Readings
from dvrk_cmaes.pose.mode_probability import mode_weights
from dvrk_cmaes.pose.refine.gauss_newton import Fit
from dvrk_cmaes.pose.search.modes import PoseCandidate, is_twin
from dvrk_cmaes.pose.tip_probability import tip_probability
from dvrk_cmaes.pose.views import FrameView, overlap
from dvrk_cmaes.results.result import ExpectedError, Quality, ViewCheck

_LEAST_OVERLAP, _MIRRORED_OVERLAP = 0.3, 0.6  # IoU of a view, and of the view on the other side
TIPS_NOT_ACCURATE: Final = "tips not accurate"
"""What the reason begins with for which the expected error of the tips is too large."""
_WRIST: Final = ("wrist_pitch", "wrist_yaw")
_EXCHANGED_RAD, _EXCHANGED_FACTOR = np.deg2rad(15.0), 3.0
"""How far the wrist is from its readings, rad and in distances from the exchanged ones, where they may be exchanged.

Both are root mean squares over the frames of one recording.

In 13 made recordings with rough masks, that is so of 3 of 780 frames with right columns, of 45 % with exchanged ones.
"""
_FAR_JOINTS = 2.1
"""Largest mean square of the joints' deviations in standard deviations, in images whose masks are found in them.

Of three joints, 90 % of normal errors are within it. In 19 recordings that were followed by masks, it is so of 98.5 %
of the ok frames; of the 11 images of another one in which a flap of tissue hides the tips, nine are beyond it, all
that are more than 3 mm off.
"""
_CLEAR = 4.0  # standard deviations of a rotation
_CERTAIN_MODE = 0.97  # probability of a mode that is not what makes the tips doubtful
_MINOR = 0.15  # probability that may be missing from the modes found, before they are not named


@dataclass(frozen=True)
class FrameLimits:
    """How far a frame may be from its mask and from what its session expects: a row of the table of frames.

    what : what the frame belongs to, in words. factor : on the limits of contour, bend and missing overlap. outside :
    the jaw tips outside the image that make it doubtful, one of them or all, in words. overlap_loss : below the
    session's median intersection over union. largest_px, contour_factor : 95 % of the contour are within the larger one
    of the first, px, and of the second times the session's median.
    """

    what: str
    factor: float
    outside: Literal["a jaw tip lies", "the jaw tips lie"]
    overlap_loss: float
    largest_px: float
    contour_factor: float

    def doubts_in_view(
        self, at: Posed, view: FrameView, quality: Quality, expected: ExpectedError, trust: TrustConfig
    ) -> list[str]:
        """List the reasons, in words, for which a pose does not explain a view's mask or is not accurate."""
        instrument, evidence, seen = view.renderer.body.instrument, view.evidence, at.seen_from(view.view_from_camera)
        reasons, factor = [], self.factor
        least_iou = 1 - factor * (1 - trust.least_iou)
        if quality.iou < least_iou:
            reasons.append(f"overlap too low: IoU {quality.iou:.3f}, expected at least {least_iou:.2f}")
        if quality.distal_px > factor * trust.largest_distal_px:
            reasons.append(
                f"wrist or jaws off: beyond the shaft, the mask's contour is {quality.distal_px:.1f} px (rms) from the "
                "silhouette; another instrument, another tool or tissue may be there"
            )
        width = shaft_width(instrument, evidence.camera, seen.pose)
        largest_bend = max(trust.largest_bend_px, trust.largest_bend_share * (width or 0.0))
        if width is not None and quality.bend_px > factor * largest_bend:
            bent = f"along a straight line that ends it, the silhouette bends by {quality.bend_px:.1f} px"
            reasons.append(f"mask cut straight: {bent}")
        return reasons + self.doubts_of_tips(seen, instrument, evidence.camera, expected, trust)

    def doubts_of_tips(
        self, seen: Posed, instrument: Instrument, camera: Camera, expected: ExpectedError, trust: TrustConfig
    ) -> list[str]:
        """List the reasons, in words, for which tips are not in a view, in whose camera the pose is, or inaccurate."""
        tips = apply(seen.pose, instrument.tips(seen.joints))
        outside = outside_image(tips, camera) if instrument.jaw_tips else np.zeros(1, dtype=np.bool_)
        is_out = outside.any() if self.outside == "a jaw tip lies" else outside.all()
        reasons = [f"tip out of view: {self.outside} outside the image"] if is_out else []
        return reasons + doubts_of_tips(expected, trust)

    def doubts_in_session(
        self, quality: Quality, misfit: float, iou: float, contour_px_95: float, config: SessionConfig
    ) -> list[str]:
        """List the reasons, in words, for which a frame is not what its session expects.

        ``quality`` is that of the frame's pose, ``misfit`` as in `disagreement`; ``iou`` and ``contour_px_95`` are the
        medians of the session.
        """
        least, largest_px = iou - self.overlap_loss, max(self.largest_px, self.contour_factor * contour_px_95)
        reasons = self.disagreement(misfit, config)
        if quality.iou < least or quality.contour_px_95 > largest_px:
            measured = f"IoU {quality.iou:.3f}, {quality.contour_px_95:.1f} px at 95 % of the contour"
            expected = f"expected at least {least:.3f} and at most {largest_px:.1f} px"
            reasons.insert(0, f"mask not explained: {measured}, {expected}")
        return reasons

    def disagreement(self, misfit: float, config: SessionConfig, source: str = "mask") -> list[str]:
        """List the reason, in words, for which a pose is too far from what its session expects; empty if it is not.

        ``misfit`` is the squared distance by the covariance, per parameter; ``source`` is what of the image tells the
        pose: its mask, or the image itself.
        """
        if misfit <= config.largest_misfit:
            return []
        return [
            f"disagrees with the {self.what}: the {source} is {misfit**0.5:.1f} times the expected error from what the "
            "calibration and the readings expect"
        ]


OF_FRAMES: Final = {
    "alone": FrameLimits("session", 1.0, "a jaw tip lies", 0.03, 3.5, 1.5),
    "followed": FrameLimits("recording", 1.5, "the jaw tips lie", 0.15, 9.0, 3.0),
}
"""The table of frames: a frame by itself, and one whose pose its neighbours support, too.

In 17 followed recordings with known truth, frames that only the limits of contour and bend made doubtful were as
accurate as others; so were those of four hard ones that only the overlap did.
"""


def judge(
    modes: Sequence[Fit],
    views: Sequence[FrameView],
    checks: Sequence[ViewCheck],
    expected: ExpectedError,
    of_mode: float,
    readings: Readings,
    trust: TrustConfig,
) -> tuple[list[str], list[str], float]:
    """List the reasons, in words, for which the first of all modes is doubtful, and remarks on single views.

    ``checks`` are those of the views, in their order, ``expected`` the expected error and ``of_mode`` the probability
    of the first mode. Also returns the probability that the tips are within the limit.
    """
    qualities = [check.quality for check in checks]
    reasons, remarks = doubts_in_views(modes[0].at, views, qualities, expected, trust)
    further = zip(checks[1:], views[1:], strict=True)
    for check, view in further:
        if _is_exchanged(modes[0].at, check, view):
            other = f"views disagree: {check.name} fits {views[0].name} only from its other side: the images, masks or "
            reasons.insert(0, f"{other}camera files of the two are exchanged")
        elif (text := _disagreement(check, views[0].name, trust)) is not None:
            reasons.append(text)
    evidence = next((view.evidence for view in views if view.evidence.shaft_edges), views[0].evidence)
    instrument = views[0].renderer.body.instrument
    probability = tip_probability(expected.of_tips_mm, trust.tip_mm, of_mode=of_mode)
    is_near = not doubts_of_tips(expected, trust)
    if probability < trust.least_probability and (is_near or of_mode < _CERTAIN_MODE):
        reasons.append(_in_doubt(modes, probability, of_mode, instrument, trust))
    return reasons + doubts_of_modes(modes, evidence, readings, instrument, trust), remarks, probability


def doubts_in_views(
    at: Posed,
    views: Sequence[FrameView],
    qualities: Sequence[Quality],
    expected: ExpectedError,
    trust: TrustConfig,
    limits: FrameLimits = OF_FRAMES["alone"],
) -> tuple[list[str], list[str]]:
    """List the reasons for which a pose is doubtful that hold in every view, and remarks for those that do not.

    What one view shows well is not in doubt because another view is occluded, cut or has the tips outside: a reason
    that does not hold in every view is a remark that names the view. ``qualities`` are those of the pose in each view,
    in their order.
    """
    of_views = [
        limits.doubts_in_view(at, view, quality, expected, trust)
        for view, quality in zip(views, qualities, strict=True)
    ]
    kinds = [{_kind(reason) for reason in reasons} for reasons in of_views]
    everywhere = set.intersection(*kinds)
    reasons = [reason for reason in of_views[0] if _kind(reason) in everywhere]
    remarks = [
        f"view {view.name}: {reason}"
        for view, own in zip(views, of_views, strict=True)
        for reason in own
        if _kind(reason) not in everywhere
    ]
    return reasons, remarks


def _kind(reason: str) -> str:
    """Return the kind of a reason: its text before the first colon."""
    return reason.split(":")[0]


def doubts_of_tips(expected: ExpectedError, trust: TrustConfig) -> list[str]:
    """List the reason, in words, for which the tips of a pose in the right mode are inaccurate; empty if none is."""
    error, limit = expected.of_tips_mm, trust.tip_mm
    probability = tip_probability(error, limit)
    if probability >= trust.least_probability:
        return []
    return [
        f"{TIPS_NOT_ACCURATE}: their expected error is {error:.1f} mm, the probability that they are within {limit:g} "
        f"mm {probability:.2f}"
    ]


def far_joints(found: Posed, expected: Posed, spread: Float64, names: Sequence[str]) -> str:
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
    if float(np.mean(deviations**2)) <= _FAR_JOINTS:
        return ""
    worst = int(np.abs(deviations).argmax())
    return (
        f"joints far from the recording: {names[worst]} is {np.degrees(off[worst]):+.0f} deg from what readings and "
        "calibration expect; something may hide the end of the instrument"
    )


def outside_image(points: Float64, camera: Camera) -> Bool:
    """Return which points (K, 3) in a camera's frame are outside its image; all of them if one is behind the camera."""
    if (points[:, 2] <= 0).any():
        return np.ones(len(points), dtype=np.bool_)
    pixels = camera.project(points)
    return np.asarray(((pixels < -0.5) | (pixels > [camera.width - 0.5, camera.height - 0.5])).any(axis=1))


def _is_exchanged(at: Posed, check: ViewCheck, view: FrameView) -> bool:
    """Return whether a view seems to be on the other side of the first one.

    It then shows nothing of the pose, but does so from there; or, where the pose is a compromise of both views, it
    would have to be turned by more than the angle between the two as seen from the instrument, and a degree.
    """
    distances = np.linalg.norm(view.view_from_camera[:3, 3]), np.linalg.norm(at.pose[:3, 3])
    between = float(np.degrees(np.arctan2(*distances)))
    if float(np.linalg.norm(check.rotation_deg)) > max(between, 1.0) and check.significance > _CLEAR:
        return True
    if check.quality.iou > _LEAST_OVERLAP:
        return False
    mirrored = replace(view, view_from_camera=mirrored_place(view.view_from_camera))
    return overlap([mirrored], [mirrored.silhouette(at)]) > _MIRRORED_OVERLAP


def _disagreement(check: ViewCheck, main: str, trust: TrustConfig) -> str | None:
    """Say by how much a view contradicts the main one; None if it does not, beyond its error."""
    angle = float(np.linalg.norm(check.rotation_deg))
    if angle < trust.largest_view_deg or check.significance < trust.largest_view_sigmas:
        return None
    return (
        f"views disagree: {check.name} fits {main} only if turned by {angle:.2f} deg; the rig may be calibrated "
        "wrongly, or the images are not of one time or exchanged"
    )


def doubts_of_modes(
    modes: Sequence[Fit], evidence: Evidence, readings: Readings, instrument: Instrument, trust: TrustConfig
) -> list[str]:
    """List the reasons, in words, for which the first of all modes contradicts outline or readings."""
    best, reasons = modes[0], []
    better = min(modes, key=lambda mode: mode.outline_score)
    if best.outline_score - better.outline_score > trust.largest_outline_gap:
        reasons.append("readings against outline: a pose farther from the readings explains the mask clearly better")
    return reasons + _doubts_of_readings(best, evidence, readings, instrument, trust)


def _in_doubt(
    modes: Sequence[Fit], probability: float, of_mode: float, instrument: Instrument, trust: TrustConfig
) -> str:
    """Say how probable the tips of the first mode are right, or the mode, and which other one is the most probable."""
    if of_mode >= _CERTAIN_MODE:
        return f"tips in doubt: they are within {trust.tip_mm:g} mm with a probability of {probability:.2f}"
    text = f"mode in doubt: the pose is in the right mode with a probability of {of_mode:.2f}"
    if len(modes) < 2 or mode_weights(modes)[1:].max() < 1 - of_mode - _MINOR:
        return f"{text}; the mask says too little"
    other = min(modes[1:], key=lambda mode: mode.score)
    twin = instrument.has_twin and is_twin(instrument, modes[0].at, other.at)
    return f"{text}; {'the mirror twin' if twin else 'another pose'} explains the frame nearly as well"


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
    told = ~np.isnan(read[:, index]).any(axis=1)
    wrist, as_read = found[told][:, index], read[told][:, index]
    if not told.any():
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


def _doubts_of_readings(
    best: PoseCandidate, evidence: Evidence, readings: Readings, instrument: Instrument, trust: TrustConfig
) -> list[str]:
    """List the reasons, in words, for which a pose contradicts its readings or could not be told without them."""
    reasons = []
    if np.isnan(readings.values).all():
        reasons.append("no readings: nothing tells the pose from its mirror twin")
    off = np.abs(best.at.joints - readings.values) / readings.sigma
    for name, sigmas in zip(instrument.joint_names, off, strict=True):
        if sigmas > trust.largest_reading_sigmas:
            reasons.append(f"far from the readings: {name} is {sigmas:.1f} times the expected error away")
    together = float(np.nansum(off**2))
    if together > trust.largest_reading_sum and not (off > trust.largest_reading_sigmas).any():
        reasons.append("far from the readings: all joints together are farther off than readings are")
    if instrument.shaft is not None and not evidence.shaft_edges:
        reasons.append("shaft not found: no two edges in the mask could bound it")
    return reasons
