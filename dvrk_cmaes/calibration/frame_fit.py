"""Fit of one frame's pose and joints to its outline, with the prediction of its session as a prior."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.calibration.lasting_errors import SINGLE_SIZE, USUAL_SIZE, LastingSize, without_lasting
from dvrk_cmaes.calibration.own_estimate import OwnEstimate
from dvrk_cmaes.camera import Camera
from dvrk_cmaes.config import EstimateConfig
from dvrk_cmaes.evidence.outline_noise import OutlineNoise, measure_noise
from dvrk_cmaes.geometry import Posed, adjoint, inverse
from dvrk_cmaes.joints.prior import Readings
from dvrk_cmaes.pose.refine.gauss_newton import Fit, Steps, refine
from dvrk_cmaes.pose.refine.selection import Selection
from dvrk_cmaes.pose.terms.coverage import Coverage, of_camera, of_margin
from dvrk_cmaes.pose.terms.expected import Expected
from dvrk_cmaes.pose.terms.frame_terms import terms_of_frame
from dvrk_cmaes.pose.terms.shared_errors import side_deviation
from dvrk_cmaes.pose.terms.sized_view import SizedView
from dvrk_cmaes.pose.terms.term import Quadratic, Term, sum_of_costs, sum_of_locals
from dvrk_cmaes.pose.views import FrameView, overlap
from dvrk_cmaes.silhouette import OutlinePoints

Float64 = NDArray[np.float64]

_KEPT = 2  # fits at half the image size that are continued at the whole size
_LEAST_OVERLAP = 0.5  # intersection over union below which a fit is not used
_LARGEST_STEP = 3e-3  # m, by which a fit moves where the errors that masks share are eliminated
_FREE_STEPS = Steps(12, inner=3, tested="none", largest=4.0)  # of a fit from a pose that is nearly right
_OVERLAP_LOSS = 0.1  # by which the fit's intersection over union may fall below that of the frame's own estimate


PER_VIEW = 6
"""Unknowns of a further view in `terms_of_rig`: rotation, baseline, focal length and margin."""


@dataclass(frozen=True, eq=False)
class SeenBy:
    """How a view of a frame is taken to see it: ``camera``, ``place`` (4, 4), m, and ``margin`` of its mask, px.

    ``number`` is that of the view among the ``further`` ones of the rig, None of the first one; ``size`` is the width
    of its images in that of the first one's.
    """

    camera: Camera
    place: Float64
    margin: float
    number: int | None
    further: int
    size: float


@dataclass(frozen=True, eq=False)
class FrameFit:
    """A frame's pose, fitted with the session's prior.

    ``information`` (D, D), D = 6 + J, is the Gauss-Newton matrix of the outline alone at the fit, and ``slope`` (D,)
    the gradient of half its sum of squares. ``score`` is the negative log-likelihood of the fit, ``evaluations`` the
    number of silhouettes that were rendered. ``iou`` is the intersection over union of the fit's silhouette and the
    mask; ``own_iou`` is that of the frame's own estimate, 0 if not given. ``lasting`` are the same terms of the outline
    as functions of S further unknowns, (1, D + S): the errors of the masks that last from frame to frame, in their
    usual standard deviations, of which the first view's is ``side_px``. These errors are eliminated from the others.
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
    confirm: bool = True,
) -> FrameFit:
    """Fit a frame from several starts, and return the fit with the best score.

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
        the session's prior has not contributed. If None, the noise is estimated during the fit.
    own_cameras
        The views' cameras of ``own_estimate``, for images of the same size, where they are not those of the views.
    margins
        Margin of each view's mask, px, that is taken off it all round; none by default.
    confirm
        Whether the last step, shorter than the tolerance, is drawn and undone if it raises the loss.
    """
    shrinks = (2, 1) if len(starts) > 1 and views[0].evidence.camera.width >= 320 else (1,)
    at, count = Posed.stacked(starts), 0
    selection = Selection(config.refine.small_share, config.refine.small_gap, least=_KEPT)
    for shrink in shrinks:
        terms = terms_of_frame(views, _limits(readings), config.refine.outline, expected)
        coverage = _coverage(views, config, own_estimate, shrink, margins)
        if own_estimate is not None:
            noise = own_estimate.residual if shrink == 1 else None
            coverage = coverage.with_noise(_noise(coverage, own_estimate, own_cameras) if noise is None else noise)
        steps = replace(Steps.of(config.refine.outline, shrink), tested="all" if confirm else "long")
        fits = sorted(refine(coverage, terms, at, steps, selection), key=lambda fit: fit.score)[:_KEPT]
        at, count = Posed.stacked([fit.at for fit in fits]), count + coverage.silhouettes
    drawn = [view.silhouette(fits[0].at) for view in views]
    if own_estimate is None:
        pairs = zip(views, drawn, strict=True)
        noises = tuple(measure_noise(view.evidence.contour, silhouette) for view, silhouette in pairs)
    else:
        noises = own_estimate.noises
    own_iou = 0.0 if own_estimate is None else own_estimate.iou
    iou, as_seen = overlap(views, drawn), config.session.shadows
    return _without_shared(fits[0], coverage, terms, noises, iou, own_iou, count, as_seen=as_seen)


def fit_predicted(
    views: Sequence[FrameView],
    readings: Readings,
    config: EstimateConfig,
    expected: Expected,
    starts: Sequence[Posed],
    *,
    margins: Sequence[float] = (),
) -> tuple[FrameFit, OwnEstimate]:
    """Fit a frame that has no estimate of its own, but starts near the answer; arguments as of `fit_frame`.

    Steps are taken from the better start, and not tested: where the prediction is near, two or three are enough, where
    it is some millimetres off, more. The noise of the outlines is measured where they end, and the errors that masks
    share are eliminated there. Also returns what was measured.
    """
    terms = terms_of_frame(views, _limits(readings), config.refine.outline, expected)
    coverage = _coverage(views, config, None, 1, margins)
    at = Posed.stacked([_better_start(coverage, terms, starts)])
    (fit,) = refine(coverage, terms, at, replace(_FREE_STEPS, tolerance=config.refine.outline.tolerance))
    own = OwnEstimate.of(views, fit.at)
    coverage = coverage.with_lengths(own.lengths)
    coverage = coverage.with_noise(coverage.noise_at(own.at))
    count = coverage.silhouettes + len(views)
    as_seen = config.session.shadows
    fit = replace(fit, drawn=coverage.draw(Posed.stacked([fit.at]))[0], drawn_at=fit.at)
    fitted = _without_shared(fit, coverage, terms, own.noises, own.iou, own.iou, count, SINGLE_SIZE, as_seen=as_seen)
    return fitted, own


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
    noises: Sequence[OutlineNoise],
    iou: float,
    own_iou: float,
    evaluations: int,
    size: LastingSize = USUAL_SIZE,
    *,
    as_seen: bool = False,
) -> FrameFit:
    """Return a fit after one step by which the errors that the masks share are eliminated.

    ``terms`` are those beside the ``coverage``, ``noises`` those of the views' contours, and ``size`` is that of the
    errors that last from frame to frame; ``as_seen`` is as in `Coverage.near_with_lasting`, the others are as in
    `FrameFit`. The step is taken from where the fit was drawn last, which is at most a small step away, if its outline
    was found there.
    """
    has_outlines = all(one.outlined for one in fit.drawn)
    start, drawn = (fit.drawn_at, fit.drawn) if has_outlines else (fit.at, None)
    lasting = coverage.near_with_lasting(start, noises, drawn=drawn, as_seen=as_seen)
    own = 6 + len(start.joints)
    outline = without_lasting(lasting, lasting.dimension - own, size)
    at, slope = stepped(start, outline, terms)
    return FrameFit(
        at,
        information=outline.information[0],
        slope=slope,
        lasting=_after(lasting, at.minus(start)),
        side_px=side_deviation(noises[0]),
        score=fit.score,
        evaluations=evaluations,
        iou=iou,
        own_iou=own_iou,
    )


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


def terms_of_constants(
    view: FrameView,
    config: EstimateConfig,
    fitted: Posed,
    own_estimate: OwnEstimate,
    camera: Camera,
    margin: float,
) -> Quadratic:
    """Compute the outline's terms about a pose and about what all frames share: the camera and the masks' margin.

    ``fitted`` is the pose with the camera ``camera``, whose image has the evidence's size, and the mask less ``margin``
    px; the view has the evidence's own camera. ``own_estimate`` is that of this view alone. Four further unknowns are
    those of `of_camera` and the margin, px; the last ones are the errors that last, as in `FrameFit`. Other errors that
    parts of one mask share are eliminated.
    """
    noise = own_estimate.residual
    noise = _noise(_coverage([view], config, own_estimate), own_estimate, None) if noise is None else noise
    coverage = _coverage([view], config, own_estimate, margins=[margin]).with_cameras([camera]).with_noise(noise)

    def constants(number: int, outline: OutlinePoints, by_pose: Float64) -> Float64:
        return np.column_stack([of_camera(coverage.views[number], outline), of_margin(outline)])

    return coverage.near_with_lasting(fitted, own_estimate.noises, constants, as_seen=config.session.shadows)


def terms_of_rig(
    views: Sequence[FrameView],
    config: EstimateConfig,
    fitted: Posed,
    own_estimate: OwnEstimate,
    seen: Sequence[SeenBy],
) -> Quadratic:
    """Compute the outlines' terms about a pose, and about what all frames share of their views.

    ``fitted`` is the pose in the rig of the views, which ``seen`` describes. The noise is measured there, or at the own
    estimate where it is less: in a wrong rig, no pose fits all views. The unknowns beside the pose are those of the
    camera and of the margin, as in `terms_of_constants`, and for each of the rig's further views its rotation about the
    first camera's axes, rad, the logarithms of its baseline and its focal length, and by how much its margin, px, is
    larger.
    """
    outline = replace(config.refine.outline, cauchy=config.session.cauchy)
    sized = [SizedView(view, blur=outline.blur, margin=by.margin) for view, by in zip(views, seen, strict=True)]
    here = OwnEstimate.of(views, fitted)
    noises = [min(pair, key=lambda noise: noise.sigma) for pair in zip(own_estimate.noises, here.noises, strict=True)]
    coverage = Coverage(sized, outline, correlations=[noise.length for noise in noises])
    (drawn,) = coverage.draw(Posed.stacked([fitted]))
    noise = sum(coverage.final_losses(drawn))
    coverage = coverage.with_noise(noise if own_estimate.residual is None else min(noise, own_estimate.residual))

    def constants(number: int, points: OutlinePoints, by_pose: Float64) -> Float64:
        view, by = coverage.views[number], seen[number]
        of_lens, of_mask = of_camera(view, points), of_margin(points)
        columns = np.zeros((len(of_mask), 4 + PER_VIEW * by.further))
        columns[:, :4] = np.column_stack([of_lens * [1.0, by.size, by.size], of_mask])
        if by.number is not None:
            first = 4 + PER_VIEW * by.number
            moving = np.column_stack([adjoint(inverse(fitted.pose))[:, 3:], _by_baseline(fitted, by.place)])
            columns[:, first : first + 4] = by_pose[:, :6] @ moving
            columns[:, first + 4] = of_lens[:, 0]
            columns[:, first + 5] = of_mask
        return columns

    return coverage.near_without_shared(fitted, noises, constants, drawn)


def _by_baseline(at: Posed, place: Float64) -> Float64:
    """Return the small changes (6,) of a pose that move it in a view as the logarithm of the view's baseline does."""
    return np.concatenate([(place[:3, :3] @ at.pose[:3, :3]).T @ place[:3, 3], np.zeros(3)])


def _limits(readings: Readings) -> Readings:
    """Return the limits of the joints without their readings."""
    return replace(readings, values=np.full_like(readings.values, np.nan))
