"""Following by a calibration while images come: the last fifteen are the window that is solved.

The terms of an image are those of a recording on disk (`frame_fits`). The base and the offsets stay as they are.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

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
from dvrk_cmaes.pose.views import FrameView
from dvrk_cmaes.results.tracked import TrackResult, without_pose
from dvrk_cmaes.silhouette import Body
from dvrk_cmaes.track.colour_edges import EdgeFit
from dvrk_cmaes.track.frame_fits import fit_near, views_that_show
from dvrk_cmaes.track.reading_buffer import ReadingAt
from dvrk_cmaes.track.view_segmenter import Mask, Seen, ViewSegmenter
from dvrk_cmaes.track.window import FitEvidence, Found, Judged, Window, WindowImage


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

    ``explained`` is whether the pose of the last image explains its masks or edges. ``disagreeing`` and ``unexplained``
    are the numbers of images in a row up to it that disagree with the calibration, and that are not explained.
    ``seconds`` is the time from the first image to the last.
    """

    def __init__(
        self, given: Followed, calibration: SessionCalibration, lag: FoundLag | None, *, uncertain: bool = False
    ) -> None:
        self.calibration, self.lag = calibration, lag
        self.explained, self.disagreeing, self.unexplained, self.seconds = False, 0, 0, 0.0
        self._began = np.inf  # s, time of the first image
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
        """Whether so many images in a row disagree with the calibration that it does not hold any more."""
        return self.disagreeing >= MOST_DISAGREEING

    @property
    def explains_little(self) -> bool:
        """Whether the last masks are not explained, as where a calibration of few frames is wrong, or masks are bad."""
        return self.unexplained >= _DISAGREES

    @property
    def disagrees(self) -> bool:
        """Whether the last images disagree with the calibration."""
        return self.disagreeing >= _DISAGREES

    def _predicted(self, reading: ReadingAt, outer: Float64, time: float) -> Prediction:
        """Predict an image from its readings less the lag, with other readings of the outer joints (4,), rad and m."""
        self._ecm = self._ecm if reading.ecm is None else reading.ecm
        endoscope = endoscope_at(self.calibration, time, self._ecm)
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
        given = self._given
        self._began = min(self._began, time)
        self.seconds = time - self._began
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
        masks = given.segmenter.given(seen)
        before, self._deviation = self._deviation, None
        views, edges = self._views_of(seen, masks) if masks else (), None
        if views:
            evidence = self._by_masks(views, at, spread, before)
        else:
            edges = None if masks else self._edges_near(at, spread, before, seen)
            evidence = self._by_edges(edges, at, spread)
        image = WindowImage(time, predicted, 0, evidence)
        self._images.append(image)
        (found,) = self._window.solve(list(self._images), only_last=True)
        judged = self._judged(views, edges, found, evidence.misfit, seen)
        if judged.error is not None:
            self._count(judged, evidence.misfit, reading, in_view=not masks or shows_well(masks))
        else:
            self.explained = False
        if self.explained and time - self._learned >= _LEARNED_EVERY:
            self._learned = time
            given.segmenter.learn(seen, self._views, found[0])
        still = reading.still and judged.error is not None
        doubts = [
            *reasons(calibration_contradicted(self.disagreeing)),
            *judged.reasons,
            *reasons(readings_missing(reading.has_outer, still, seen.source)),
        ]
        return self._window.result(image, found, judged, doubts)

    def _count(self, judged: Judged, misfit: float, reading: ReadingAt, *, in_view: bool) -> None:
        """Count images that disagree; ``in_view`` is whether this one shows enough to contradict the calibration."""
        disagrees = judged.status == "lost" or misfit > self._given.config.session.largest_misfit
        read = reading.has_outer and not reading.still
        self.disagreeing = self.disagreeing + in_view if disagrees and read else 0
        self.explained = judged.explained and not disagrees
        self.unexplained = 0 if self.explained else self.unexplained + in_view

    def masks_of(self, seen: Seen) -> dict[str, Mask]:
        """Find masks in the last image, which has none, about the pose to which it was followed."""
        if self._deviation is None:
            return {}
        return self._given.segmenter.masks_at(seen, self._views, self._images[-1].at.moved(self._deviation))

    def _views_of(self, seen: Seen, masks: Mapping[str, Mask]) -> list[FrameView]:
        """Return the views whose masks show the instrument."""
        ignored = self._given.segmenter.ignored(seen)
        shown = self.calibration.corrected_views(seen_views(masks, self._given.rig, ignored))
        return views_that_show(shown, self._given.body)

    def _by_masks(self, views: Sequence[FrameView], at: Posed, spread: Float64, before: Float64 | None) -> FitEvidence:
        """Fit an image's masks, about what is expected of its pose; ``before`` (D,) is the deviation before."""
        config, expected = self._given.config, Expected.of(at, spread)
        fit, own = fit_near(views, config, expected, before, self.calibration.masks, self._lengths)
        if fit.explains_mask:
            self._deviation = fit.at.minus(at)
            self._lengths |= {view.name: length for view, length in zip(views, own.lengths, strict=True)}
        inflation = own.noises[0].inflation(self._window.camera.pixel_scale)
        return FitEvidence.of(fit, at, spread, inflation=inflation, holds=fit.explains_mask)

    def _edges_near(self, at: Posed, spread: Float64, before: Float64 | None, seen: Seen) -> EdgeFit | None:
        """Fit the edges that the colours of an image without masks show, as `_by_masks` does."""
        start = at if before is None else at.moved(before)
        return self._given.segmenter.fit(seen, start, Expected.of(at, spread), near=before is not None)

    def _by_edges(self, fit: EdgeFit | None, at: Posed, spread: Float64) -> FitEvidence:
        """Return what the fit to edges states, nothing where there is none."""
        if fit is None:
            return FitEvidence.of(None, at, spread)
        if fit.holds:
            self._deviation = fit.at.minus(at)
        moves = changes_by_masks(fit.at, self._views[0].camera, self._given.instrument)
        edges = fit.with_margin(_EDGES_PX * moves[:, 0])
        edges = replace(edges, by_masks=edges.information @ moves)
        return FitEvidence.of(edges, at, spread, inflation=_EDGES_ALIKE, holds=fit.holds)

    def _judged(
        self, views: Sequence[FrameView], fit: EdgeFit | None, found: Found, misfit: float, seen: Seen
    ) -> Judged:
        """Judge the pose of an image by how it explains the masks of ``views``, or by the fit to its edges."""
        given = self._given
        if views:
            return self._window.judged(views, found, misfit, given.body)
        if fit is None:
            lost = seen.problem is None or (seen.main.mask is not None and not seen.any_same)
            doubts = reasons(pose_lost(seen.source, None)) if seen.problem is None else [seen.problem]
            return Judged("lost" if lost else "doubtful", doubts, None)
        error = expected_error(given.instrument, *found)
        if not fit.holds:
            return Judged("lost", [f"lost: {'; '.join(fit.doubts)}"], error, fit.sigma)
        camera = self._views[0].camera
        doubts = fit.doubts + doubts_in_view("edges", found[0], given.instrument, camera, error, given.config.trust)
        doubts += doubts_of_agreement("edges", misfit, given.config.session)
        return Judged("doubtful" if doubts else "ok", doubts, error, fit.sigma, explained=not fit.doubts)


def has_moved(before: Posed, now: Posed) -> bool:
    """Whether an instrument has moved so far that its masks must differ."""
    change = np.abs(now.minus(before))
    parts = (change[:3], change[3:5], change[6:])
    return any(bool((part > most).any()) for part, most in zip(parts, _SEEN_MOTION, strict=True))
