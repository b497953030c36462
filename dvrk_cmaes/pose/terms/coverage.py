"""The coverage of all views as a term: the differences between antialiased coverage and mask.

Both are slightly blurred, so that the differences are smooth functions of the pose. They have a robust Cauchy loss, so
that outliers of the segmentation have little influence. Moving the outline by e along its normal adds e to the coverage
there, so the loss after a small change of the pose is known from the residual beside the outline (see `profiles`).

The weight of the residuals relative to other terms is estimated from the residuals. Shifting a piece of outline of
length s by e changes the sum of squares of an edge blurred with sigma by s e^2 / (2 sqrt(pi) sigma), so the sum of
squares gives the variance of the outline's error; ``correlation`` px of outline are one independent measurement. The
masks of one frame come from one segmenter: the variance is one for all views. With a variance of its own, the view
that happens to fit best would have nearly all the weight.

The loss of the coverage as a function of small changes of a pose, from samples of the difference along the outline.

The difference of blurred coverage and blurred mask is sampled along the normal of each outline point. If the point
moves outwards by e px, the blurred coverage s px outside its present place becomes larger by e times the density of the
normal distribution at s whose standard deviation is that of the blur. The sum of the robust loss over all samples is
therefore a function of the change of the pose that needs no further silhouettes.

The contour of rough masks as a term, whose errors are correlated: generalised least squares.

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

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from dvrk_cmaes import _kernel
from dvrk_cmaes.config import OutlineConfig
from dvrk_cmaes.evidence.outline_noise import OutlineNoise
from dvrk_cmaes.evidence.quantiles import NORMAL_MEDIAN
from dvrk_cmaes.geometry import Float64, Posed
from dvrk_cmaes.pose.terms.shared_errors import SHOWN, deviations_of, sharing
from dvrk_cmaes.pose.terms.sized_view import REACH, Derivatives, OutlineTerm, SizedView
from dvrk_cmaes.pose.terms.term import Approximation, Quadratic
from dvrk_cmaes.silhouette import OutlinePoints

Columns = Callable[[int, OutlinePoints, Float64], Float64]
"""Displacements (N, E) of an outline's N points by E unknowns, times the lengths of their normals, px.

Arguments are the number of the view, its outline, and the displacements (N, D) by the pose.
"""


DrawnCoverage = tuple[_kernel.Comparison, ...]
"""What was drawn of a pose in each view."""


class Coverage(OutlineTerm[DrawnCoverage]):
    """The sum of the views' losses, each in proportion to its number of independent measurements a pixel of contour.

    Parameters
    ----------
    views
        The views at their sizes.
    config
        Width of the loss, blur and lines.
    correlations
        px of outline of each view that count as one independent measurement; ``config.correlation`` by default.
    cauchy
        Width of the loss that is made small, where it is not that of scores, ``config.cauchy``.
    noise
        The sum of squares from which the weight follows; by default that of each pose.
    """

    def __init__(
        self,
        views: Sequence[SizedView],
        config: OutlineConfig,
        *,
        correlations: Sequence[float] = (),
        cauchy: float | None = None,
        noise: float | None = None,
    ) -> None:
        self.views = tuple(views)
        self._config = config
        self._width = config.cauchy if cauchy is None else cauchy
        lengths = list(correlations) or [config.correlation] * len(views)
        pairs = list(zip(views, lengths, strict=True))
        self._count = sum(view.length / length * view.shrink for view, length in pairs)
        contour = sum(view.length for view in views)
        # as many measurements as if all contour were the first view's: the others count by their shares
        self._first_count = contour / lengths[0] * views[0].shrink
        self._shares = [lengths[0] / length * (view.shrink / views[0].shrink) for view, length in pairs]
        exact = [view.length * config.noise_floor**2 / (2 * np.sqrt(np.pi) * config.blur) for view in views]
        self._least = sum(exact)
        self._correlations = lengths
        self.noise = noise
        self._density = density(config.blur)
        self._widths = list(
            dict.fromkeys((config.cauchy, *([config.last_cauchy] if views[0].shrink == 1 else []), self._width))
        )
        self._place = self._widths.index(self._width)

    def changed(
        self,
        *,
        correlations: Sequence[float] = (),
        cauchy: float | None = None,
        noise: float | None = None,
    ) -> Coverage:
        """Return the same term with other arguments than it was made with."""
        return Coverage(
            self.views,
            self._config,
            correlations=correlations or self._correlations,
            cauchy=self._width if cauchy is None else cauchy,
            noise=self.noise if noise is None else noise,
        )

    def of_view(self, number: int) -> Coverage:
        """Return the term of one view alone, with the variance that is known of all."""
        view, contour = self.views[number], sum(one.length for one in self.views)
        alone = Coverage([view], self._config, correlations=[self._correlations[number]], cauchy=self._width)
        return alone if self.noise is None else alone.changed(noise=self.noise * view.length / contour)

    def noise_at(self, at: Posed) -> float:
        """Return the sum of squares at one pose, with the width of scores."""
        return sum(self._losses(self.draw(Posed.stacked([at]), derivatives=None)[0], final=True))

    def draw(self, at: Posed, *, derivatives: Derivatives | None = "closed-form") -> list[DrawnCoverage]:
        """Draw C poses in all views."""
        lines = self._config.lines_per_pixel
        of_views = [view.draw(at, lines, self._widths, derivatives) for view in self.views]
        return list(zip(*of_views, strict=True))

    def _losses(self, drawn: DrawnCoverage, *, final: bool = False) -> list[float]:
        """Return the views' sums of squares of what was drawn, with the width of the refinement or that of scores."""
        return [one.losses[0 if final else self._place] for one in drawn]

    def _sum(self, losses: Sequence[float]) -> float:
        """Return the sum of the views' losses, each with its number of measurements a pixel, beside the first one's."""
        return sum(share * loss for share, loss in zip(self._shares, losses, strict=True))

    def cost_of(self, drawn: DrawnCoverage) -> float:
        """Return the sum of squares of what was drawn."""
        return self._sum(self._losses(drawn))

    def weight_of(self, drawn: DrawnCoverage) -> float:
        """Return the factor to sums of squares in standard deviations, from what was drawn or from the given noise."""
        return self._weight(self._losses(drawn))

    def _weight(self, losses: Sequence[float]) -> float:
        noise = sum(losses) if self.noise is None else self.noise
        return float(self._first_count / max(noise, self._least))

    def score_of(self, drawn: DrawnCoverage, *, final: bool = False) -> float:
        """Return the negative log-likelihood up to a constant; with the variance estimated if no noise is given."""
        losses = self._losses(drawn, final=final)
        if self.noise is not None:
            return 0.5 * self._weight(losses) * self._sum(losses)
        return 0.5 * self._count * float(np.log(max(sum(losses), self._least)))

    def near(self, drawn: Sequence[DrawnCoverage], at: Posed) -> Profiles:
        """Return the loss near C poses, as a function of their small changes."""
        compared = [one for of_pose in drawn for one in of_pose]
        return Profiles(compared, self._shares, self._density, self._width)

    def near_with_sides(
        self,
        at: Posed,
        noises: Sequence[OutlineNoise],
        kept: Columns | None = None,
        drawn: DrawnCoverage | None = None,
        *,
        stride: int = 1,
        as_seen: bool = False,
    ) -> Quadratic:
        """Return the approximation near one pose, with most of what the errors of the masks share eliminated.

        The last unknowns, `SIDES` of each view, are the errors of the shaft's sides as a whole, in their standard
        deviations; they have no prior. ``noises`` are those of the views' contours. ``kept``
        gives E further unknowns, if any, kept with the pose: (1, D + E + V * SIDES), in standard deviations.
        ``drawn`` is the pose where it was drawn before, with derivatives. Only every ``stride``-th point of the
        outlines is used, which stands for those beside it. ``as_seen`` is whether errors are expected to be as large as
        the mask shows them at the pose, where that is more than usual (`shared_errors`).
        """
        if drawn is None:
            (drawn,) = self.draw(Posed.stacked([at]))
        more, offsets = [], []
        for k, (view, one) in enumerate(zip(self.views, drawn, strict=True)):
            if kept is None and not as_seen:
                break
            outline = OutlinePoints(one.link, one.pixels, one.normals, one.points).every(stride)
            if as_seen:
                offsets.append(view.offsets(outline))
            if kept is not None:
                length = np.linalg.norm(outline.normals, axis=1)[:, None]
                more.append(np.ascontiguousarray(kept(k, outline, one.jacobian[::stride] * length) / length))
        weight = self.weight_of(drawn)
        return Quadratic(
            *_kernel.shared_equations(
                list(drawn),
                [weight * share for share in self._shares],
                self._density,
                self._width,
                stride,
                [view.axis(at).tolist() for view in self.views],
                [deviations_of(noise) for noise in noises],
                sharing(self.views[0].renderer.body.instrument),
                more,
                offsets,
                SHOWN,
                len(self.views),
            )
        )


def of_margin(outline: OutlinePoints) -> Float64:
    """Return the displacements (N,) of an outline's points by a margin of the mask, px, times the normals' lengths."""
    return np.asarray(np.linalg.norm(outline.normals, axis=1))


def density(blur: float) -> list[float]:
    """Return the change of each sample by a displacement of the outline, 1/px, for a blur, px."""
    away = np.arange(-REACH, REACH + 1) / (np.sqrt(2) * blur)
    return [float(value) for value in np.exp(-away * away) / (np.sqrt(2 * np.pi) * blur)]


@dataclass(frozen=True, eq=False)
class Profiles(Approximation):
    """The samples of C poses in V views: those of the views of the first pose, drawn with outlines, come first.

    factors : (V,) of the views' losses. density : as `density`. cauchy : width of the robust loss.
    """

    compared: Sequence[_kernel.Comparison]
    factors: Sequence[float]
    density: Sequence[float]
    cauchy: float

    def normal_equations(self, change: Float64) -> tuple[Float64, Float64]:
        """Compute information (C, D, D) and slope (C, D) of the robust loss at changes (C, D) of the poses.

        They are in sums of squares of coverage, with the weights of the Cauchy loss at the changed poses.
        """
        return _kernel.normal_equations(self.compared, self.factors, self.density, self.cauchy, change)


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
