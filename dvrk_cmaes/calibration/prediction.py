"""What a calibration and readings make expect of images, and the pose of a new frame by refinement of that."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Final, NamedTuple

import numpy as np

from dvrk_cmaes.calibration.document import SessionCalibration
from dvrk_cmaes.calibration.endoscope import Endoscope
from dvrk_cmaes.calibration.frame_fit import FrameFit, OwnEstimate, fit_frame
from dvrk_cmaes.calibration.lag import lag_taken_out
from dvrk_cmaes.calibration.masks_and_sizes import MARGIN, covariance_of_margin
from dvrk_cmaes.calibration.model import outer_readings
from dvrk_cmaes.config import EstimateConfig
from dvrk_cmaes.geometry import Bool, Float64, Posed, inverse
from dvrk_cmaes.instrument.arm import OUTER_JOINTS
from dvrk_cmaes.joints.interpolation import LEAST_ERROR
from dvrk_cmaes.joints.prior import Readings
from dvrk_cmaes.pose.expected_error import covariance_by_camera, expected_error, tip_probability
from dvrk_cmaes.pose.find_pose import FoundPose
from dvrk_cmaes.pose.judge import doubts_in_views, doubts_of_agreement
from dvrk_cmaes.pose.refine.information import times
from dvrk_cmaes.pose.terms.tips_term import Expected
from dvrk_cmaes.pose.views import FrameView, measure_views, pooled_quality

ROLL: Final = 5
"""Index, among the changes of pose and joints, of the first that is an error of the wrist: roll."""
WRIST_ERROR: Final = 2.0
"""Factor on the errors of roll and joints that a calibration expects of later images.

In 12 recordings with known truth the wrist was 1.5 to 2.5 standard deviations (root mean square) off what the
keyframes before an image expect; the arm was 0.5 to 1.
"""
_UNREAD_M, _UNREAD_RAD = 0.01, 0.2  # standard deviations of the arm's motion where its readings are missing or frozen


def endoscope_in(
    calibration: SessionCalibration, times: Sequence[float | None], names: Sequence[str], ecm: Float64 | None
) -> Endoscope | None:
    """Return where an endoscope is in N images; None where it stands still, or its place is not known.

    Parameters
    ----------
    calibration
        The calibration.
    times, names
        Times, s, and names of the images, by which the place of an endoscope that is not read is found.
    ecm : (N, 4)
        Readings of the endoscope's arm, rad and m; None without.
    """
    if calibration.endoscope is None:
        return None
    found = calibration.endoscope.in_frames(calibration.camera_from_base, ecm, times, names)
    return None if isinstance(found, str) else found


@dataclass(frozen=True, eq=False)
class Prediction:
    """What is expected of N images.

    ``at`` is where the calibration expects the instrument. ``prior`` (N, D, D) is the covariance of the images' own
    deviations from there, ``shared`` (N, D, D) that by the calibration's errors, and ``jacobian`` (N, D, K) the change
    of ``at`` with the calibration. ``base_from_root`` (N, 4, 4), m, are those of the readings, ``read`` (N, J) the
    joints' readings, rad, NaN without one, and ``roll_offset`` (N,), rad, what the calibration adds to that of roll.
    ``outer_read`` (N,) is whether the outer joints were read.
    """

    at: Posed
    prior: Float64
    shared: Float64
    jacobian: Float64
    base_from_root: Float64
    read: Float64
    roll_offset: Float64
    outer_read: Bool

    @classmethod
    def of(
        cls,
        calibration: SessionCalibration,
        outer: Float64,
        joints: Float64,
        joint_names: tuple[str, ...],
        *,
        outer_read: Bool | None = None,
        moving: Bool | None = None,
        errors: Float64 | None = None,
        late: Float64 | None = None,
        wrist: float = 1.0,
        endoscope: Endoscope | None = None,
    ) -> Prediction:
        """Predict N images.

        Parameters
        ----------
        calibration, joint_names
            The calibration, and the instrument's J joints.
        outer : (N, 4)
            Readings of the outer joints at the times of the images less the lag, rad and m.
        joints : (N, J)
            Those of the instrument's joints, rad; NaN where there is none.
        outer_read, moving : (N,)
            Whether the outer joints were read then, and whether their readings are those of a moving arm; by default
            both. Otherwise the arm may be elsewhere.
        errors : (N, 4)
            How far the readings of the outer joints may be off between those that were taken, rad and m.
        late : (N, 4 + J)
            Change of the readings within a standard deviation of the lag.
        wrist
            Factor on the errors of roll and joints that the calibration expects.
        endoscope
            Where an endoscope that moves is in the images, as of `SessionEndoscope.in_frames`.
        """
        model, own = calibration.model(outer, joints, joint_names, endoscope)
        outer_read = np.ones(len(outer), np.bool_) if outer_read is None else outer_read
        covariance, jacobian = calibration.whole_covariance, model.jacobian(own)
        jacobian = np.pad(jacobian, ((0, 0), (0, 0), (0, len(covariance) - jacobian.shape[2])))
        factor = np.append(np.ones(ROLL), np.full(1 + len(joint_names), wrist))
        prior = model.covariance(own)
        wide = np.diag([_UNREAD_M**2] * 3 + [_UNREAD_RAD**2] * (3 + len(joint_names)))
        prior[~(outer_read if moving is None else outer_read & moving)] += wide
        prior = _with_readings(prior, model.by_errors(own)[:, :, :-6], late, errors) * np.outer(factor, factor)
        of_roll, base_from_root = own.offsets[1] + model.correction.values[:, 0], model.base_from_root(own.offsets)
        shared = jacobian @ covariance @ jacobian.swapaxes(1, 2) * np.outer(factor, factor)
        return cls(model.predict(own), prior, shared, jacobian, base_from_root, joints, of_roll, outer_read)

    def without_calibration(self) -> Prediction:
        """Return the same with the calibration's errors among the images' own deviations."""
        return replace(
            self,
            prior=self.prior + self.shared,
            shared=np.zeros_like(self.shared),
            jacobian=np.zeros_like(self.jacobian),
        )

    @property
    def spread(self) -> Float64:
        """Covariance (N, D, D) of the images about what is expected."""
        return self.prior + self.shared

    def offsets(self, number: int, at: Posed, joint_names: Sequence[str]) -> dict[str, float]:
        """Return the offsets, rad, of roll and of the joints that were read, of one image: true = reading + offset."""
        found = {}
        if self.outer_read[number]:
            found["roll"] = float(self.roll_offset[number] + at.minus(self.at[number])[ROLL])
        for name, value, read in zip(joint_names, at.joints.tolist(), self.read[number].tolist(), strict=True):
            if not np.isnan(read):
                found[name] = value - read
        return found


def _with_readings(prior: Float64, by_readings: Float64, late: Float64 | None, errors: Float64 | None) -> Float64:
    """Return covariances (N, D, D) with errors of the readings, whose effects are (N, D, 4 + J), as of `Prediction`."""
    if late is not None:
        of_lag = times(by_readings, np.nan_to_num(late))
        prior = prior + of_lag[:, :, None] * of_lag[:, None, :]
    if errors is not None:
        off = by_readings[:, :, :4] * np.where(errors > LEAST_ERROR, errors, 0.0)[:, None, :]
        prior = prior + off @ off.swapaxes(1, 2)
    return prior


class FoundLag(NamedTuple):
    """A lag and its standard deviation, s."""

    seconds: float
    std: float


def lag_of(calibration: SessionCalibration, unknown: float) -> FoundLag | None:
    """Return the lag that is taken out of the readings, s, as `lag_taken_out`; else it is an error of theirs."""
    lag = calibration.lag
    found = lag_taken_out(lag, calibration.lag_curve, "s", unknown)
    left = 0.0 if lag is None or lag.applied else abs(lag.seconds or 0.0)
    return None if found is None else FoundLag(found[0], max(found[1], left))


def lag_and_std(calibration: SessionCalibration, unknown: float) -> FoundLag:
    """Return the lag as `lag_of`; 0 with the standard deviation ``unknown`` where nothing shows one."""
    return lag_of(calibration, unknown) or FoundLag(0.0, unknown)


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
    placed, outer = session.at(given, frame=frame, time=time), outer_readings([given])
    missing = [name for name, value in zip(OUTER_JOINTS, outer[0], strict=True) if np.isnan(value)]
    if isinstance(placed, str) or missing:
        lacking = placed if isinstance(placed, str) else f"no reading of {', '.join(missing)}"
        return f"session: {lacking}: searched without it"
    predicted = Prediction.of(placed, outer, readings.values[None], views[0].renderer.body.instrument.joint_names)
    return _refined(placed, views, readings, predicted, config)


def _refined(
    session: SessionCalibration,
    views: Sequence[FrameView],
    readings: Readings,
    predicted: Prediction,
    config: EstimateConfig,
) -> FoundPose | str:
    """Refine what a calibration predicts of a frame; arguments and result as of `fit_session_pose`."""
    expected = Expected.of(predicted.at[0], predicted.spread[0])
    refined = partial(fit_frame, views, config, expected, margin=session.margin_px)
    first, _ = refined((predicted.at[0],), None)
    fit, _ = refined((first.at,), OwnEstimate.of(views, first.at))
    of_views, rays = measure_views(views, readings, Posed.stacked([fit.at]), config)
    qualities = [of_view[0] for of_view in of_views]
    quality = pooled_quality(qualities)
    deviation = fit.at.minus(expected.mean)
    misfit = float(deviation @ expected.information @ deviation) / len(deviation)
    usual = session.iou, session.contour_px_95
    camera, instrument = views[0].evidence.camera, views[0].renderer.body.instrument
    if doubts := doubts_of_agreement("solved", misfit, config.session, quality, usual, camera.pixel_scale):
        return f"session: {'; '.join(doubts)}: searched anew"
    fitted = _covariance(fit, expected, session, predicted)
    of_camera = covariance_by_camera(instrument, camera, fit.at, session.camera_errors)
    error = expected_error(instrument, fit.at, fitted, of_camera)
    reasons, remarks = doubts_in_views(fit.at, views, qualities, error, config.trust, "solved")
    return FoundPose(
        at=fit.at,
        covariance=fitted,
        expected_error=error,
        tip_probability=tip_probability(error.of_tips_mm, config.trust.tip_mm),
        quality=quality,
        reasons=tuple(reasons),
        evaluations=first.evaluations + fit.evaluations + sum(view.renderer.poses for view in views),
        rays=rays + sum(view.renderer.rays for view in views),
        camera_from_base=np.asarray(fit.at.pose @ inverse(predicted.base_from_root[0])),
        notes=tuple(remarks),
    )


def _covariance(fit: FrameFit, expected: Expected, session: SessionCalibration, predicted: Prediction) -> Float64:
    """Return the covariance (D, D) of a fit of the only predicted frame, with the margin of its session's masks."""
    alone = np.asarray(np.linalg.inv(fit.information + expected.information), dtype=np.float64)
    by_calibration = alone @ expected.information @ predicted.jacobian[0]
    return alone + covariance_of_margin(session.blocks.get(MARGIN), alone @ fit.by_margin, by_calibration)
