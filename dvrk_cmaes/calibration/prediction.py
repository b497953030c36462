"""Pose of a new frame of a calibrated session, by refinement of the pose that the calibration predicts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.calibration.document import SessionCalibration
from dvrk_cmaes.calibration.frame_fit import OF_NEW_FRAME, OwnEstimate, fit_frame
from dvrk_cmaes.calibration.mask_growth import covariance_of_growth
from dvrk_cmaes.calibration.model import outer_readings
from dvrk_cmaes.calibration.session_camera import covariance_of_camera
from dvrk_cmaes.calibration.session_doubts import OF_FRAMES
from dvrk_cmaes.calibration.session_masks import margins_of
from dvrk_cmaes.config import EstimateConfig
from dvrk_cmaes.geometry import Posed, inverse
from dvrk_cmaes.instrument.arm import OUTER_JOINTS
from dvrk_cmaes.joints.prior import Readings
from dvrk_cmaes.pose.doubts import doubts_in_views
from dvrk_cmaes.pose.expected_error import expected_error
from dvrk_cmaes.pose.find_pose import FoundPose
from dvrk_cmaes.pose.quality import measure_views, pooled_quality
from dvrk_cmaes.pose.terms.expected import Expected
from dvrk_cmaes.pose.tip_probability import tip_probability
from dvrk_cmaes.pose.views import FrameView

Float64 = NDArray[np.float64]


def fit_session_pose(
    session: SessionCalibration,
    views: Sequence[FrameView],
    readings: Readings,
    given: Mapping[str, float],
    config: EstimateConfig,
    *,
    frame: str = "",
    time: float | None = None,
) -> FoundPose | str:
    """Refine the pose that a session's calibration predicts for a frame to fit the frame's mask, or those of its views.

    Parameters
    ----------
    session
        The calibration.
    views
        The views that show the instrument, of which the first is the reference.
    readings
        Readings and limits of the instrument's joints.
    given
        All readings of the frame by joint name, rad and m.
    config
        All settings.
    frame, time
        Name of the frame and time of its image, s, by which the place of an endoscope that moves is found.

    Returns
    -------
    FoundPose or str
        The pose; or the text of a warning, if an outer joint has no reading, the refined pose does not explain the
        mask, or it is too far from the prediction.

    Raises
    ------
    InputError
        The session is of an instrument with other joints.
    """
    placed = session.at(given, frame=frame, time=time)
    if isinstance(placed, str):
        return f"session: {placed}: searched without it"
    session, instrument = placed, views[0].renderer.body.instrument
    outer = outer_readings([given])
    model, calibration = session.model(outer, readings.values[None], instrument.joint_names)
    missing = [name for name, value in zip(OUTER_JOINTS, outer[0], strict=True) if np.isnan(value)]
    if missing:
        return f"session: no reading of {', '.join(missing)}: searched without it"
    start = model.predict(calibration)[0]
    jacobian = model.jacobian(calibration)[0]
    covariance = model.covariance(calibration)[0] + jacobian @ session.covariance_given_camera @ jacobian.T
    expected = Expected(start, np.asarray(np.linalg.inv(covariance), dtype=np.float64))
    margins = margins_of(session.masks, [view.name for view in views])
    refined = partial(fit_frame, views, readings, config, expected, margins=margins, preset=OF_NEW_FRAME)
    first, _ = refined((start,), None)
    fit, _ = refined((first.at,), OwnEstimate.of(views, first.at))
    of_views, rays = measure_views(views, readings, Posed.stacked([fit.at]), config)
    qualities = [of_view[0] for of_view in of_views]
    quality = pooled_quality(qualities)
    deviation = fit.at.minus(expected.mean)
    misfit = float(deviation @ expected.information @ deviation) / len(deviation)
    if doubts := OF_FRAMES["alone"].doubts(quality, misfit, session, config.session):
        return f"session: {'; '.join(doubts)}: searched anew"
    fitted = np.asarray(np.linalg.inv(fit.information + expected.information), dtype=np.float64)
    camera = views[0].evidence.camera
    fitted += covariance_of_camera(session.camera, fit.at, camera)
    if session.masks is not None:
        fitted += covariance_of_growth(session.masks.rms_growth_px, fit.at, camera, instrument)
    error = expected_error(instrument, fit.at, fitted)
    doubts, remarks = doubts_in_views(fit.at, views, qualities, error, config.trust)
    base_from_root = model.base_from_root(calibration.offsets)[0]
    return FoundPose(
        at=fit.at,
        covariance=fitted,
        expected_error=error,
        tip_probability=tip_probability(error.of_tips_mm, config.trust.tip_mm),
        quality=quality,
        reasons=tuple(doubts),
        evaluations=first.evaluations + fit.evaluations + sum(view.renderer.poses for view in views),
        rays=rays + sum(view.renderer.rays for view in views),
        camera_from_base=np.asarray(fit.at.pose @ inverse(base_from_root)),
        notes=tuple(remarks),
    )
