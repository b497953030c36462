"""Following by a calibration while images come: the last fifteen are the window that is solved.

The terms of an image are those of a recording on disk (`frame_fits`). The base and the offsets stay as they are.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from dvrk_cmaes.calibration.document import SessionCalibration
from dvrk_cmaes.calibration.prediction import WRIST_ERROR, FoundLag, Prediction, endoscope_in
from dvrk_cmaes.camera import Rig
from dvrk_cmaes.config import EstimateConfig
from dvrk_cmaes.geometry import Bool, Float64, Posed
from dvrk_cmaes.instrument import Instrument
from dvrk_cmaes.instrument.arm import Arm
from dvrk_cmaes.pose.doubts import (
    MOST_DISAGREEING,
    NO_OUTER_READINGS,
    calibration_contradicted,
    pose_lost,
    readings_missing,
    reasons,
)
from dvrk_cmaes.pose.terms.tips_term import Expected
from dvrk_cmaes.results.tracked import TrackResult, without_pose
from dvrk_cmaes.silhouette import Body
from dvrk_cmaes.track.frame_fits import ImageFitter, MaskedFit
from dvrk_cmaes.track.reading_buffer import ReadingAt
from dvrk_cmaes.track.view_segmenter import Seen, ViewSegmenter
from dvrk_cmaes.track.window import Found, Judged, Window, WindowImage


@dataclass(frozen=True, eq=False)
class Followed:
    """The views, the instrument, the kinematics of its arm, all settings, and what finds masks in the images."""

    rig: Rig
    body: Body
    arm: Arm
    config: EstimateConfig
    segmenter: ViewSegmenter

    @property
    def instrument(self) -> Instrument:
        """The instrument that is followed."""
        return self.body.instrument


_WINDOW = 15  # images whose deviations are estimated together
_SEEN_MOTION = (2e-4, 5e-3, 2e-2)  # m, rad of the shaft and rad of a joint, beyond which two masks differ
_LEARNED_EVERY = 0.2  # s
_IN_A_ROW = 4  # images that are inconsistent, from which on the keyframes are solved again
_SOON = 1.0  # s, since following by a calibration began


class Follower:
    """Follows an instrument by a calibration.

    Parameters
    ----------
    given
        What is followed.
    calibration
        Its base, offsets and spreads; its lag is taken out of the readings before they are given.
    lag
        That lag; None if it is not observable.
    uncertain
        Whether the calibration is of so few frames that images are to correct what it predicts: its errors then count
        as deviations that change slowly, and not as ones that all images share.

    ``explained`` is whether the pose of the last image explains its masks, ``masks``, which were given or found.
    ``outliers`` and ``unsupported`` are the numbers of images in a row up to it whose innovation is beyond the gate,
    and that no pose explains.
    """

    def __init__(
        self, given: Followed, calibration: SessionCalibration, lag: FoundLag | None, *, uncertain: bool = False
    ) -> None:
        self.calibration, self.lag = calibration, lag
        self.explained, self.outliers, self.unsupported = False, 0, 0
        self.masks: Mapping[str, Bool] = {}
        self._began, self._seconds = np.inf, 0.0  # s, time of the first image, and since then
        self._given, self._uncertain = given, uncertain
        self._views = calibration.corrected_views(given.rig.views)
        self._window = Window(calibration, given.rig.views[0].camera, given.instrument, given.config)
        self._images: deque[WindowImage] = deque(maxlen=_WINDOW)
        self._deviation: Float64 | None = None  # (D,) of the last fit from its prediction; None where it does not hold
        self._lengths: dict[str, float] = {}  # px, correlation lengths of the contours' errors, by view
        self._outer: Float64 | None = None  # the last readings of the outer joints
        self._ecm: Float64 | None = None  # and of the endoscope's arm
        self._still: Posed | None = None  # where the last image that differs from the one before was expected
        self._learned = -np.inf  # s, when the colours were learned last

    @property
    def has_readings(self) -> bool:
        """Whether the outer joints have been read at an image so far."""
        return self._outer is not None

    @property
    def late(self) -> float:
        """The lag that is taken out of the readings, s."""
        return 0.0 if self.lag is None else self.lag.seconds

    @property
    def contradicted(self) -> bool:
        """Whether so many images in a row are inconsistent with the calibration that it does not hold any more."""
        return self.outliers >= MOST_DISAGREEING

    @property
    def is_inconsistent(self) -> bool:
        """Whether the last images are inconsistent with the calibration."""
        return self.outliers >= _IN_A_ROW

    @property
    def fails_early(self) -> bool:
        """Whether no pose has explained the last masks so soon after the first image that the calibration is wrong."""
        return self.unsupported >= _IN_A_ROW and self._seconds <= _SOON

    def _predicted(self, reading: ReadingAt, outer: Float64, time: float) -> Prediction:
        """Predict an image from its readings less the lag, with other readings of the outer joints (4,), rad and m."""
        self._ecm = self._ecm if reading.ecm is None else reading.ecm
        endoscope = endoscope_in(self.calibration, [time], [""], None if self._ecm is None else self._ecm[None])
        lag_std = self._given.config.track.lag_std if self.lag is None else self.lag.std
        predicted = Prediction.of(
            self.calibration,
            outer[None],
            reading.joints[None],
            self._given.instrument.joint_names,
            outer_read=np.array([reading.has_outer and (endoscope is None) == (self.calibration.endoscope is None)]),
            moving=np.array([not reading.still]),
            errors=None if reading.sparse is None else reading.sparse.error[None],
            late=lag_std * reading.rates[None] if lag_std > 0 else None,
            wrist=WRIST_ERROR,
            endoscope=endoscope,
        )
        return predicted.without_calibration() if self._uncertain else predicted

    def follow(
        self,
        time: float,
        reading: ReadingAt,
        seen: Seen,
        *,
        shows_well: Callable[[Mapping[str, Bool]], bool] = lambda masks: True,
    ) -> TrackResult:
        """Fit the image of a later time, s, whose readings, less the lag, are ``reading``.

        An image whose masks, by view, do not show the instrument well is no evidence against the calibration.
        """
        given = self._given
        self._began = min(self._began, time)
        self._seconds = time - self._began
        if reading.has_outer:
            self._outer = reading.outer
        if self._outer is None:
            return without_pose(time, NO_OUTER_READINGS)
        predicted = self._predicted(reading, self._outer, time)
        at, spread = predicted.at[0], predicted.spread[0]
        if not seen.any_same or self._still is None:
            self._still = at
        elif reading.has_outer and has_moved(self._still, at):
            seen = seen.without_frozen()
        before, self._deviation = self._deviation, None
        fitted = self._fit(seen, at, spread, before)
        image = self._window.image(time, predicted, 0, fitted)
        if fitted is not None and fitted.holds:
            self._deviation = fitted.fit.at.minus(at)
            self._lengths |= {view.name: px for view, px in zip(fitted.views, fitted.own.lengths, strict=True)}
        self.masks = {} if fitted is None else fitted.masks
        self._images.append(image)
        (found,) = self._window.solve(list(self._images), only_last=True)
        judged = self._judged(fitted, found, image, seen)
        if judged.error is not None:
            self._count(judged, image.misfit, reading, in_view=shows_well(self.masks))
        else:
            self.explained = False
        if self.explained and time - self._learned >= _LEARNED_EVERY:
            self._learned = time
            given.segmenter.learn(seen, self._views, found[0])
        still = reading.still and judged.error is not None
        doubts = [
            *reasons(calibration_contradicted(self.outliers)),
            *judged.reasons,
            *reasons(readings_missing(reading.has_outer, still, seen.source)),
        ]
        return self._window.result(image, found, judged, doubts)

    def _count(self, judged: Judged, misfit: float, reading: ReadingAt, *, in_view: bool) -> None:
        """Count outliers; ``in_view`` is whether the image shows enough to contradict the calibration."""
        outlier = judged.status == "lost" or misfit > self._given.config.session.largest_misfit
        read = reading.has_outer and not reading.still
        self.outliers = self.outliers + in_view if outlier and read else 0
        self.explained = judged.explained and not outlier
        self.unsupported = 0 if self.explained else self.unsupported + in_view

    def _fit(self, seen: Seen, at: Posed, spread: Float64, before: Float64 | None) -> MaskedFit | None:
        """Fit an image about what is expected of its pose; ``before`` (D,) is the deviation before."""
        given, segmenter = self._given, self._given.segmenter
        if not seen.clear:
            return None
        shown = self.calibration.corrected_views(segmenter.views(seen))
        colours = None if seen.masks else segmenter.colours
        fitter = ImageFitter(given.body, given.config, self.calibration.margin_px, colours, self._lengths)
        return fitter.fit(shown, Expected.of(at, spread), before)

    def _judged(self, fitted: MaskedFit | None, found: Found, image: WindowImage, seen: Seen) -> Judged:
        """Judge the pose of an image by how it explains the masks that were given or found."""
        if fitted is None:
            lost = seen.problem is None or (seen.main.given and not seen.any_same)
            doubts = reasons(pose_lost(seen.source, None)) if seen.problem is None else [seen.problem]
            return Judged("lost" if lost else "doubtful", doubts, None)
        doubts = self._window.doubts(fitted, found, image, seen.source)
        judged = self._window.judged(fitted.views, found, image.misfit, doubts, self._given.body, seen.source)
        return replace(judged, explained=judged.explained and not fitted.doubts)


def has_moved(before: Posed, now: Posed) -> bool:
    """Whether an instrument has moved so far that its masks must differ."""
    change = np.abs(now.minus(before))
    parts = (change[:3], change[3:5], change[6:])
    return any(bool((part > most).any()) for part, most in zip(parts, _SEEN_MOTION, strict=True))
