"""Tasks on the frames of a recording that is followed with its own calibration, which can run in any process.

A frame is fitted with the prediction of the calibration as its prior, which gives the outline's terms about the fit.
Its pose, once smoothed over the recording, is judged by the rules of `estimate --session`.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from dvrk_cmaes.calibration.frame_fit import (
    FOLLOWED,
    FROM_PREDICTION,
    FROM_TWO_STARTS,
    WHILE_RUNNING,
    FrameFit,
    OwnEstimate,
    fit_frame,
)
from dvrk_cmaes.calibration.session_masks import SessionMasks, margins_of
from dvrk_cmaes.calibration.stored_frame import StoredFrame
from dvrk_cmaes.config import EstimateConfig
from dvrk_cmaes.evidence.gather import gather_evidence
from dvrk_cmaes.evidence.quantiles import NORMAL_MEDIAN
from dvrk_cmaes.frames.frame import FrameData
from dvrk_cmaes.frames.seen_view import SeenView, shown_views
from dvrk_cmaes.geometry import Float64, Posed
from dvrk_cmaes.pose.expected_error import expected_error
from dvrk_cmaes.pose.judge import doubts_in_views
from dvrk_cmaes.pose.quality import measure_overlap, pooled_quality
from dvrk_cmaes.pose.terms.expected import Expected
from dvrk_cmaes.pose.views import FrameView
from dvrk_cmaes.results.result import ExpectedError, Quality
from dvrk_cmaes.silhouette import Body, Renderer

_LEAST_SHOWN = 40  # px of mask, from which on a frame is fitted
_ANOTHER_START = 1.0  # standard deviations per parameter between two starts that are both tried


@dataclass(frozen=True, eq=False)
class PredictedFrame:
    """A frame, the function that reads its data, and what the calibration expects of it."""

    name: str
    read: Callable[[], FrameData | None]
    expected: Expected


@dataclass(frozen=True, eq=False)
class FittedFrame:
    """The fit of a frame, its evidence, and the time that it took, s.

    ``doubts`` are reasons to doubt the masks that were found in its images.
    """

    stored: StoredFrame
    fit: FrameFit
    seconds: float
    doubts: tuple[str, ...] = ()


def views_that_show(seen: Sequence[SeenView], body: Body) -> list[FrameView]:
    """Return the views whose masks show the instrument, with evidence and renderer; none where they show too little."""
    shown = shown_views(seen)
    if max((int(np.count_nonzero(view.mask)) for view in shown), default=0) < _LEAST_SHOWN:
        return []
    views = []
    for view in shown:
        evidence = gather_evidence(view.mask, view.camera, body.instrument, ignore=view.ignore, features=False)
        views.append(FrameView(view.name, evidence, Renderer(body, evidence.camera, threads=1), view.view_from_camera))
    return views


def fit_near(
    views: Sequence[FrameView],
    config: EstimateConfig,
    expected: Expected,
    before: Float64 | None,
    masks: SessionMasks | None,
    lengths: Mapping[str, float] | None = None,
) -> tuple[FrameFit, OwnEstimate]:
    """Fit a frame near what is expected of it; returns the fit, and what its outlines are measured by.

    Parameters
    ----------
    views, config, expected
        As in `fit_frame`.
    before : (D,)
        Deviation of the frame before from its prediction; None without one.
    masks
        States the margin that is taken off each view's mask.
    lengths
        Correlation lengths, px, of the contours of images before, by view. They are given while images come: the fit is
        then found in few drawings.
    """
    starts, names = [expected.mean], [view.name for view in views]
    if before is not None:
        apart = float(np.sqrt(before @ expected.information @ before / len(before)))
        starts = [expected.mean.moved(before), *(starts if apart > _ANOTHER_START else ())]
    margins, preset = margins_of(masks, names), FOLLOWED
    if lengths is None:
        return fit_frame(views, config, expected, starts, margins=margins, preset=preset)
    preset = FROM_PREDICTION if before is None else WHILE_RUNNING if len(starts) == 1 else FROM_TWO_STARTS
    of_views = [lengths.get(name, config.refine.outline.correlation) for name in names]
    return fit_frame(views, config, expected, starts, margins=margins, lengths=of_views, preset=preset)


def fit_followed(
    body: Body, config: EstimateConfig, frame: PredictedFrame, before: Float64 | None, masks: SessionMasks | None
) -> FittedFrame | None:
    """Read and fit a frame of a recording, as `fit_near`; None if its masks show nothing."""
    started = time.perf_counter()
    data = frame.read()
    views = [] if data is None else views_that_show(data.views, body)
    if data is None or not views:
        return None
    fit, own = fit_near(views, config, frame.expected, before, masks)
    return FittedFrame(StoredFrame.of_views(views, data.camera, own), fit, time.perf_counter() - started)


@dataclass(frozen=True, eq=False)
class JudgedFrame:
    """The quality of a frame's pose, the reasons to doubt it, and the error that is expected of it."""

    quality: Quality
    reasons: tuple[str, ...]
    error: ExpectedError

    @property
    def residual_px(self) -> float:
        """Standard deviation, px, of the contour's distances from the outline, by their median."""
        return NORMAL_MEDIAN * self.quality.contour_px_median


def judge_frame(body: Body, config: EstimateConfig, task: tuple[StoredFrame, tuple[Posed, Float64]]) -> JudgedFrame:
    """Judge a frame, given its evidence, by its pose and the covariance (D, D) of that, as `judged` does."""
    stored, found = task
    return judged([view.restored(body) for view in stored.views], *found, body, config)


def judged(
    views: Sequence[FrameView], at: Posed, covariance: Float64, body: Body, config: EstimateConfig
) -> JudgedFrame:
    """Measure how a pose with a covariance (D, D) explains the views' masks, and list the reasons to doubt it."""
    qualities = [measure_overlap(view, at) for view in views]
    error = expected_error(body.instrument, at, covariance)
    doubts, _ = doubts_in_views(at, views, qualities, error, config.trust, "followed")
    return JudgedFrame(pooled_quality(qualities), tuple(doubts), error)
