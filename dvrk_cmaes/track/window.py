"""The window: images whose deviations from a calibration's predictions are estimated together, and their results.

A recording on disk is one window of all its frames; while images come, the window is the last fifteen.

The deviations of a frame (slack of the arm, errors of roll and joints) are those of the calibration's model. A part of
them changes slowly, the rest from frame to frame: both are Gauss-Markov processes of first order. The outline states
each frame's deviation by a quadratic term. The most probable deviations of all frames together follow from one
block-tridiagonal system.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from dvrk_cmaes import _kernel
from dvrk_cmaes.calibration.document import SessionCalibration
from dvrk_cmaes.calibration.masks_and_sizes import MARGIN, covariance_of_margin
from dvrk_cmaes.calibration.prediction import Prediction
from dvrk_cmaes.calibration.session_doubts import resting_on
from dvrk_cmaes.calibration.session_frame import StoredView
from dvrk_cmaes.calibration.solve import robust_weights
from dvrk_cmaes.camera import Camera
from dvrk_cmaes.config import EstimateConfig
from dvrk_cmaes.evidence.quantiles import NORMAL_MEDIAN
from dvrk_cmaes.geometry import Float64, Posed, inverse, substituted
from dvrk_cmaes.instrument import Instrument
from dvrk_cmaes.pose.doubts import FOLLOWED, pose_lost, reasons
from dvrk_cmaes.pose.expected_error import covariance_by_camera, expected_error, locate_tips, tip_probability
from dvrk_cmaes.pose.judge import doubts_in_views, doubts_of_agreement, far_joints
from dvrk_cmaes.pose.views import FrameView, measure_overlap, pooled_quality
from dvrk_cmaes.results.result import ExpectedError
from dvrk_cmaes.results.tracked import TrackResult, TrackStatus
from dvrk_cmaes.silhouette import Body
from dvrk_cmaes.track.frame_fits import MaskedFit

Found = tuple[Posed, Float64, Float64]
"""Pose and joints, their covariance (D, D) given the camera, and that by the camera's errors."""

SLOW_SHARE: Final = 0.8
"""Share of a deviation's variance that changes slowly."""
SLOW_SECONDS: Final = 0.5
FAST_SECONDS: Final = 0.1
"""Correlation times, s, of both parts."""

_CORRELATED_FRAMES = 3.0  # near each other, whose masks err alike: the information of each counts as much less
_JITTER = 1e-9  # of a covariance, so that it can be inverted


def smoothed_deviations(images: Sequence[WindowImage], *, only_last: bool = False) -> tuple[Float64, Float64, Float64]:
    """Find the most probable deviations of all N images, or of the last one only, N = 1, given all.

    They are the sums of slow and fast parts, M = 2 D, of a block-tridiagonal system. The images' times increase.

    Returns
    -------
    deviations : (N, D)
        Those of the images from their predictions.
    covariance : (N, D, D)
        That of the deviations.
    response : (N, D, K + 1)
        Change of the images' poses and joints with the calibration, and per px of the margin of all masks.
    """
    times = np.array([image.time for image in images])
    prior = np.array([image.predicted.prior[image.k] for image in images])
    jacobian = np.array([image.predicted.jacobian[image.k] for image in images])
    information = np.array([image.information for image in images])
    stated = np.array([[image.optimum, image.by_margin] for image in images])
    size, parts = stated.shape[2], np.array([SLOW_SHARE, 1 - SLOW_SHARE])
    # of both parts, from a frame to the next one
    left = np.exp(-np.diff(times)[:, None] / np.array([SLOW_SECONDS, FAST_SECONDS]))
    noise = parts * (1 - left**2 + _JITTER)
    # A covariance is carried to the next frame as its Cholesky factor, since it may be another one there.
    inverse_root = np.linalg.inv(np.linalg.cholesky(prior))
    turned = inverse_root.swapaxes(1, 2)
    own, across = turned @ inverse_root, turned[:-1] @ inverse_root[1:]
    factors = np.concatenate([1 / parts[None], 1 / noise])
    factors[:-1] += left**2 / noise
    diagonal = np.tile(information, (1, 2, 2))  # the deviation is the sum of both parts
    coupling = np.zeros((len(left), 2 * size, 2 * size))  # between a frame and the next one
    for k, part in enumerate((slice(0, size), slice(size, None))):
        diagonal[:, part, part] += factors[:, k, None, None] * own
        coupling[:, part, part] = -(left / noise)[:, k, None, None] * across
    right = np.concatenate([stated[:, 0, :, None], -information @ jacobian, stated[:, 1, :, None]], axis=2)
    both = np.tile(np.eye(size), 2)
    pivots, sides = _kernel.eliminate_chain(diagonal, coupling, np.tile(right, (1, 2, 1)))
    if only_last:
        pivots, found = pivots[-1:], pivots[-1:] @ sides[-1:]
    else:
        found, pivots = substituted(pivots, sides, coupling)
    found = both @ found
    moves = np.pad(jacobian, ((0, 0), (0, 0), (0, 1)))[-len(found) :]
    return found[:, :, 0], both @ pivots @ both.T, moves + found[:, :, 1:]


@dataclass(frozen=True, eq=False)
class WindowImage:
    """An image of the window: its time, s, its prediction, the ``k``-th of some, and what its fit states about that.

    ``information`` (D, D) is the matrix of the outline's quadratic term, ``optimum`` (D,) that times the deviation at
    which the term is least, and ``by_margin`` (D,) its change per px of a margin of all masks; they are zero where the
    fit states nothing. ``misfit`` is the squared misfit per parameter.
    """

    time: float
    predicted: Prediction
    k: int
    information: Float64
    optimum: Float64
    by_margin: Float64
    misfit: float

    @property
    def at(self) -> Posed:
        """Where the calibration expects the instrument."""
        return self.predicted.at[self.k]


@dataclass(frozen=True, eq=False)
class Judged:
    """The status of an image's pose by the image alone, the reasons, and its expected error, None if it shows nothing.

    ``residual_px`` is the standard deviation of the contour or the edges about the outline, None without any.
    ``explained`` is whether the pose explains the image well.
    """

    status: TrackStatus
    reasons: list[str]
    error: ExpectedError | None = None
    residual_px: float | None = None
    explained: bool = False


@dataclass(frozen=True, eq=False)
class Window:
    """What images are followed by: a calibration, the camera as its file has it, the instrument, and all settings."""

    calibration: SessionCalibration
    camera: Camera
    instrument: Instrument
    config: EstimateConfig

    def image(self, time: float, predicted: Prediction, k: int, fitted: MaskedFit | None) -> WindowImage:
        """Return the ``k``-th of some images with what its fit states, weighed by how it agrees with the prediction.

        The contour's roughness widens the covariance of the fit; one that does not hold states nothing.
        """
        spread = predicted.spread[k]
        size = len(spread)
        nothing = np.zeros(size)
        if fitted is None:
            return WindowImage(time, predicted, k, np.zeros((size, size)), nothing, nothing, 0.0)
        fit, inflation = fitted.fit, fitted.own.noises[0].inflation(self.camera.pixel_scale)
        deviation = fit.at.minus(predicted.at[k])
        own = np.linalg.pinv(fit.information, rcond=1e-9, hermitian=True)
        least = deviation - own @ fit.slope
        misfit = float(least @ np.linalg.solve(spread + own, least)) / size
        weight = float(robust_weights(np.array([misfit]))[0]) if fitted.holds else 0.0
        weight /= inflation * _CORRELATED_FRAMES
        optimum = weight * (fit.information @ deviation - fit.slope)
        return WindowImage(time, predicted, k, weight * fit.information, optimum, weight * fit.by_margin, misfit)

    def solve(self, images: Sequence[WindowImage], *, only_last: bool = False) -> list[Found]:
        """Find the poses and joints of N images by what all of them state.

        The covariances include those of the calibration. With ``only_last``, the list has the last image alone.
        """
        calibration = self.calibration
        corrected = calibration.corrected(self.camera)
        deviations, covariances, responses = smoothed_deviations(images, only_last=only_last)
        calibrated, found = calibration.whole_covariance, []
        solved = images[-len(deviations) :]
        for image, deviation, own, response in zip(solved, deviations, covariances, responses, strict=True):
            at, by_calibration = image.at.moved(deviation), response[:, :-1]
            covariance = own + by_calibration @ calibrated @ by_calibration.T
            covariance += covariance_of_margin(calibration.blocks.get(MARGIN), response[:, -1], by_calibration)
            of_camera = covariance_by_camera(self.instrument, corrected, at, calibration.camera_errors)
            found.append((at, covariance, of_camera))
        return found

    def doubts(self, fitted: MaskedFit, found: Found, image: WindowImage, source: str) -> list[str]:
        """Return the reasons to doubt the masks that were found in an image."""
        if source == "mask":
            return fitted.doubts
        names, spread = self.instrument.joint_names, image.predicted.spread[image.k]
        return [*fitted.doubts, *far_joints(found[0], image.at, spread, names)]

    def judged(
        self, views: Sequence[FrameView], found: Found, misfit: float, of_masks: Sequence[str], body: Body, source: str
    ) -> Judged:
        """Judge an image by how its pose explains the masks of views; ``source`` names the evidence.

        ``misfit`` is the squared misfit per parameter of its fit and the prediction, ``of_masks`` are reasons to doubt
        the masks.
        """
        at, covariance, of_camera = found
        qualities = [measure_overlap(view, at) for view in views]
        error = expected_error(self.instrument, at, covariance, of_camera)
        shown, _ = doubts_in_views(at, views, qualities, error, self.config.trust, "followed")
        quality = pooled_quality(qualities)
        residual_px, least_iou = NORMAL_MEDIAN * quality.contour_px_median, self.calibration.iou - FOLLOWED.overlap_loss
        explained = quality.iou >= least_iou
        no_support = pose_lost(source, quality.iou)
        if no_support is not None:
            return Judged("lost", [*reasons(no_support), *of_masks], error, residual_px, explained)
        usual, scale = (self.calibration.iou, self.calibration.contour_px_95), self.camera.pixel_scale
        doubts = [*shown, *doubts_of_agreement("followed", misfit, self.config.session, quality, usual, scale)]
        doubts += of_masks
        return Judged("doubtful" if doubts else "ok", doubts, error, residual_px, explained)

    def result(
        self,
        image: WindowImage,
        found: Found,
        judged: Judged,
        doubts: Sequence[str],
        *,
        seconds: float = 0.0,
        remarks: tuple[str, ...] = (),
    ) -> TrackResult:
        """Describe an image of the window; one for whose pose there is any reason to doubt it is not ok.

        ``found`` are pose and joints with their covariances, ``doubts`` all reasons, those of ``judged`` among
        them; ``seconds`` and ``remarks`` are as in `TrackResult`.
        """
        (at, covariance, of_camera), instrument = found, self.instrument
        tips, _ = locate_tips(instrument, self.camera, at)
        error = expected_error(instrument, at, covariance, of_camera) if judged.error is None else judged.error
        lost, each = judged.status == "lost", [value for name, value in error.tip_mm.items() if name != "mean"]
        result = TrackResult(
            time=image.time,
            status="doubtful" if doubts and judged.status == "ok" else judged.status,
            reasons=tuple(doubts),
            camera_from_root=at.pose,
            joints=dict(zip(instrument.joint_names, at.joints.tolist(), strict=True)),
            covariance=covariance,
            tips=np.array(tips),
            tip_std_mm=float(np.mean(each)) if instrument.jaw_tips else None,
            camera_from_base=np.asarray(at.pose @ inverse(image.predicted.base_from_root[image.k])),
            offsets=image.predicted.offsets(image.k, at, instrument.joint_names),
            seconds=seconds,
            residual_px=judged.residual_px,
            tip_probability=None if lost else tip_probability(error.of_tips_mm, self.config.trust.tip_mm),
            remarks=remarks,
        )
        return resting_on(result, self.calibration)


Shown = tuple[Sequence[StoredView], Found, float, Sequence[str]]
"""The views of a frame, its pose, its misfit and reasons to doubt its masks."""


def judge_frame(body: Body, config: EstimateConfig, task: Shown, *, window: Window, source: str) -> Judged:
    """Judge a frame as `Window.judged` does."""
    views, found, misfit, of_masks = task
    return window.judged([view.restored(body) for view in views], found, misfit, of_masks, body, source)
