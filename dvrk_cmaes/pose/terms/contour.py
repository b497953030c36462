"""The contour of rough masks as a term, whose errors are correlated: generalised least squares.

The contour errors of a segmentation can have a standard deviation of a pixel or more and a correlation length of about
twenty pixels. The errors of neighbouring points are then nearly equal: their mean carries little information, while
their differences, such as the position of a bend or the direction of an edge, carry much. Generalised least squares
(Aitken) weights both correctly: for errors e (N,) with covariance C (N, N), the sum of squares is e^T C^-1 e / f with
f = ``_INFLATION``. For points at a distance of d px, C = s^2 (0.95 exp(-pi (d / 21)^2) + 0.05 * 21 I), plus the
variance of the quantisation to pixels. The uncorrelated part represents errors that are not smooth; per px of outline
its variance is about that of the whole error. Points with errors above ``_CLIP`` standard deviations are outliers of
the segmentation and left out.

Which points count, and s, are found anew at each pose, so sums of squares at different poses are not to be compared:
this term is for steps that are not tested, from poses that are accurate to about a millimetre.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dvrk_cmaes import _kernel
from dvrk_cmaes.evidence.outline_noise import OutlineNoise
from dvrk_cmaes.evidence.quantiles import NORMAL_MEDIAN
from dvrk_cmaes.geometry import Float64, Posed
from dvrk_cmaes.pose.terms.sized_view import Derivatives, OutlineTerm, SizedView
from dvrk_cmaes.pose.terms.term import Quadratic

_LEAST_SIGMA = 0.6  # px; for more accurate contours the loss on the coverage gives smaller errors
_LARGEST_LENGTH = 25.0  # px; longer correlation is caused by errors of the instrument's shape
_LENGTH = 21.0  # px, correlation length
_CORRELATED = 0.95  # share of the variance
_LEAST_ERROR = 0.5  # px, least standard deviation by which outliers are detected
_CLIP = 2.5  # standard deviations
_REACH = 8  # px from the outline in which the mask's contour is searched
_LEAST_POINTS = 40  # outline points that need a contour point within reach for a view to count
_GRID = 1 / 12  # px^2, variance of the quantisation to pixels
_INFLATION = 2.0  # factor on the variances, because the errors of fits are larger than the covariance predicts
_FARTHEST = 40.0  # px, between points whose errors are correlated


def is_rough(noise: OutlineNoise) -> bool:
    """Return whether the errors of a mask's contour are a segmentation's, not those of the quantisation to pixels."""
    return noise.sigma > _LEAST_SIGMA


def has_correlated_noise(noise: OutlineNoise) -> bool:
    """Return whether the noise of a mask's contour is of the kind that `CorrelatedContour` models."""
    return is_rough(noise) and noise.length < _LARGEST_LENGTH


DrawnContour = tuple[Float64, Float64, float]
"""Information (D, D) and slope (D,) of half the sum of squares, and the sum; 0 with too little contour in reach."""


def contour_errors(reach: int) -> _kernel.ContourErrors:
    """Return how the errors of a contour are weighed that is searched up to ``reach`` px from the outline."""
    return _kernel.ContourErrors(
        reach=reach,
        least=_LEAST_POINTS,
        normal_median=NORMAL_MEDIAN,
        least_sigma=_LEAST_ERROR,
        clip=_CLIP,
        correlated=_CORRELATED,
        length=_LENGTH,
        farthest=_FARTHEST,
        grid=_GRID,
        inflation=_INFLATION,
    )


class CorrelatedContour(OutlineTerm[DrawnContour]):
    """Distances of the masks' contours from the outline, of the ``views`` at their whole size."""

    def __init__(self, views: Sequence[SizedView]) -> None:
        self.views = tuple(views)

    def draw(self, at: Posed, *, derivatives: Derivatives | None = "closed-form") -> list[DrawnContour]:
        """Draw C poses, and sum up the views; the derivatives are in closed form."""
        of_views = [view.contours(at, contour_errors(_REACH)) for view in self.views]
        information, slope, cost = (np.sum(parts, axis=0) for parts in zip(*of_views, strict=True))
        return list(zip(information, slope, cost.tolist(), strict=True))

    def cost_of(self, drawn: DrawnContour) -> float:
        """Return the sum of squares of what was drawn."""
        return drawn[2]

    def near(self, drawn: Sequence[DrawnContour], at: Posed) -> Quadratic:
        """Return the approximation of half the sum of squares near C poses."""
        return Quadratic(np.stack([one[0] for one in drawn]), np.stack([one[1] for one in drawn]))
