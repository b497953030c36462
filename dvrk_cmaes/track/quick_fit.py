"""A fit of one image to a prediction that is near, in few drawings, for following while images come.

Its terms are those of a recording's frames (`fit_followed`). What a step costs is bounded by the number of drawings: a
fit that has not converged then is finished by the images after it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.calibration.frame_fit import FrameFit, OwnEstimate, outline_and_masks, stepped
from dvrk_cmaes.calibration.lasting_errors import SINGLE_SIZE
from dvrk_cmaes.calibration.session_masks import SessionMasks, margins_of
from dvrk_cmaes.config import EstimateConfig, OutlineConfig
from dvrk_cmaes.frames.seen_view import SeenView
from dvrk_cmaes.geometry import Posed
from dvrk_cmaes.joints.prior import split_readings
from dvrk_cmaes.pose.refine.gauss_newton import Steps, refine
from dvrk_cmaes.pose.terms.coverage import Coverage
from dvrk_cmaes.pose.terms.expected import Expected
from dvrk_cmaes.pose.terms.frame_terms import terms_of_frame
from dvrk_cmaes.pose.terms.sized_view import SizedView
from dvrk_cmaes.pose.views import FrameView
from dvrk_cmaes.silhouette import Body
from dvrk_cmaes.track.recorded_frames import starts_of, views_that_show

Float64 = NDArray[np.float64]

LINES_PER_PIXEL: Final = 1
"""Lines of the image, for each row of pixels, by which silhouettes are drawn while a recording runs."""

_STRIDE: Final = 2  # of the outline's points from which the covariance is found
_FOLLOWED, _FOUND = 2, 6  # drawings of a fit from the image before, and of one from the prediction alone
_INNER = 4  # steps on what was drawn
_SETTLED = 1.0  # standard deviations per parameter, of a step from the image before, after which no other is taken
_LARGEST_CHANGE = 4.0  # standard deviations of a step


@dataclass(frozen=True, eq=False)
class QuickFit:
    """The fit of an image, its views, and the noises of their contours.

    ``inflation`` is the factor by which the contour's roughness widens the covariance.
    """

    views: tuple[FrameView, ...]
    fit: FrameFit
    lengths: tuple[float, ...]
    inflation: float


def quick_fit(
    body: Body,
    config: EstimateConfig,
    seen: Sequence[SeenView],
    expected: Expected,
    before: Float64 | None,
    lengths: Mapping[str, float],
    masks: SessionMasks | None,
) -> QuickFit | None:
    """Fit an image; None if its masks show nothing.

    ``before`` (D,) is the deviation of the image before from its prediction, None without one; ``lengths`` are the
    correlation lengths, px, of its contours by view. ``masks`` states the margin that is taken off each view's mask.
    """
    views = views_that_show(seen, body)
    if not views:
        return None
    outline = replace(config.refine.outline, lines_per_pixel=LINES_PER_PIXEL, cauchy=config.session.cauchy)
    margins = margins_of(masks, [view.name for view in views])
    sized = [SizedView(view, blur=outline.blur, margin=margin) for view, margin in zip(views, margins, strict=True)]
    coverage = Coverage(sized, outline, correlations=[lengths.get(view.name, outline.correlation) for view in views])
    limits = split_readings(body.instrument, {}, config)[0]
    terms = terms_of_frame(views, limits, outline, expected)
    at, steps = _starts(expected, before, outline)
    fit = min(refine(coverage, terms, at, steps), key=lambda each: each.score)
    (drawn,) = coverage.draw(Posed.stacked([fit.at]))
    silhouettes = [view.silhouette(image) for view, image in zip(sized, drawn, strict=True)]
    own = OwnEstimate.drawn_as(views, fit.at, silhouettes)
    told, by_masks = outline_and_masks(coverage, fit.at, own.noises, SINGLE_SIZE, drawn, stride=_STRIDE, as_seen=True)
    end, slope = stepped(fit.at, told, terms)
    found = FrameFit(end, told.information[0], slope, fit.score, coverage.silhouettes, own.iou, by_masks=by_masks)
    return QuickFit(tuple(views), found, own.lengths, own.noises[0].inflation)


def _starts(expected: Expected, before: Float64 | None, outline: OutlineConfig) -> tuple[Posed, Steps]:
    """Return where a fit starts, and its steps."""
    starts = starts_of(expected, before)
    if before is None:
        return Posed.stacked(starts), Steps(_FOUND, outline.inner_steps, outline.tolerance, "long")
    if len(starts) > 1:
        return Posed.stacked(starts), Steps(_FOLLOWED, _INNER, outline.tolerance, "long")
    return Posed.stacked(starts), Steps(_FOLLOWED, _INNER, _SETTLED, "none", _LARGEST_CHANGE)
