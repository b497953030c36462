"""Fit of one frame's pose and joints to its outline, with the prediction of its session as a prior."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final, Literal

import numpy as np

from dvrk_cmaes.calibration.blocks import OutlineOfView, SeenBlock
from dvrk_cmaes.calibration.masks_and_sizes import MARGIN_ALONE
from dvrk_cmaes.config import EstimateConfig
from dvrk_cmaes.evidence.outline_noise import OutlineNoise, measure_noise
from dvrk_cmaes.geometry import Bool, Float64, Posed
from dvrk_cmaes.joints.prior import split_readings
from dvrk_cmaes.pose.doubts import LEAST_OVERLAP
from dvrk_cmaes.pose.refine.gauss_newton import Fit, Steps, refine
from dvrk_cmaes.pose.refine.information import ALL, Selection
from dvrk_cmaes.pose.terms.coverage import Coverage
from dvrk_cmaes.pose.terms.shared_errors import SIDES, without_last
from dvrk_cmaes.pose.terms.sized_view import SizedView
from dvrk_cmaes.pose.terms.term import Quadratic, Term, sum_of_locals
from dvrk_cmaes.pose.terms.tips_term import Expected, terms_of_frame
from dvrk_cmaes.pose.views import FrameView, overlap
from dvrk_cmaes.silhouette import OutlinePoints

SIDES_IN_SESSION: Final = 0.25
"""Factor on the standard deviations of the errors of the shaft's sides in the fits of a session.

They are nuisance parameters of each frame, which are eliminated. Their standard deviations are those of single frames;
the fits of a session have a loss that is less robust against shadows, with 0.2 to 0.6 of these at the true poses of
followed recordings.
"""
_SHARE, _GAP, _KEPT = 0.9, 50.0, 2  # of fits from several starts that continue, as `Selection`
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

    @classmethod
    def of(cls, views: Sequence[FrameView], at: Posed, drawn: Sequence[Bool] = ()) -> OwnEstimate:
        """Measure an estimate in the views that show the instrument, where its silhouettes (H, W) are ``drawn``."""
        drawn = drawn or [view.silhouette(at) for view in views]
        noises = [measure_noise(view.evidence.contour, seen) for view, seen in zip(views, drawn, strict=True)]
        return cls(at, tuple(noises), overlap(views, drawn))


@dataclass(frozen=True, eq=False)
class FrameFit:
    """A frame's pose, fitted to its outlines with the session's prior.

    ``outline`` are the terms of what the image alone shows near the fit, in its changes (D,), D = 6 + J, and of a
    margin of all masks, px. ``seen`` (1, D + E) are those of one view, in changes of the fit and of the E unknowns of
    blocks, of which the first is that margin, from the values with which the frame is fitted; None without that view.
    ``evaluations`` is the number of silhouettes that were rendered. ``iou`` is the intersection over union of the fit's
    silhouette and the mask; ``own_iou`` is that of the frame's own estimate.
    """

    at: Posed
    outline: Quadratic
    evaluations: int
    iou: float
    own_iou: float
    seen: Quadratic | None = None

    @property
    def alone(self) -> Quadratic:
        """The outline's terms at the fit, in its own changes (1, D)."""
        return Quadratic(self.outline.information[:, : self._size, : self._size], self.outline.slope[:, : self._size])

    @property
    def information(self) -> Float64:
        """Gauss-Newton matrix (D, D) of the outline's terms at the fit."""
        return np.asarray(self.alone.information[0])

    @property
    def slope(self) -> Float64:
        """Gradient (D,) of half their sum of squares."""
        return np.asarray(self.alone.slope[0])

    @property
    def by_margin(self) -> Float64:
        """Change (D,) of ``information`` times what the outline shows of the pose, per px of a margin of all masks."""
        return self.outline.information[0, : self._size, self._size]

    @property
    def _size(self) -> int:
        return 6 + len(self.at.joints)

    @property
    def explains_mask(self) -> bool:
        """Whether the fit overlaps the mask about as well as the frame's own estimate."""
        return self.iou > max(self.own_iou - _OVERLAP_LOSS, LEAST_OVERLAP)

    def step_to(self, expected: Expected) -> float:
        """Return how far the fit would move with another prior, in standard deviations per parameter.

        The outline's terms are taken as quadratic.
        """
        step, slope = self._step(expected)
        return float(np.sqrt(max(-float(step @ slope), 0.0) / len(step)))

    def moved_to(self, expected: Expected) -> FrameFit:
        """Return the fit where it would be with another prior, as in `step_to`, with the outline's slope there."""
        return self.moved_by(self._step(expected)[0])

    def moved_by(self, change: Float64) -> FrameFit:
        """Return the fit after a change (D,), with the outline's slopes there."""
        seen = None if self.seen is None else self.seen.moved_by(change)
        return replace(self, at=self.at.moved(change), outline=self.outline.moved_by(change), seen=seen)

    def _step(self, expected: Expected) -> tuple[Float64, Float64]:
        """Return the change (D,) of the fit with another prior, and the slope (D,) there, whose minimum it is."""
        information = self.information + expected.information
        slope = self.slope + expected.information @ self.at.minus(expected.mean)
        return -np.asarray(np.linalg.solve(information, slope), dtype=np.float64), slope


@dataclass(frozen=True)
class FitPreset:
    """How a frame is fitted.

    ``steps`` are those of the refinement, with at least the tolerance of the settings; by default those of the
    settings. ``noise`` says how the outlines' noise is measured where the frame has no estimate of its own: by the
    silhouette of the fit; the same, and by that the outlines are weighed anew; or by what the fit drew.
    ``lines_per_pixel`` are those of the drawings, those of the settings by default. Every ``stride``-th point of the
    outline counts at the end; ``as_seen`` is as in `Coverage.near_with_sides`, as in the settings by default. ``sides``
    is the factor on the standard deviations of the errors of the shaft's sides.
    """

    steps: Steps | None = None
    noise: Literal["silhouette", "weighed", "drawn"] = "silhouette"
    lines_per_pixel: int | None = None
    stride: int = 1
    as_seen: bool | None = None
    sides: float = SIDES_IN_SESSION


LINES_PER_PIXEL: Final = 1
"""Lines of the image, for each row of pixels, by which silhouettes are drawn while a recording runs."""

IN_SESSION: Final = FitPreset()
"""Fit of a frame of a session that is solved, or of a single frame of one that is calibrated."""

WHERE_IT_IS: Final = FitPreset(Steps(0))
"""Fit of a frame of a session that is near its minimum already, for its outline's terms there: one step."""

FOLLOWED: Final = FitPreset(Steps(12, 3, 0.0, "none", 4.0), noise="weighed", sides=1.0)
"""Fit of an image that follows others, near the prediction: two or three steps are enough there, more are far off."""

WHILE_RUNNING: Final = FitPreset(
    Steps(2, 4, 1.0, "none", 4.0),
    noise="drawn",
    lines_per_pixel=LINES_PER_PIXEL,
    stride=2,
    as_seen=True,
    sides=1.0,
)
"""Fit of an image that has just come, in few drawings, from where the one before was.

One that has not converged then is finished by the images after it.
"""

FROM_TWO_STARTS: Final = replace(WHILE_RUNNING, steps=Steps(2, 4, 0.0, "long"))
"""The same where the image before was far from its prediction."""

FROM_PREDICTION: Final = replace(WHILE_RUNNING, steps=Steps(6, 6, 0.0, "long"))
"""The same without an image before."""


def fit_frame(
    views: Sequence[FrameView],
    config: EstimateConfig,
    expected: Expected,
    starts: Sequence[Posed],
    own_estimate: OwnEstimate | None = None,
    *,
    margin: float = 0.0,
    lengths: Sequence[float] = (),
    preset: FitPreset = IN_SESSION,
    blocks: Sequence[SeenBlock] = (MARGIN_ALONE,),
    shown: int | None = None,
) -> tuple[FrameFit, OwnEstimate]:
    """Fit a frame from several starts; returns the fit with the best score, and what its outlines are measured by.

    Parameters
    ----------
    views, config
        The views that show the instrument, with the frame's evidence and renderers at full detail; all settings.
    expected
        The session's prediction from the readings, which is the prior.
    starts
        Starting poses, at least one.
    own_estimate
        The frame's estimate without the session, by whose residuals the noise of the outlines is measured. If None,
        that is estimated during the fit, and measured at its end.
    margin
        Margin of the masks, px, that is taken off all round.
    lengths
        Correlation lengths of the contours' errors, px, one of each view, until they are measured; those of the own
        estimate or of the settings by default.
    preset, blocks, shown
        How the fit is found; the blocks in whose unknowns the outline is also approximated, the masks' margin first;
        the number of the view that shows them.
    """
    limits = split_readings(views[0].renderer.body.instrument, {}, config)[0]
    terms = terms_of_frame(views, limits, config.refine.outline, expected)
    coverage = _coverage(views, config, preset, own_estimate, lengths, margin)
    fit, seen = _refined(coverage, terms, starts, config, preset)
    own = own_estimate or OwnEstimate.of(views, fit.at, seen)
    count = coverage.silhouettes
    if preset.noise == "weighed":
        coverage = coverage.changed(correlations=own.lengths)
        coverage = coverage.changed(noise=coverage.noise_at(own.at))
        fit = _drawn_anew(fit, coverage)
        count += coverage.silhouettes
    iou = own.iou if own_estimate is None else overlap(views, seen)
    outline, of_one = _outlines(coverage, fit, own.noises, preset, config, blocks, shown)
    return _stepped(FrameFit(fit.drawn_at, outline, count, iou, own.iou, of_one), terms), own


def _outlines(
    coverage: Coverage,
    fit: Fit,
    noises: Sequence[OutlineNoise],
    preset: FitPreset,
    config: EstimateConfig,
    blocks: Sequence[SeenBlock],
    shown: int | None,
) -> tuple[Quadratic, Quadratic | None]:
    """Return the terms of the outlines near a drawn fit, of all views and of the one that shows blocks."""
    whole = _near(coverage, fit, noises, preset, config, blocks if len(noises) == 1 else blocks[:1])
    if shown is None or len(noises) == 1:
        return whole, None if shown is None else whole
    alone = replace(fit, drawn=(fit.drawn[shown],))
    return whole, _near(coverage.of_view(shown), alone, noises[shown : shown + 1], preset, config, blocks)


def _coverage(
    views: Sequence[FrameView],
    config: EstimateConfig,
    preset: FitPreset,
    own: OwnEstimate | None,
    lengths: Sequence[float] = (),
    margin: float = 0.0,
) -> Coverage:
    """Return the outlines' term, with the noise at the frame's own estimate, if there is one; as in `fit_frame`."""
    outline = config.refine.outline
    lines = outline.lines_per_pixel if preset.lines_per_pixel is None else preset.lines_per_pixel
    outline = replace(outline, cauchy=config.session.cauchy, lines_per_pixel=lines)
    sized = [SizedView(view, blur=outline.blur, margin=margin) for view in views]
    if own is None:
        return Coverage(sized, outline, correlations=lengths)
    coverage = Coverage(sized, outline, correlations=own.lengths)
    return coverage.changed(noise=coverage.noise_at(own.at) if own.residual is None else own.residual)


def _refined(
    coverage: Coverage, terms: Sequence[Term], starts: Sequence[Posed], config: EstimateConfig, preset: FitPreset
) -> tuple[Fit, list[Bool]]:
    """Refine a frame from its starts, by the outlines' term and others; returns the fit, and its silhouettes (H, W)."""
    outline = config.refine.outline
    steps = preset.steps or Steps.of(outline, 1)
    steps = replace(steps, tolerance=max(steps.tolerance, outline.tolerance))
    selection = Selection(_SHARE, _GAP, least=_KEPT) if preset.steps is None else ALL
    fit = min(refine(coverage, terms, Posed.stacked(starts), steps, selection), key=lambda each: each.score)
    if preset.noise == "drawn" or not all(one.outlined for one in fit.drawn):
        fit = _drawn_anew(fit, coverage)
    if preset.noise == "drawn":
        return fit, [view.silhouette(image) for view, image in zip(coverage.views, fit.drawn, strict=True)]
    return fit, [sized.view.silhouette(fit.at) for sized in coverage.views]


def _near(
    coverage: Coverage,
    fit: Fit,
    noises: Sequence[OutlineNoise],
    preset: FitPreset,
    config: EstimateConfig,
    blocks: Sequence[SeenBlock],
) -> Quadratic:
    """Return the outlines' terms near a drawn fit, in its changes and those of blocks, as in `FrameFit`.

    The errors of the shaft's sides are eliminated.
    """

    def columns(number: int, points: OutlinePoints, by_pose: Float64) -> Float64:
        drawn = OutlineOfView(coverage.views[number], points, fit.drawn_at)
        return np.column_stack([block.effect(drawn) for block in blocks])

    stride, as_seen = preset.stride, config.session.shadows if preset.as_seen is None else preset.as_seen
    whole = coverage.near_with_sides(fit.drawn_at, noises, columns, fit.drawn, stride=stride, as_seen=as_seen)
    return without_last(whole, np.eye(SIDES * len(coverage.views)) / preset.sides**2)


def _drawn_anew(fit: Fit, coverage: Coverage) -> Fit:
    """Return a fit drawn where it is."""
    return replace(fit, drawn=coverage.draw(Posed.stacked([fit.at]))[0], drawn_at=fit.at)


def _stepped(fit: FrameFit, terms: Sequence[Term]) -> FrameFit:
    """Return a fit after one step, of at most 3 mm, by the outline's terms there and by the others."""
    here = Posed.stacked([fit.at])
    others = sum_of_locals(terms, here)
    step = -np.linalg.solve(fit.information + others.information[0], fit.slope + others.slope[0])
    step *= min(1.0, _LARGEST_STEP / max(float(np.linalg.norm(step[:3])), 1e-12))
    end = fit.at.moved(step)
    for term in terms:
        end = term.allowed(Posed.stacked([end]))[0]
    return replace(fit.moved_by(end.minus(fit.at)), at=end)


def with_noise(own_estimate: OwnEstimate, views: Sequence[FrameView], config: EstimateConfig) -> OwnEstimate:
    """Return a frame's own estimate with the noise of the residuals there; arguments as in `fit_frame`."""
    return replace(own_estimate, residual=_coverage(views, config, IN_SESSION, own_estimate).noise)


_SETTLED = 0.15  # standard deviations per parameter; a frame whose fit would move by less is not fitted again
_NEAR = 3.0  # standard deviations per parameter; a fit that would move by less starts from where it would move to


def starts_of(
    before: Sequence[Posed], expected: Expected, *, agrees: bool, fit: FrameFit | None = None
) -> tuple[Posed, ...]:
    """Return the starts of a frame's fit; none if it is settled.

    A frame that ``agrees`` with the session starts from the first of the poses ``before``, or from where its ``fit``
    would move to, if that is near. Any other starts from all of these, and from what the session expects.
    """
    step = 0.0 if fit is None else fit.step_to(expected)
    if not agrees or step >= _NEAR:
        return (*before, expected.mean)
    if fit is None:
        return (before[0],)
    return () if step < _SETTLED else (fit.moved_to(expected).at,)
