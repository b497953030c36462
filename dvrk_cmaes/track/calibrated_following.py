"""Following by a known calibration: each image is fitted with what that and the images just before expect.

The terms are those of a recording on disk (`recorded_frames`), and the deviations from the calibration's predictions
are estimated over the last images instead of all. The base and the offsets stay as they are.
"""

from __future__ import annotations

import time as clock
from collections import deque
from collections.abc import Mapping
from dataclasses import replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.calibration.document import SessionCalibration
from dvrk_cmaes.camera import Rig
from dvrk_cmaes.config import EstimateConfig
from dvrk_cmaes.frames.seen_view import seen_views
from dvrk_cmaes.geometry import Posed
from dvrk_cmaes.pose.terms.expected import Expected
from dvrk_cmaes.results.tracked import TrackResult, TrackStatus
from dvrk_cmaes.silhouette import Body
from dvrk_cmaes.track.describe import without_pose
from dvrk_cmaes.track.prediction import WRIST_ERROR, Prediction
from dvrk_cmaes.track.quick_fit import QuickFit, judged, quick_fit
from dvrk_cmaes.track.reading_buffer import ReadingAt
from dvrk_cmaes.track.recorded_frames import EMPTY, NO_READINGS, JudgedFrame
from dvrk_cmaes.track.sight import Seen, Sight
from dvrk_cmaes.track.window import LIMITS, Told, WindowImage, result_of, solve_window, status_of

Float64 = NDArray[np.float64]

BASE_MOVED: Final = (
    "calibration contradicted: {count} images in a row disagree with it; the base or the camera may have moved"
)

_WINDOW = 15  # images whose deviations are estimated together
_MOST_ASTRAY = 10  # images in a row that disagree with the calibration, after which it does not hold any more
_DISAGREES = 4  # images in a row that disagree, from which on the keyframes are solved again


class CalibratedFollowing:
    """Follows an instrument whose calibration is known.

    Parameters
    ----------
    rig, body, config
        The views, the instrument, all settings.
    calibration
        Its base, offsets and spreads; its lag is taken out of the readings before they are given.
    lag_std
        Standard deviation of that lag, s.
    uncertain
        Whether the calibration is of so few frames that images are to correct what it predicts: its errors then count
        as deviations that change slowly, and not as ones that all images share.
    """

    def __init__(
        self,
        rig: Rig,
        body: Body,
        config: EstimateConfig,
        calibration: SessionCalibration,
        *,
        lag_std: float = 0.0,
        uncertain: bool = False,
    ) -> None:
        self.calibration = calibration
        self.misfit = 0.0
        self._lag_std = lag_std
        self._uncertain = uncertain
        self._rig, self._body = rig, body
        self._config = replace(config, threads=1)
        self._images: deque[WindowImage] = deque(maxlen=_WINDOW)
        self._before: Float64 | None = None
        self._outer: Float64 | None = None
        self._lengths: dict[str, float] = {}  # px, correlation lengths of the contours' errors, by view
        self._astray = 0
        self._unexplained = 0

    @property
    def has_readings(self) -> bool:
        """Whether the outer joints have been read at an image so far."""
        return self._outer is not None

    @property
    def contradicted(self) -> bool:
        """Whether so many images in a row disagree with the calibration that it does not hold any more."""
        return self._astray >= _MOST_ASTRAY

    @property
    def explains_little(self) -> bool:
        """Whether the last masks are not explained, as where a calibration of few frames is wrong, or masks are bad."""
        return self._unexplained >= _DISAGREES

    @property
    def disagrees(self) -> bool:
        """Whether the last images disagree with the calibration."""
        return self._astray >= _DISAGREES

    @property
    def begun(self) -> bool:
        """Whether an image has been followed to."""
        return bool(self._images)

    def start_from(self, at: Posed, reading: ReadingAt) -> None:
        """Let the fit of the next image start from the pose and joints of one before it, with that one's readings."""
        if reading.has_outer:
            self._before = at.minus(self._predicted(reading, reading.outer).at[0])

    def _predicted(self, reading: ReadingAt, outer: Float64) -> Prediction:
        """Predict an image from its readings less the lag, with other readings of the outer joints (4,), rad and m."""
        predicted = Prediction.of(
            self.calibration,
            outer[None],
            reading.joints[None],
            self._body.instrument.joint_names,
            told=np.array([reading.has_outer]),
            moving=np.array([not reading.still]),
            errors=None if reading.sparse is None else reading.sparse.error[None],
            late=self._lag_std * reading.rates[None] if self._lag_std > 0 else None,
            wrist=WRIST_ERROR,
        )
        return predicted.without_calibration() if self._uncertain else predicted

    def follow(self, time: float, reading: ReadingAt, seen: Seen, sight: Sight, *, in_view: bool = True) -> TrackResult:
        """Fit the image of a later time, s, whose readings, less the lag, are ``reading``.

        An image that does not show the instrument well, ``in_view``, does not tell against the calibration.
        """
        started = clock.perf_counter()
        if reading.has_outer:
            self._outer = reading.outer
        if self._outer is None:
            return without_pose(time, "no readings of the outer joints so far")
        predicted, instrument = self._predicted(reading, self._outer), self._body.instrument
        at, spread = predicted.at[0], predicted.spread[0]
        fitted = self._fitted(at, spread, seen, sight)
        told = Told.of(fitted, at, spread)
        self.misfit = told.misfit
        self._images.append(WindowImage(time, at, predicted.prior[0], predicted.jacobian[0], told))
        camera = self._rig.views[0].camera
        (found,) = solve_window(list(self._images), self.calibration, camera, instrument, only_last=True)
        quality: JudgedFrame | None = None
        status: TrackStatus
        if fitted is None:
            problem = seen.problem if seen.masks[seen.main] is None else None
            status, reasons = ("lost", [EMPTY.format(source="mask")]) if problem is None else ("doubtful", [problem])
            self._before = None
        else:
            quality = judged(fitted.views, *found, self._body, self._config)
            status, reasons = status_of(quality, told.misfit, self.calibration, self._config)
            self._before = fitted.fit.at.minus(at) if fitted.fit.explains_mask else None
            disagrees = status == "lost" or told.misfit > self._config.session.largest_misfit
            told_by_readings = reading.has_outer and not reading.still
            self._astray = self._astray + in_view if disagrees and told_by_readings else 0
            explained = not disagrees and quality.quality.iou >= self.calibration.iou - LIMITS.overlap_loss
            self._unexplained = 0 if explained else self._unexplained + in_view
        if not reading.has_outer:
            reasons.append(NO_READINGS)
        elif reading.still and fitted is not None:
            reasons.append("readings stand still: where the instrument is, only the mask tells")
        if self.contradicted:
            reasons.insert(0, BASE_MOVED.format(count=self._astray))
        return result_of(
            time,
            status,
            reasons,
            found,
            quality,
            predicted,
            0,
            self.calibration,
            instrument,
            camera,
            seconds=clock.perf_counter() - started,
        )

    def checkpoint(self) -> dict[str, Any]:
        """Return the state as plain values."""
        images = [
            [
                image.time,
                image.at.pose.tolist(),
                image.at.joints.tolist(),
                image.prior.tolist(),
                image.jacobian.tolist(),
                image.told.information.tolist(),
                image.told.optimum.tolist(),
            ]
            for image in self._images
        ]
        return {
            "calibration": self.calibration.to_dict(),
            "images": images,
            "before": None if self._before is None else self._before.tolist(),
            "outer": None if self._outer is None else self._outer.tolist(),
            "lengths": dict(self._lengths),
            "astray": self._astray,
            "unexplained": self._unexplained,
            "uncertain": self._uncertain,
        }

    def restore(self, saved: Mapping[str, Any]) -> None:
        """Go on from the values of `checkpoint` but for its calibration; errors as of `KnownBase.restore`."""
        self._images.clear()
        for time, *rest in saved["images"]:
            pose, joints, prior, jacobian, information, optimum = (np.array(each, dtype=np.float64) for each in rest)
            self._images.append(
                WindowImage(float(time), Posed(pose, joints), prior, jacobian, Told(information, optimum, 0.0))
            )
        self._before = None if saved["before"] is None else np.array(saved["before"], dtype=np.float64)
        self._outer = None if saved["outer"] is None else np.array(saved["outer"], dtype=np.float64)
        self._lengths = {name: float(length) for name, length in saved["lengths"].items()}
        self._astray, self._unexplained = int(saved["astray"]), int(saved["unexplained"])
        self._uncertain = bool(saved["uncertain"])

    def _fitted(self, at: Posed, spread: Float64, seen: Seen, sight: Sight) -> QuickFit | None:
        """Fit an image's masks; None if they show nothing, or there is none."""
        names = self._rig.names
        masks = {names[view]: mask for view in seen.clear if (mask := seen.masks[view]) is not None}
        if not masks:
            return None
        views = self.calibration.corrected_views(seen_views(masks, self._rig, sight.ignored(seen)))
        expected = Expected(at, np.asarray(np.linalg.inv(spread), dtype=np.float64))
        fitted = quick_fit(
            self._body, self._config, views, expected, self._before, self._lengths, self.calibration.masks
        )
        if fitted is not None and fitted.fit.explains_mask:
            self._lengths |= {view.name: length for view, length in zip(fitted.views, fitted.lengths, strict=True)}
        return fitted
