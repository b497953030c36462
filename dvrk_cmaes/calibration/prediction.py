"""A new frame of a calibrated session: what the session expects of it, held against its mask."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.calibration.document import SessionCalibration
from dvrk_cmaes.calibration.frame_fit import fit_frame
from dvrk_cmaes.calibration.model import outer_readings
from dvrk_cmaes.config import EstimateConfig
from dvrk_cmaes.evidence.gather import Evidence
from dvrk_cmaes.evidence.joint_prior import Readings
from dvrk_cmaes.geometry import inverse
from dvrk_cmaes.instrument.arm import OUTER_JOINTS
from dvrk_cmaes.pose.quality import doubts_of_fit, measure_quality
from dvrk_cmaes.pose.refine.priors import PosePrior
from dvrk_cmaes.results.result import Quality
from dvrk_cmaes.silhouette import Renderer

Float64 = NDArray[np.float64]

_LESS_OVERLAP = 0.03  # than the session's frames have, for a pose that still explains its mask
_FARTHER = 1.5  # times as far off as the session's own contours


@dataclass(frozen=True, eq=False)
class SessionPose:
    """A frame's pose (4, 4), joints (J,) and covariance (D, D) as its session and its mask have them.

    ``camera_from_base`` is of this frame alone, the joints' offsets taken out. ``doubts`` say what is wrong, in words.
    """

    camera_from_root: Float64
    joints: Float64
    covariance: Float64
    camera_from_base: Float64
    quality: Quality
    doubts: tuple[str, ...]
    evaluations: int
    rays: int


def try_session(
    session: SessionCalibration,
    renderer: Renderer,
    evidence: Evidence,
    readings: Readings,
    given: Mapping[str, float],
    config: EstimateConfig,
) -> SessionPose | str:
    """Fit a frame from where its session expects it; in words why not, where that does not explain the mask.

    ``readings`` are those of the instrument's joints, ``given`` all by name.

    Raises
    ------
    InputError
        The session is of an instrument with other joints.
    """
    instrument = renderer.body.instrument
    outer = outer_readings([given])
    model, calibration = session.model(outer, readings.values[None], instrument.joint_names)
    missing = [name for name, value in zip(OUTER_JOINTS, outer[0], strict=True) if np.isnan(value)]
    if missing:
        return f"session: no reading of {', '.join(missing)}: searched without it"
    poses, joints = model.predict(calibration)
    rate = model.jacobian(calibration)[0]
    spread = model.covariance(calibration)[0] + rate @ session.covariance @ rate.T
    expected = PosePrior(poses[0], joints[0], np.asarray(np.linalg.inv(spread), dtype=np.float64))
    start = (poses[0], joints[0])
    first = fit_frame(renderer, evidence, readings, config, expected, (start,), None)
    fitted = (first.camera_from_root, first.joints)
    view = fit_frame(renderer, evidence, readings, config, expected, (fitted,), fitted)
    (quality,), rays = measure_quality(
        renderer, evidence, readings, [view], config.weights, decay=config.decay_px, field=config.distance_field
    )
    off = expected.deviation(view.camera_from_root, view.joints)
    misfit = float(off @ expected.information @ off) / len(off)
    farthest = max(config.trust.largest_contour_px, _FARTHER * session.contour_px_95)
    if quality.iou < session.iou - _LESS_OVERLAP or quality.contour_px_95 > farthest:
        return (
            f"session: what it expects does not explain the mask (IoU {quality.iou:.3f}, "
            f"{quality.contour_px_95:.1f} px at 95 % of the contour): searched anew"
        )
    if misfit > config.session.largest_misfit:
        return f"session: the mask is {misfit**0.5:.1f} times the expected error from what it expects: searched anew"
    doubts = doubts_of_fit(view, quality, evidence, instrument, config.trust)
    reached = model.base_from_root(calibration.offsets)[0]
    return SessionPose(
        view.camera_from_root,
        view.joints,
        np.asarray(np.linalg.inv(view.information + expected.information), dtype=np.float64),
        np.asarray(view.camera_from_root @ inverse(reached)),
        quality,
        tuple(doubts),
        first.evaluations + view.evaluations,
        rays,
    )
