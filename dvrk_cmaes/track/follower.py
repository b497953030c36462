"""Following by a calibration while images come: the last fifteen are the window that is solved.

The terms of an image are those of a recording on disk (`frame_fits`). The base and the offsets stay as they are.
"""

from __future__ import annotations

import time as clock
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from dvrk_cmaes.calibration.document import SessionCalibration
from dvrk_cmaes.calibration.prediction import WRIST_ERROR, FoundLag, Prediction, endoscope_at
from dvrk_cmaes.calibration.session_masks import changes_by_masks
from dvrk_cmaes.camera import Rig
from dvrk_cmaes.config import EstimateConfig
from dvrk_cmaes.frames.seen_view import seen_views
from dvrk_cmaes.geometry import Float64, Posed
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
from dvrk_cmaes.pose.expected_error import expected_error
from dvrk_cmaes.pose.judge import doubts_in_view, doubts_of_agreement
from dvrk_cmaes.pose.terms.expected import Expected
from dvrk_cmaes.results.tracked import TrackResult, without_pose
from dvrk_cmaes.silhouette import Body
from dvrk_cmaes.track.frame_fits import Found, fit_near, judged, views_that_show
from dvrk_cmaes.track.reading_buffer import ReadingAt
from dvrk_cmaes.track.view_segmenter import Mask, Seen, ViewSegmenter
from dvrk_cmaes.track.window import FitEvidence, Judged, Window, WindowImage


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
_EDGES_PX = 0.7  # standard deviation of the margin that the colours' edges of all images of a window share
_EDGES_ALIKE = 2.0  # factor by which edges of images near each other err more alike than masks do
_LEARNED_EVERY = 0.2  # s
_DISAGREES = 4  # images in a row that disagree, from which on the keyframes are solved again


@dataclass(frozen=True, eq=False)
class _FitOfImage:
    """What the fit of an image states, ``score`` and ``deviation`` as in `LastImage`, and how its pose is judged."""

    evidence: FitEvidence
    score: float
    deviation: Float64 | None
    judge: Callable[[Found], Judged]


@dataclass(frozen=True, eq=False)
class LastImage:
    """What the last image that was followed to leaves behind.

    ``masks`` are its masks by name of the view, given or found in it. ``score`` is the negative log-likelihood of its
    fit, ``misfit`` the squared misfit per parameter, and ``explained`` whether its pose explains the masks.
    ``deviation`` (D,) is that of the fit from what was expected, None where it does not hold. ``disagreeing`` and
    ``unexplained`` are the numbers of images in a row up to it that disagree with the calibration, and that are not
    explained.
    """

    masks: Mapping[str, Mask] = field(default_factory=dict)
    score: float = 0.0
    misfit: float = 0.0
    explained: bool = False
    deviation: Float64 | None = None
    disagreeing: int = 0
    unexplained: int = 0


class Follower:
    """Follows an instrument by a calibration.

    Parameters
    ----------
    given
        What is followed.
    calibration
        Its base, offsets and spreads; its lag is taken out of the readings before they are given.
    lag
        That lag; None if nothing tells it.
    uncertain
        Whether the calibration is of so few frames that images are to correct what it predicts: its errors then count
        as deviations that change slowly, and not as ones that all images share.

    ``last`` is what the last image leaves behind.
    """

    def __init__(
        self, given: Followed, calibration: SessionCalibration, lag: FoundLag | None, *, uncertain: bool = False
    ) -> None:
        self.calibration, self.lag, self.last = calibration, lag, LastImage()
        self._given, self._uncertain = given, uncertain
        self._views = calibration.corrected_views(given.rig.views)
        self._window = Window(calibration, given.rig.views[0].camera, given.instrument, given.config)
        self._images: deque[WindowImage] = deque(maxlen=_WINDOW)
        self._lengths: dict[str, float] = {}  # px, correlation lengths of the contours' errors, by view
        self._read: tuple[Float64 | None, Float64 | None] = (None, None)  # by the outer joints and the endoscope's arm
        self._still: Posed | None = None  # where the last image that differs from the one before was expected
        self._learned = -np.inf  # s, when the colours were learned last

    @property
    def has_readings(self) -> bool:
        """Whether the outer joints have been read at an image so far."""
        return self._read[0] is not None

    @property
    def late(self) -> float:
        """The lag that is taken out of the readings, s."""
        return 0.0 if self.lag is None else self.lag.seconds

    @property
    def contradicted(self) -> bool:
        """Whether so many images in a row disagree with the calibration that it does not hold any more."""
        return self.last.disagreeing >= MOST_DISAGREEING

    @property
    def explains_little(self) -> bool:
        """Whether the last masks are not explained, as where a calibration of few frames is wrong, or masks are bad."""
        return self.last.unexplained >= _DISAGREES

    @property
    def disagrees(self) -> bool:
        """Whether the last images disagree with the calibration."""
        return self.last.disagreeing >= _DISAGREES

    @property
    def begun(self) -> bool:
        """Whether an image has been followed to."""
        return bool(self._images)

    def start_from(self, at: Posed, reading: ReadingAt) -> None:
        """Let the fit of the next image start from the pose and joints of one before it, with that one's readings."""
        if reading.has_outer:
            self.last = LastImage(deviation=at.minus(self._predicted(reading, reading.outer, None).at[0]))

    def _predicted(self, reading: ReadingAt, outer: Float64, time: float | None) -> Prediction:
        """Predict an image from its readings less the lag, with other readings of the outer joints (4,), rad and m."""
        ecm = self._read[1] if reading.ecm is None else reading.ecm
        self._read = self._read[0], ecm
        endoscope = endoscope_at(self.calibration, time, ecm)
        lag_std = self._given.config.track.lag_std if self.lag is None else self.lag.std
        predicted = Prediction.of(
            self.calibration,
            outer[None],
            reading.joints[None],
            self._given.instrument.joint_names,
            told=np.array([reading.has_outer and (endoscope is None) == (self.calibration.endoscope is None)]),
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
        shows_well: Callable[[Mapping[str, Mask]], bool] = lambda masks: True,
    ) -> TrackResult:
        """Fit the image of a later time, s, whose readings, less the lag, are ``reading``.

        An image whose masks, by view, do not show the instrument well does not tell against the calibration.
        """
        started, given = clock.perf_counter(), self._given
        if reading.has_outer:
            self._read = reading.outer, self._read[1]
        outer, _ = self._read
        if outer is None:
            return without_pose(time, NO_OUTER_READINGS)
        predicted = self._predicted(reading, outer, time)
        at, spread = predicted.at[0], predicted.spread[0]
        if not seen.any_same or self._still is None:
            self._still = at
        elif reading.has_outer and has_moved(self._still, at):
            seen = seen.without_frozen()
        masks = given.segmenter.given(seen)
        fit = self._by_masks(at, spread, seen, masks) if masks else self._by_edges(at, spread, seen)
        image = WindowImage(time, predicted, 0, fit.evidence)
        self._images.append(image)
        (found,) = self._window.solve(list(self._images), only_last=True)
        judged = fit.judge(found)
        self._remember(masks, fit, judged, reading, in_view=not masks or shows_well(masks))
        if self.last.explained and time - self._learned >= _LEARNED_EVERY:
            self._learned = time
            given.segmenter.learn(seen, self._views, found[0])
        still = reading.still and judged.error is not None
        doubts = [
            *reasons(calibration_contradicted(self.last.disagreeing)),
            *judged.reasons,
            *reasons(readings_missing(reading.has_outer, still, seen.source)),
        ]
        return self._window.result(image, found, judged, doubts, seconds=clock.perf_counter() - started)

    def _remember(
        self, masks: Mapping[str, Mask], fit: _FitOfImage, judged: Judged, reading: ReadingAt, *, in_view: bool
    ) -> None:
        """Keep what the image leaves behind; ``in_view`` is whether it shows enough to contradict the calibration."""
        misfit, last = fit.evidence.misfit, self.last
        disagreeing, unexplained, explained = last.disagreeing, last.unexplained, False
        if judged.error is not None:
            disagrees = judged.status == "lost" or misfit > self._given.config.session.largest_misfit
            read = reading.has_outer and not reading.still
            disagreeing = disagreeing + in_view if disagrees and read else 0
            explained = judged.explained and not disagrees
            unexplained = 0 if explained else unexplained + in_view
        self.last = LastImage(masks, fit.score, misfit, explained, fit.deviation, disagreeing, unexplained)

    def masks_of(self, seen: Seen) -> dict[str, Mask]:
        """Find masks in the last image, which has none, about the pose to which it was followed."""
        if self.last.deviation is None:
            return {}
        return self._given.segmenter.masks_at(seen, self._views, self._images[-1].at.moved(self.last.deviation))

    def _by_masks(self, at: Posed, spread: Float64, seen: Seen, masks: Mapping[str, Mask]) -> _FitOfImage:
        """Fit an image's masks, about what is expected of its pose."""
        given, before = self._given, self.last.deviation
        shown = self.calibration.corrected_views(seen_views(masks, given.rig, given.segmenter.ignored(seen)))
        views = views_that_show(shown, given.body)
        if not views:
            return _nothing(at, spread, seen)
        expected = Expected.of(at, spread)
        fit, own = fit_near(views, given.config, expected, before, self.calibration.masks, self._lengths)
        inflation = own.noises[0].inflation(self._window.camera.pixel_scale)
        evidence = FitEvidence.of(fit, at, spread, inflation=inflation, holds=fit.explains_mask)
        if fit.explains_mask:
            self._lengths |= {view.name: length for view, length in zip(views, own.lengths, strict=True)}

        def judge(found: Found) -> Judged:
            return self._window.judged(judged(views, *found, given.body, given.config), evidence.misfit)

        return _FitOfImage(evidence, fit.score, fit.at.minus(at) if fit.explains_mask else None, judge)

    def _by_edges(self, at: Posed, spread: Float64, seen: Seen) -> _FitOfImage:
        """Fit the edges that the colours of an image without masks show, as `_by_masks` does."""
        given, before = self._given, self.last.deviation
        expected = Expected.of(at, spread)
        start = at if before is None else at.moved(before)
        fit = given.segmenter.fit(seen, start, expected, near=before is not None)
        if fit is None:
            return _nothing(at, spread, seen)
        camera, instrument = self._views[0].camera, given.instrument
        moves = changes_by_masks(fit.at, camera, instrument)
        edges = fit.with_margin(_EDGES_PX * moves[:, 0])
        edges = replace(edges, by_masks=edges.information @ moves)
        evidence = FitEvidence.of(edges, at, spread, inflation=_EDGES_ALIKE, holds=fit.holds)

        def judge(found: Found) -> Judged:
            error = expected_error(instrument, *found)
            if not fit.holds:
                return Judged("lost", [f"lost: {'; '.join(fit.doubts)}"], error, fit.sigma)
            doubts = fit.doubts + doubts_in_view("edges", found[0], instrument, camera, error, given.config.trust)
            doubts += doubts_of_agreement("edges", evidence.misfit, given.config.session)
            return Judged("doubtful" if doubts else "ok", doubts, error, fit.sigma, explained=not fit.doubts)

        return _FitOfImage(evidence, fit.score, fit.at.minus(at) if fit.holds else None, judge)


def _nothing(at: Posed, spread: Float64, seen: Seen) -> _FitOfImage:
    """Return what an image tells that shows nothing."""
    lost = seen.problem is None or (seen.masks[seen.main] is not None and not seen.any_same)
    doubts = reasons(pose_lost(seen.source, None)) if seen.problem is None else [seen.problem]
    nothing = Judged("lost" if lost else "doubtful", doubts, None)
    return _FitOfImage(FitEvidence.of(None, at, spread, holds=False), np.inf, None, lambda found: nothing)


def has_moved(before: Posed, now: Posed) -> bool:
    """Whether an instrument has moved so far that its masks must differ."""
    change = np.abs(now.minus(before))
    parts = (change[:3], change[3:5], change[6:])
    return any(bool((part > most).any()) for part, most in zip(parts, _SEEN_MOTION, strict=True))
