"""Following by a calibration while images come: the last fifteen are the window that is solved.

The terms of an image are those of a recording on disk (`recorded_frames`). The base and the offsets stay as they are.
"""

from __future__ import annotations

import time as clock
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from dvrk_cmaes.calibration.document import SessionCalibration
from dvrk_cmaes.calibration.mask_growth import change_by_margin
from dvrk_cmaes.calibration.prediction import WRIST_ERROR, Prediction, endoscope_at
from dvrk_cmaes.camera import Rig
from dvrk_cmaes.config import EstimateConfig
from dvrk_cmaes.frames.seen_view import seen_views
from dvrk_cmaes.geometry import Float64, Posed, apply
from dvrk_cmaes.pose.doubts import doubts_of_tips, outside_image
from dvrk_cmaes.pose.expected_error import expected_error
from dvrk_cmaes.pose.terms.expected import Expected
from dvrk_cmaes.results.result import ExpectedError
from dvrk_cmaes.results.tracked import TrackResult, TrackStatus, without_pose
from dvrk_cmaes.silhouette import Body
from dvrk_cmaes.track.images import Mask
from dvrk_cmaes.track.quick_fit import quick_fit
from dvrk_cmaes.track.reading_buffer import ReadingAt
from dvrk_cmaes.track.recorded_frames import EMPTY, NO_READINGS, judged
from dvrk_cmaes.track.view_segmenter import Seen, ViewSegmenter
from dvrk_cmaes.track.window import LIMITS, FitEvidence, WindowImage, result_of, solve_window, status_of

BASE_MOVED: Final = (
    "calibration contradicted: {count} images in a row disagree with it; the base or the camera may have moved"
)

_WINDOW = 15  # images whose deviations are estimated together
_SEEN_MOTION = (2e-4, 5e-3, 2e-2)  # m, rad of the shaft and rad of a joint, beyond which two masks differ
_EDGES_PX = 0.7  # standard deviation of the margin that the colours' edges of all images of a window share
_EDGES_ALIKE = 2.0  # factor by which edges of images near each other err more alike than masks do
_LEARNED_EVERY = 0.2  # s
_MOST_ASTRAY = 10  # images in a row that disagree with the calibration, after which it does not hold any more
_DISAGREES = 4  # images in a row that disagree, from which on the keyframes are solved again


@dataclass(frozen=True, eq=False)
class _Judged:
    """The status of an image's pose by the image, reasons, the error that is expected of it, None if it shows nothing.

    ``explained`` is whether the pose explains the image well.
    """

    status: TrackStatus
    reasons: list[str]
    error: ExpectedError | None
    residual_px: float | None
    explained: bool


_Judge = Callable[[tuple[Posed, Float64]], _Judged]


class Following:
    """Follows an instrument by a calibration.

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

    ``masks`` are those of the last image by name of the view, given or found in it, ``score`` is the negative
    log-likelihood of its fit, ``misfit`` the squared misfit per parameter, and ``explained`` whether its pose explains
    the masks.
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
        self.misfit, self.score, self.explained = 0.0, 0.0, False
        self.masks: dict[str, Mask] = {}
        self._lag_std = lag_std
        self._uncertain = uncertain
        self._rig, self._body = rig, body
        self._views = calibration.corrected_views(rig.views)
        self._config = replace(config, threads=1)
        self._images: deque[WindowImage] = deque(maxlen=_WINDOW)
        self._before: Float64 | None = None
        self._outer: Float64 | None = None
        self._ecm: Float64 | None = None
        self._lengths: dict[str, float] = {}  # px, correlation lengths of the contours' errors, by view
        self._astray = 0
        self._unexplained = 0
        self._still: Posed | None = None  # where the last image that differs from the one before was expected
        self._learned = -np.inf  # s, when the colours were learned last

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
            self._before = at.minus(self._predicted(reading, reading.outer, None).at[0])

    def _predicted(self, reading: ReadingAt, outer: Float64, time: float | None) -> Prediction:
        """Predict an image from its readings less the lag, with other readings of the outer joints (4,), rad and m."""
        if reading.ecm is not None:
            self._ecm = reading.ecm
        endoscope = endoscope_at(self.calibration, time, self._ecm)
        predicted = Prediction.of(
            self.calibration,
            outer[None],
            reading.joints[None],
            self._body.instrument.joint_names,
            told=np.array([reading.has_outer and (endoscope is None) == (self.calibration.endoscope is None)]),
            moving=np.array([not reading.still]),
            errors=None if reading.sparse is None else reading.sparse.error[None],
            late=self._lag_std * reading.rates[None] if self._lag_std > 0 else None,
            wrist=WRIST_ERROR,
            endoscope=endoscope,
        )
        return predicted.without_calibration() if self._uncertain else predicted

    def follow(
        self,
        time: float,
        reading: ReadingAt,
        seen: Seen,
        segmenter: ViewSegmenter,
        *,
        shows_well: Callable[[Mapping[str, Mask]], bool] = lambda masks: True,
    ) -> TrackResult:
        """Fit the image of a later time, s, whose readings, less the lag, are ``reading``.

        An image whose masks, by view, do not show the instrument well does not tell against the calibration.
        """
        started = clock.perf_counter()
        if reading.has_outer:
            self._outer = reading.outer
        if self._outer is None:
            return without_pose(time, "no readings of the outer joints so far")
        predicted, instrument = self._predicted(reading, self._outer, time), self._body.instrument
        at, spread = predicted.at[0], predicted.spread[0]
        if not seen.any_same or self._still is None:
            self._still = at
        elif reading.has_outer and has_moved(self._still, at):
            seen = seen.without_frozen()
        self.masks, self.explained = segmenter.given(seen), False
        image = self._by_masks if self.masks else self._by_edges
        told, judge = image(at, spread, seen, segmenter)
        self.misfit = told.misfit
        self._images.append(WindowImage(time, at, predicted.prior[0], predicted.jacobian[0], told))
        camera = self._rig.views[0].camera
        (found,) = solve_window(list(self._images), self.calibration, camera, instrument, only_last=True)
        of_image = judge(found)
        reasons = of_image.reasons
        if of_image.error is not None:
            disagrees = of_image.status == "lost" or told.misfit > self._config.session.largest_misfit
            in_view = not self.masks or shows_well(self.masks)
            told_by_readings = reading.has_outer and not reading.still
            self._astray = self._astray + in_view if disagrees and told_by_readings else 0
            self.explained = of_image.explained and not disagrees
            self._unexplained = 0 if self.explained else self._unexplained + in_view
            if self.explained and time - self._learned >= _LEARNED_EVERY:
                self._learned = time
                segmenter.learn(seen, self._views, found[0])
        if not reading.has_outer:
            reasons.append(NO_READINGS)
        elif reading.still and of_image.error is not None:
            reasons.append(f"readings stand still: where the instrument is, only the {seen.source} tells")
        if self.contradicted:
            reasons.insert(0, BASE_MOVED.format(count=self._astray))
        return result_of(
            time,
            of_image.status,
            reasons,
            found,
            of_image.error,
            predicted,
            0,
            self.calibration,
            instrument,
            camera,
            self._config.trust.tip_mm,
            seconds=clock.perf_counter() - started,
            residual_px=of_image.residual_px,
        )

    def masks_of(self, seen: Seen, segmenter: ViewSegmenter) -> dict[str, Mask]:
        """Find masks in the last image, which has none, about the pose to which it was followed."""
        if self._before is None:
            return {}
        return segmenter.masks_at(seen, self._views, self._images[-1].at.moved(self._before))

    def _by_masks(self, at: Posed, spread: Float64, seen: Seen, segmenter: ViewSegmenter) -> tuple[FitEvidence, _Judge]:
        """Fit an image's masks, about what is expected of its pose; also returns how the pose is then judged."""
        views = self.calibration.corrected_views(seen_views(self.masks, self._rig, segmenter.ignored(seen)))
        expected = Expected(at, np.asarray(np.linalg.inv(spread), dtype=np.float64))
        fitted = quick_fit(
            self._body, self._config, views, expected, self._before, self._lengths, self.calibration.masks
        )
        if fitted is None:
            return self._nothing(at, spread, seen)
        fit, self.score = fitted.fit, fitted.fit.score
        told = FitEvidence.of(fit, at, spread, inflation=fitted.inflation, holds=fit.explains_mask)
        self._before = fit.at.minus(at) if fit.explains_mask else None
        if fit.explains_mask:
            self._lengths |= {view.name: length for view, length in zip(fitted.views, fitted.lengths, strict=True)}

        def judge(found: tuple[Posed, Float64]) -> _Judged:
            quality = judged(fitted.views, *found, self._body, self._config)
            status, reasons = status_of(quality, told.misfit, self.calibration, self._config)
            explained = quality.quality.iou >= self.calibration.iou - LIMITS.overlap_loss
            return _Judged(status, reasons, quality.error, quality.residual_px, explained)

        return told, judge

    def _by_edges(self, at: Posed, spread: Float64, seen: Seen, segmenter: ViewSegmenter) -> tuple[FitEvidence, _Judge]:
        """Fit the edges that the colours of an image without masks show, as `_by_masks` does."""
        expected = Expected(at, np.asarray(np.linalg.inv(spread), dtype=np.float64))
        start = at if self._before is None else at.moved(self._before)
        fit = segmenter.fit(seen, start, expected, near=self._before is not None)
        if fit is None:
            return self._nothing(at, spread, seen)
        self.score = fit.score
        margin = _EDGES_PX * change_by_margin(fit.at, self._views[0].camera, self._body.instrument)
        told = FitEvidence.of(fit.with_margin(margin), at, spread, inflation=_EDGES_ALIKE, holds=fit.holds)
        self._before = fit.at.minus(at) if fit.holds else None

        def judge(found: tuple[Posed, Float64]) -> _Judged:
            instrument = self._body.instrument
            error = expected_error(instrument, *found)
            if not fit.holds:
                return _Judged("lost", [f"lost: {'; '.join(fit.doubts)}"], error, fit.sigma, explained=False)
            reasons = [*fit.doubts, *doubts_of_tips(error, self._config.trust)]
            tips = apply(found[0].pose, instrument.tips(found[0].joints))
            if instrument.jaw_tips and outside_image(tips, self._views[0].camera).all():
                reasons.append("tip out of view: the jaw tips lie outside the image")
            if told.misfit > self._config.session.largest_misfit:
                off = told.misfit**0.5
                reasons.append(
                    f"disagrees with the recording: the image is {off:.1f} times the expected error from that"
                )
            return _Judged("doubtful" if reasons else "ok", reasons, error, fit.sigma, explained=not fit.doubts)

        return told, judge

    def _nothing(self, at: Posed, spread: Float64, seen: Seen) -> tuple[FitEvidence, _Judge]:
        """Return what an image tells that shows nothing."""
        self._before, self.score = None, np.inf
        lost = seen.problem is None or (seen.masks[seen.main] is not None and not seen.any_same)
        reason = EMPTY.format(source=seen.source) if seen.problem is None else seen.problem
        nothing = _Judged("lost" if lost else "doubtful", [reason], None, None, explained=False)
        return FitEvidence.of(None, at, spread, holds=False), lambda found: nothing


def has_moved(before: Posed, now: Posed) -> bool:
    """Whether an instrument has moved so far that its masks must differ."""
    change = np.abs(now.minus(before))
    parts = (change[:3], change[3:5], change[6:])
    return any(bool((part > most).any()) for part, most in zip(parts, _SEEN_MOTION, strict=True))
