"""Reasons for which the pose of a frame is doubtful: its mode is in doubt, an input is wrong, or it is not accurate.

A rough mask alone is none of them: it makes the expected error larger, which counts once it is beyond the limit.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dvrk_cmaes.config import TrustConfig
from dvrk_cmaes.evidence.gather import Evidence
from dvrk_cmaes.evidence.straight_cut import shaft_width
from dvrk_cmaes.geometry import apply
from dvrk_cmaes.instrument import Instrument
from dvrk_cmaes.joints.prior import Readings
from dvrk_cmaes.pose.mode_probability import mode_weights
from dvrk_cmaes.pose.refine.coarse_to_fine import is_twin
from dvrk_cmaes.pose.refine.outline import OutlineFit
from dvrk_cmaes.pose.search.modes import HasPose
from dvrk_cmaes.results.result import ExpectedError, Quality

_MINOR = 0.15  # probability that may be missing from the modes found, before they are not named


def _tips_out_of_view(best: HasPose, instrument: Instrument, evidence: Evidence) -> bool:
    """Return whether a jaw tip is behind the camera or outside the image."""
    pose, camera = best.camera_from_root, evidence.camera
    tips = apply(pose, instrument.tips(best.joints))
    if (tips[:, 2] <= 0).any():
        return True
    pixels = camera.project(tips)
    return bool((pixels < -0.5).any() or (pixels > [camera.width - 0.5, camera.height - 0.5]).any())


def doubts_of_fit(
    best: HasPose,
    quality: Quality,
    expected: ExpectedError,
    evidence: Evidence,
    instrument: Instrument,
    trust: TrustConfig,
) -> list[str]:
    """List the reasons, in words, for which a pose does not explain its mask or is not accurate; empty without any."""
    reasons = []
    if quality.iou < trust.least_iou:
        reasons.append(f"overlap too low: IoU {quality.iou:.3f}, expected at least {trust.least_iou:.2f}")
    if quality.distal_px > trust.largest_distal_px:
        reasons.append(
            f"wrist or jaws off: beyond the shaft, the mask's contour is {quality.distal_px:.1f} px (rms) from the "
            "silhouette; another instrument, another tool or tissue may be there"
        )
    shaft = shaft_width(instrument, evidence.camera, best.camera_from_root)
    if shaft is not None and quality.bend_px > max(trust.largest_bend_px, trust.largest_bend_share * shaft):
        reasons.append(
            f"mask cut straight: along a straight line that ends it, the silhouette bends by {quality.bend_px:.1f} px"
        )
    if instrument.jaw_tips and _tips_out_of_view(best, instrument, evidence):
        reasons.append("tip out of view: a jaw tip lies outside the image")
    if expected.of_tips_mm > trust.tip_mm:
        reasons.append(
            f"tips not accurate: their expected error is {expected.of_tips_mm:.1f} mm, more than {trust.tip_mm:g} mm"
        )
    return reasons


def judge(
    modes: Sequence[OutlineFit],
    quality: Quality,
    expected: ExpectedError,
    probability: float,
    evidence: Evidence,
    readings: Readings,
    instrument: Instrument,
    trust: TrustConfig,
) -> list[str]:
    """List the reasons, in words, for which the first of all modes is doubtful; empty if there are none.

    ``probability`` is that of the first mode, ``expected`` its expected error.
    """
    reasons = doubts_of_fit(modes[0], quality, expected, evidence, instrument, trust)
    return reasons + doubts_of_modes(modes, probability, evidence, readings, instrument, trust)


def doubts_of_modes(
    modes: Sequence[OutlineFit],
    probability: float,
    evidence: Evidence,
    readings: Readings,
    instrument: Instrument,
    trust: TrustConfig,
) -> list[str]:
    """List the reasons, in words, for which the first of all modes may not be the true one; empty without any."""
    best, reasons = modes[0], []
    better = min(modes, key=lambda mode: mode.outline_score)
    if best.outline_score - better.outline_score > trust.largest_outline_gap:
        reasons.append("readings against outline: a pose farther from the readings explains the mask clearly better")
    if probability < trust.least_mode_probability:
        reasons.append(_mode_in_doubt(modes, probability, instrument))
    return reasons + _doubts_of_readings(best, evidence, readings, instrument, trust)


def _mode_in_doubt(modes: Sequence[OutlineFit], probability: float, instrument: Instrument) -> str:
    """Say how probable the first mode is, and which other one is the most probable."""
    text = f"mode in doubt: the pose is in the right mode with a probability of {probability:.2f}"
    if len(modes) < 2 or mode_weights(modes)[1:].max() < 1 - probability - _MINOR:
        return f"{text}; the mask says too little"
    other = min(modes[1:], key=lambda mode: mode.score)
    twin = instrument.has_twin and is_twin(instrument, modes[0], other)
    return f"{text}; {'the mirror twin' if twin else 'another pose'} explains the frame nearly as well"


def _doubts_of_readings(
    best: OutlineFit, evidence: Evidence, readings: Readings, instrument: Instrument, trust: TrustConfig
) -> list[str]:
    """List the reasons, in words, for which a pose contradicts its readings or could not be told without them."""
    reasons = []
    if np.isnan(readings.values).all():
        reasons.append("no readings: nothing tells the pose from its mirror twin")
    off = np.abs(best.joints - readings.values) / readings.sigma
    for name, sigmas in zip(instrument.joint_names, off, strict=True):
        if sigmas > trust.largest_reading_sigmas:
            reasons.append(f"far from the readings: {name} is {sigmas:.1f} times the expected error away")
    together = float(np.nansum(off**2))
    if together > trust.largest_reading_sum and not (off > trust.largest_reading_sigmas).any():
        reasons.append("far from the readings: all joints together are farther off than readings are")
    if instrument.shaft is not None and not evidence.shaft_edges:
        reasons.append("shaft not found: no two edges in the mask could bound it")
    return reasons
