"""Fit of one frame's pose and joints to its outline, with the prediction of its session as a prior."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from dvrk_cmaes.calibration.lasting_errors import SINGLE_SIZE, USUAL_SIZE, LastingSize, without_lasting
from dvrk_cmaes.camera import Camera
from dvrk_cmaes.config import EstimateConfig
from dvrk_cmaes.evidence.outline_noise import OutlineNoise, measure_noise
from dvrk_cmaes.geometry import Bool, Float64, Posed
from dvrk_cmaes.joints.prior import Readings
from dvrk_cmaes.pose.refine.gauss_newton import Fit, Steps, refine
from dvrk_cmaes.pose.refine.selection import Selection
from dvrk_cmaes.pose.terms.coverage import Coverage, DrawnCoverage
from dvrk_cmaes.pose.terms.expected import Expected
from dvrk_cmaes.pose.terms.frame_terms import terms_of_frame
from dvrk_cmaes.pose.terms.shared_errors import LASTING, side_deviation
from dvrk_cmaes.pose.terms.sized_view import SizedView
from dvrk_cmaes.pose.terms.term import Quadratic, Term, sum_of_costs, sum_of_locals
from dvrk_cmaes.pose.views import FrameView, overlap
from dvrk_cmaes.silhouette import OutlinePoints

_KEPT = 2  # fits at half the image size that are continued at the whole size
_LEAST_OVERLAP = 0.5  # intersection over union below which a fit is not used
_LARGEST_STEP = 3e-3  # m, by which a fit moves where the errors that masks share are eliminated
_OVERLAP_LOSS = 0.1  # by which the fit's intersection over union may fall below that of the frame's own estimate


@dataclass(frozen=True, eq=False)
class OwnEstimate:
    """A frame's pose, to which no session has contributed.

    ``noises`` are those of the contours there, one of each view; ``iou`` is the intersection over union of its
    silhouettes and the masks. ``residual`` is the robust sum of squares of the residuals of coverage there at the whole
    image size, from which the outlines' error is estimated; None where it is not measured.
    """

    at: Posed
    noises: tuple[OutlineNoise, ...]
    iou: float
    residual: float | None = None

    @property
    def lengths(self) -> tuple[float, ...]:
        """Correlation lengths of the contours' errors, px, one of each view."""
        return tuple(noise.length for noise in self.noises)

    def of_view(self, number: int) -> OwnEstimate:
        """Return the same pose with the noise of one view alone; the residual is that of the only view, if it is."""
        alone = len(self.noises) == 1
        return replace(self, noises=(self.noises[number],), residual=self.residual if alone else None)

    @classmethod
    def of(cls, views: Sequence[FrameView], at: Posed) -> OwnEstimate:
        """Measure an estimate in the views that show the instrument."""
        return cls.drawn_as(views, at, [view.silhouette(at) for view in views])

    @classmethod
    def drawn_as(cls, views: Sequence[FrameView], at: Posed, drawn: Sequence[Bool]) -> OwnEstimate:
        """Measure an estimate whose silhouettes (H, W) in the views have been drawn."""
        noises = [measure_noise(view.evidence.contour, seen) for view, seen in zip(views, drawn, strict=True)]
        return cls(at, tuple(noises), overlap(views, drawn))


@dataclass(frozen=True, eq=False)
class FrameFit:
    """A frame's pose, fitted with the session's prior.

    ``information`` (D, D), D = 6 + J, is the Gauss-Newton matrix of the outline alone at the fit, and ``slope`` (D,)
    the gradient of half its sum of squares. ``score`` is the negative log-likelihood of the fit, ``evaluations`` the
    number of silhouettes that were rendered. ``iou`` is the intersection over union of the fit's silhouette and the
    mask; ``own_iou`` is that of the frame's own estimate, 0 if not given. ``lasting`` are the same terms of the outline
    as functions of S further unknowns, (1, D + S): the errors of the masks that last from frame to frame, in their
    usual standard deviations, of which the first view's is ``side_px``. These errors are eliminated from the others.
    ``side_offsets`` (2,), px, are by how much the first view's mask lies outwards of both sides of the shaft; None
    where that is not measured. ``by_masks`` (D, 7) is the change of ``information`` times what the outline tells of the
    pose, per px of the mean errors of all masks (`mean_errors`); None where that is not measured.
    """

    at: Posed
    information: Float64
    slope: Float64
    score: float
    evaluations: int = 0
    iou: float = 1.0
    own_iou: float = 0.0
    lasting: Quadratic | None = None
    side_px: float = 0.0
    side_offsets: Float64 | None = None
    by_masks: Float64 | None = None

    @property
    def whole_outline(self) -> Quadratic:
        """The outline's terms with the errors that last, (1, D + S)."""
        alone = Quadratic(self.information[None], self.slope[None])
        return alone if self.lasting is None else self.lasting

    def with_size(self, size: LastingSize) -> FrameFit:
        """Return the fit with errors that last of another size."""
        if self.lasting is None:
            return self
        left = without_lasting(self.lasting, self.lasting.dimension - len(self.slope), size)
        return replace(self, information=left.information[0], slope=left.slope[0])

    @property
    def explains_mask(self) -> bool:
        """Whether the fit overlaps the mask about as well as the frame's own estimate."""
        return self.iou > max(self.own_iou - _OVERLAP_LOSS, _LEAST_OVERLAP)

    def describe_overlap(self) -> str:
        """Say how much less of the mask the fit overlaps than the frame's own estimate, which explains it."""
        return f"what it expects does not explain the mask (IoU {self.iou:.2f}, by itself {self.own_iou:.2f})"

    def step_to(self, expected: Expected) -> float:
        """Return how far the fit would move with another prior, in standard deviations per parameter.

        The outline's terms are taken as quadratic.
        """
        step, slope = self._step(expected)
        return float(np.sqrt(max(-float(step @ slope), 0.0) / len(step)))

    def moved_to(self, expected: Expected) -> FrameFit:
        """Return the fit where it would be with another prior, as in `step_to`, with the outline's slope there."""
        step = self._step(expected)[0]
        lasting = None if self.lasting is None else _after(self.lasting, step)
        return replace(self, at=self.at.moved(step), slope=self.slope + self.information @ step, lasting=lasting)

    def _step(self, expected: Expected) -> tuple[Float64, Float64]:
        """Return the change (D,) of the fit with another prior, and the slope (D,) there, whose minimum it is."""
        information = self.information + expected.information
        slope = self.slope + expected.information @ self.at.minus(expected.mean)
        return -np.asarray(np.linalg.solve(information, slope), dtype=np.float64), slope

    def without_outline(self) -> FrameFit:
        """Return the fit with zero information and slope, so that it does not influence the calibration."""
        nothing = None if self.lasting is None else Quadratic.zero(1, self.lasting.dimension)
        return replace(
            self, information=np.zeros_like(self.information), slope=np.zeros_like(self.slope), lasting=nothing
        )


@dataclass(frozen=True)
class FitPreset:
    """How a frame is fitted.

    ``steps`` are those from the better start, after which the noise of the outlines is measured; None to fit from all
    starts and from coarse to fine, with the noise at the frame's own estimate. ``confirmed`` tells then whether the
    last step, shorter than the tolerance, is drawn and undone if it raises the loss. ``size`` is that of the errors
    that last from frame to frame.
    """

    steps: Steps | None = None
    confirmed: bool = False
    size: LastingSize = USUAL_SIZE


IN_SESSION = FitPreset()
"""Fit of a frame of a session that is solved, which is fitted again in the next round."""

OF_NEW_FRAME = FitPreset(confirmed=True)
"""Fit of a single frame of a calibrated session."""

FOLLOWED = FitPreset(Steps(12, inner=3, tested="none", largest=4.0), size=SINGLE_SIZE)
"""Fit of an image that follows others, near the prediction: two or three steps are enough there, more are far off."""


def fit_frame(
    views: Sequence[FrameView],
    readings: Readings,
    config: EstimateConfig,
    expected: Expected,
    starts: Sequence[Posed],
    own_estimate: OwnEstimate | None,
    own_cameras: Sequence[Camera] | None = None,
    *,
    margins: Sequence[float] = (),
    preset: FitPreset = IN_SESSION,
) -> tuple[FrameFit, OwnEstimate]:
    """Fit a frame from several starts; returns the fit with the best score, and what its outlines are measured by.

    Parameters
    ----------
    views
        The views that show the instrument, with the frame's evidence and renderers at full detail.
    readings
        The instrument's joints; only their limits are used, since ``expected`` contains the readings.
    config
        All settings.
    expected
        The session's prediction, which is the prior.
    starts
        Starting poses, at least one.
    own_estimate
        The frame's estimate without the session. The noise of the outlines is measured from its residuals, to which
        the session's prior has not contributed. If None, the noise is estimated during the fit, and measured at its
        end.
    own_cameras
        The views' cameras of ``own_estimate``, for images of the same size, where they are not those of the views.
    margins
        Margin of each view's mask, px, that is taken off it all round; none by default.
    preset
        How the fit is found.
    """
    terms = terms_of_frame(views, _limits(readings), config.refine.outline, expected)
    at, count = Posed.stacked(starts), 0
    if preset.steps is not None:
        coverage = _coverage(views, config, None, 1, margins)
        steps = replace(preset.steps, tolerance=config.refine.outline.tolerance)
        (fit,) = refine(coverage, terms, Posed.stacked([_better_start(coverage, terms, starts)]), steps)
        own = OwnEstimate.of(views, fit.at)
        coverage = coverage.with_lengths(own.lengths)
        coverage = coverage.with_noise(coverage.noise_at(own.at))
        fit = replace(fit, drawn=coverage.draw(Posed.stacked([fit.at]))[0], drawn_at=fit.at)
        count = coverage.silhouettes + len(views)
        return _without_shared(fit, coverage, terms, own, own.iou, count, preset, config), own
    selection = Selection(config.refine.small_share, config.refine.small_gap, least=_KEPT)
    for shrink in (2, 1) if len(starts) > 1 and views[0].evidence.camera.width >= 320 else (1,):
        coverage = _coverage(views, config, own_estimate, shrink, margins)
        if own_estimate is not None:
            noise = own_estimate.residual if shrink == 1 else None
            coverage = coverage.with_noise(_noise(coverage, own_estimate, own_cameras) if noise is None else noise)
        steps = replace(Steps.of(config.refine.outline, shrink), tested="all" if preset.confirmed else "long")
        fits = sorted(refine(coverage, terms, at, steps, selection), key=lambda fit: fit.score)[:_KEPT]
        at, count = Posed.stacked([fit.at for fit in fits]), count + coverage.silhouettes
    drawn = [view.silhouette(fits[0].at) for view in views]
    own = own_estimate or OwnEstimate.drawn_as(views, fits[0].at, drawn)
    return _without_shared(fits[0], coverage, terms, own, overlap(views, drawn), count, preset, config), own


def _better_start(coverage: Coverage, terms: Sequence[Term], starts: Sequence[Posed]) -> Posed:
    """Return the start with the best score, or the only one."""
    if len(starts) == 1:
        return starts[0]
    at = Posed.stacked(starts)
    drawn, others = coverage.draw(at, derivatives=False), sum_of_costs(terms, at)
    scores = [coverage.score_of(one) + 0.5 * float(other) for one, other in zip(drawn, others, strict=True)]
    return starts[int(np.argmin(scores))]


def _without_shared(
    fit: Fit,
    coverage: Coverage,
    terms: Sequence[Term],
    own: OwnEstimate,
    iou: float,
    evaluations: int,
    preset: FitPreset,
    config: EstimateConfig,
) -> FrameFit:
    """Return a fit after one step by which the errors that the masks share are eliminated.

    ``terms`` are those beside the ``coverage``; ``own`` is what the outlines are measured by, ``iou`` the overlap of
    the fit. The step is taken from where the fit was drawn last, which is at most a small step away, if its outline
    was found there.
    """
    has_outlines = all(one.outlined for one in fit.drawn)
    start, drawn = (fit.drawn_at, fit.drawn) if has_outlines else (fit.at, None)
    shadows = config.session.shadows
    if preset is not IN_SESSION:
        outline, by_masks = outline_and_masks(coverage, start, own.noises, preset.size, drawn, as_seen=shadows)
        at, slope = stepped(start, outline, terms)
        found = FrameFit(at, outline.information[0], slope, fit.score, evaluations, iou, own.iou, by_masks=by_masks)
        return replace(found, side_px=side_deviation(own.noises[0]))
    lasting = coverage.near_with_lasting(start, own.noises, drawn=drawn, as_seen=shadows)
    outline = without_lasting(lasting, lasting.dimension - (6 + len(start.joints)), preset.size)
    at, slope = stepped(start, outline, terms)
    return FrameFit(
        at,
        information=outline.information[0],
        slope=slope,
        lasting=_after(lasting, at.minus(start)),
        side_px=side_deviation(own.noises[0]),
        side_offsets=coverage.views[0].side_offsets(at),
        score=fit.score,
        evaluations=evaluations,
        iou=iou,
        own_iou=own.iou,
    )


def outline_and_masks(
    coverage: Coverage,
    at: Posed,
    noises: Sequence[OutlineNoise],
    size: LastingSize,
    drawn: DrawnCoverage | None,
    *,
    stride: int = 1,
    as_seen: bool,
) -> tuple[Quadratic, Float64]:
    """Return the outline's terms (1, D) near a pose, and what the mean errors of all masks do to them, (D, 7).

    ``size`` is that of the errors that last, which are eliminated. An error on a side that the fit discounts, since the
    mask shows it there, hardly changes what the fit tells. Other arguments are those of `Coverage.near_with_lasting`,
    the result is as ``by_masks`` of `FrameFit`.
    """

    def errors(number: int, outline: OutlinePoints, by_pose: Float64) -> Float64:
        return coverage.views[number].mean_errors(outline, at)

    lasting = coverage.near_with_lasting(at, noises, errors, drawn, stride=stride, as_seen=as_seen)
    both, own = without_lasting(lasting, LASTING * len(coverage.views), size), 6 + len(at.joints)
    return Quadratic(both.information[:, :own, :own], both.slope[:, :own]), both.information[0, :own, own:]


def stepped(at: Posed, outline: Quadratic, terms: Sequence[Term]) -> tuple[Posed, Float64]:
    """Return where a fit is after one step, of at most 3 mm, and the slope (D,) of the outline's terms there.

    ``outline`` (1, D) are its terms about the pose ``at``, without the errors that the masks share; ``terms`` are the
    others.
    """
    whole = outline + sum_of_locals(terms, Posed.stacked([at]))
    step = -np.linalg.solve(whole.information[0], whole.slope[0])
    step *= min(1.0, _LARGEST_STEP / max(float(np.linalg.norm(step[:3])), 1e-12))
    end = at.moved(step)
    for term in terms:
        end = term.allowed(Posed.stacked([end]))[0]
    return end, outline.slope[0] + outline.information[0] @ end.minus(at)


def _after(terms: Quadratic, step: Float64) -> Quadratic:
    """Return terms (1, D + S) about where their first D unknowns are after a step."""
    return Quadratic(terms.information, terms.slope + terms.information[:, :, : len(step)] @ step)


def with_noise(own_estimate: OwnEstimate, views: Sequence[FrameView], config: EstimateConfig) -> OwnEstimate:
    """Return a frame's own estimate with the noise of the residuals there; arguments as in `fit_frame`."""
    return replace(own_estimate, residual=_noise(_coverage(views, config, own_estimate), own_estimate, None))


def _coverage(
    views: Sequence[FrameView],
    config: EstimateConfig,
    own_estimate: OwnEstimate | None,
    shrink: int = 1,
    margins: Sequence[float] = (),
) -> Coverage:
    """Return the coverage of a frame's views at 1 / ``shrink`` of the image size.

    The correlation lengths are those of the residuals at the own estimate.
    """
    outline = replace(config.refine.outline, cauchy=config.session.cauchy)
    pairs = zip(views, margins or [0.0] * len(views), strict=True)
    sized = [SizedView(view, blur=outline.blur, shrink=shrink, margin=margin) for view, margin in pairs]
    return Coverage(sized, outline, correlations=() if own_estimate is None else own_estimate.lengths)


def _noise(coverage: Coverage, own_estimate: OwnEstimate, cameras: Sequence[Camera] | None) -> float:
    """Measure the noise at the own estimate, whose cameras may be other ones, as in `fit_frame`."""
    return (coverage if cameras is None else coverage.with_cameras(cameras)).noise_at(own_estimate.at)


def _limits(readings: Readings) -> Readings:
    """Return the limits of the joints without their readings."""
    return replace(readings, values=np.full_like(readings.values, np.nan))
