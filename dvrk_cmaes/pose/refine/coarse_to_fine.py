"""Coarse-to-fine refinement of the candidates of the global search to a few modes, including the mirror twin."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property

import numpy as np

from dvrk_cmaes.config import EstimateConfig
from dvrk_cmaes.geometry import Posed
from dvrk_cmaes.instrument import Instrument
from dvrk_cmaes.joints.prior import Readings
from dvrk_cmaes.pose.refine.direct import refine_direct
from dvrk_cmaes.pose.refine.gauss_newton import Fit, Steps, assess, refine
from dvrk_cmaes.pose.refine.information import ViewAtFullSize, information_of_views
from dvrk_cmaes.pose.refine.rig_rotation import Rotation, rotations_of_views
from dvrk_cmaes.pose.refine.selection import ALL, Selection
from dvrk_cmaes.pose.search.global_search import scale_of_change
from dvrk_cmaes.pose.search.modes import PoseCandidate, are_distinct, best_per_mode, is_twin, twin_of
from dvrk_cmaes.pose.search.objective import loss_of_views
from dvrk_cmaes.pose.terms.contour import CorrelatedContour, has_correlated_noise
from dvrk_cmaes.pose.terms.coverage import Coverage
from dvrk_cmaes.pose.terms.outline_term import Derivatives
from dvrk_cmaes.pose.terms.sized_view import SizedView
from dvrk_cmaes.pose.terms.term import Term
from dvrk_cmaes.pose.terms.tips_term import terms_of_frame
from dvrk_cmaes.pose.views import FrameView
from dvrk_cmaes.silhouette import Body, Renderer

_HALF = 2  # the least divisor of the size between the smallest and the whole one
_BETWEEN = 400  # px, about the width of the images of that size where the whole ones are larger than twice that
_LEAST_AREA = 800.0  # px of a mask in the smallest image
_CLEARLY_WORSE = 15.0  # difference of the negative log-likelihood
_AS_GOOD = 3.0  # difference of the negative log-likelihood
_FARTHEST = 1.0  # m, of an instrument that an endoscope sees; a refinement that leads beyond has diverged
_AGREEING = 2  # candidates that have reached the same mode, which suffice if no other mode is nearly as good
_TWINS = 3  # best candidates whose mirror twins are refined as well
_OF_CONTOUR = Steps(6, tolerance=0.1, tested="none", largest=6.0)  # from a pose that is nearly right


def _agree(modes: Sequence[Fit], gap: float) -> bool:
    """Return whether several poses have reached the best one's mode, and no other mode is nearly as good.

    Another mode is nearly as good if its score is worse by less than ``gap``, or its outline alone is better. Where
    both outlines are as good as the noise allows, the readings decide.
    """
    best = min(modes, key=lambda mode: mode.score)
    others = [mode for mode in modes if are_distinct(mode.at, best.at)]
    return len(modes) - len(others) >= _AGREEING and all(
        mode.score > best.score + gap and mode.outline_score >= best.outline_score for mode in others
    )


def _not_diverged(fits: list[Fit]) -> list[Fit]:
    """Leave out the fits of an instrument farther away than an endoscope sees; the nearest stays if all are."""
    distances = [float(np.linalg.norm(fit.at.pose[:3, 3])) for fit in fits]
    near = [fit for fit, distance in zip(fits, distances, strict=True) if distance < _FARTHEST]
    return near or [fits[int(np.argmin(distances))]]


class LocalSearch:
    """Refines modes of one frame on all of its views, of which the first is the main one.

    It counts the silhouettes drawn and the rays traced. ``decimated`` is the instrument with fewer faces, for small
    images.
    """

    def __init__(self, views: Sequence[FrameView], decimated: Body, readings: Readings, config: EstimateConfig) -> None:
        self._views = tuple(views)
        self._decimated = decimated
        self._readings = readings
        self._derivatives: Derivatives = "differences" if config.refine.derivatives == "differences" else "closed-form"
        self._config = config
        self._last_selection = Selection(config.refine.last_share, config.refine.last_gap)
        self._sized: list[SizedView] = []
        self._direct_silhouettes = 0

    @property
    def silhouettes(self) -> int:
        """Number of silhouettes drawn so far, without those by the views' own renderers."""
        return self._direct_silhouettes + sum(view.silhouettes for view in self._sized)

    @property
    def rays(self) -> int:
        """Number of rays traced so far, without those by the views' own renderers."""
        return sum(view.rays for view in self._sized)

    @property
    def _instrument(self) -> Instrument:
        return self._decimated.instrument

    @cached_property
    def _coarse(self) -> list[Renderer]:
        """Renderers of the decimated instrument in the views."""
        cameras = [view.evidence.camera for view in self._views]
        return [Renderer(self._decimated, camera, threads=self._config.threads) for camera in cameras]

    @cached_property
    def _half(self) -> int:
        """The size, as a divisor, at which the instrument is drawn with all of its faces, as at the whole size."""
        return max(_HALF, round(self._views[0].evidence.camera.width / _BETWEEN))

    @cached_property
    def _smallest(self) -> int:
        """The divisor of the smallest size, at which the mask is still large enough to tell modes."""
        mask = self._views[0].evidence.mask
        legible = int(np.sqrt(np.count_nonzero(mask) / _LEAST_AREA))
        usual: int = round(mask.shape[1] / self._config.refine.width_px)
        return max(1, min(usual, legible))

    def _coverage(self, shrink: int) -> Coverage:
        """Return the coverage of all views at 1 / ``shrink`` of the main one's size."""
        outline = self._config.refine.outline
        if shrink > 1:
            outline = replace(outline, cauchy=outline.small_cauchy)
        if shrink > self._half:  # where modes only need to be told apart
            outline = replace(outline, lines_per_pixel=1)
        width = self._views[0].evidence.camera.width
        sized = []
        for view, coarse in zip(self._views, self._coarse, strict=True):
            own = max(1, round(shrink * view.evidence.camera.width / width)) if shrink > 1 else 1
            small = coarse if shrink > self._half else None
            moved = self._decimated if shrink >= self._half else None  # of which outlines are drawn for differences
            sized.append(SizedView(view, blur=outline.blur, shrink=own, renderer=small, differences=moved))
        self._sized += sized
        return Coverage(sized, outline)

    @cached_property
    def _terms(self) -> list[Term]:
        """The terms beside the coverage."""
        return terms_of_frame(self._views, self._readings, self._config.refine.outline)

    def _refine(
        self,
        coverage: Coverage,
        modes: Sequence[PoseCandidate],
        *,
        iterations: int | None = None,
        selection: Selection = ALL,
        continued: bool = False,
    ) -> list[Fit]:
        """Refine candidates or modes on the coverage and all other terms; those that diverge are left out."""
        if not modes:
            return []
        shrink = coverage.views[0].shrink
        steps = Steps.of(self._config.refine.outline, shrink, iterations=iterations, continued=continued)
        at = Posed.stacked([mode.at for mode in modes])
        fits = refine(coverage, self._terms, at, steps, selection, self._derivatives)
        return _not_diverged(fits)

    def _assess(self, coverage: Coverage, modes: Sequence[PoseCandidate]) -> list[Fit]:
        """Score modes without refining them."""
        return assess(coverage, self._terms, Posed.stacked([mode.at for mode in modes])) if modes else []

    def _twin(self, mode: PoseCandidate) -> PoseCandidate:
        return PoseCandidate(twin_of(self._instrument, mode.at), mode.score)

    def _missing_twin(self, best: PoseCandidate, others: Sequence[PoseCandidate]) -> list[PoseCandidate]:
        """Return the best mode's mirror twin in a list, which is empty if there is none or the others include it."""
        instrument = self._instrument
        if not instrument.has_twin or any(is_twin(instrument, best.at, other.at) for other in others):
            return []
        return [self._twin(best)]

    def refine(self, candidates: Sequence[PoseCandidate]) -> tuple[list[Fit], list[Rotation]]:
        """Refine candidates at increasing image sizes; returns the remaining modes, the best first.

        They include the mirror twin of the best mode if the instrument has one. Also returns the rotation by which each
        view but the first would turn at the best mode, as `rotations_of_views`.
        """
        c, full_width = self._config.refine, self._views[0].evidence.camera.width
        coarse = self._coverage(self._smallest)
        twins = [self._twin(candidate) for candidate in candidates[:_TWINS]] if self._instrument.has_twin else []
        first = Selection(gap=c.first_gap, least=c.small_modes)
        tried, rest = candidates[: c.first_candidates], candidates[c.first_candidates :]
        modes = self._refine(coarse, [*tried, *twins], iterations=c.first_steps, selection=first)
        if not _agree(modes, c.agreed_gap):
            modes += self._refine(coarse, rest, iterations=c.first_steps, selection=first)
        small = Selection(c.small_share, c.small_gap, least=c.half_size_modes + 1)
        modes = small.of(best_per_mode(modes, most=c.small_modes))
        modes = self._refine(coarse, modes, iterations=c.small_steps, selection=small)
        modes = best_per_mode(modes, most=c.half_size_modes)
        if full_width >= 320:
            refined = self._refine(self._coverage(self._half), modes, selection=self._last_selection)
            modes = self._last_selection.of(best_per_mode(refined))
        finest = self._coverage(1)
        final = self._finest(finest, modes[: c.modes])
        best = min(final, key=lambda m: m.score)
        final += self._first_of_twin(finest, self._missing_twin(best, final))
        return self._finish(finest, final)

    def _first_of_twin(self, coverage: Coverage, twin: Sequence[PoseCandidate]) -> list[Fit]:
        """Return the twin of a refined mode, if there is one, as good as it needs to be for the last iterations.

        Its outline is as good as that of the mode itself, so that the Gauss-Newton iterations before would hardly move
        it; direct methods have no last iterations.
        """
        if self._config.refine.method == "gauss-newton":
            return self._assess(coverage, twin)
        return self._finest(coverage, twin)

    def _finish(self, finest: Coverage, modes: list[Fit]) -> tuple[list[Fit], list[Rotation]]:
        """Estimate the noise of the outline from the best mode, and refine the modes with the resulting weights."""
        best = min(modes, key=lambda m: m.score)
        noises = [view.noise_at(best.at) for view in self._views]
        coverage = finest.with_correlations([noise.length for noise in noises])
        # Modes that are clearly worse, by score and by outline score, are not refined again, only scored.
        close = [
            mode
            for mode in modes
            if mode.score < best.score + _CLEARLY_WORSE or mode.outline_score < best.outline_score + _CLEARLY_WORSE / 3
        ]
        rest = self._assess(coverage, [mode for mode in modes if mode not in close])
        modes = best_per_mode([*self._last(coverage, close), *rest])
        if missing := self._missing_twin(modes[0], modes[1:]):
            modes = best_per_mode([*modes, *self._last(coverage, missing)])
        first, *others = _not_diverged(modes)
        if self._config.refine.method == "gauss-newton" and all(has_correlated_noise(noise) for noise in noises):
            first = self._with_correlated_noise(coverage, first)
        views = [ViewAtFullSize(*pair) for pair in zip(self._views, coverage.views, strict=True)]
        of_views = information_of_views(views, self._terms, first.at)
        rotations = rotations_of_views(views, self._terms, first.at, of_views)
        return [replace(first, information=np.sum(of_views, axis=0)), *others], rotations

    def _with_correlated_noise(self, coverage: Coverage, mode: Fit) -> Fit:
        """Return a mode where generalised least squares put it; where it was, if that is clearly worse by its score."""
        (fit,) = refine(CorrelatedContour(coverage.views), self._terms, Posed.stacked([mode.at]), _OF_CONTOUR)
        is_as_good = assess(coverage, self._terms, fit.at[None])[0].score < mode.score + _AS_GOOD
        return replace(mode, at=fit.at) if is_as_good else mode

    def _last(self, coverage: Coverage, modes: Sequence[PoseCandidate]) -> list[Fit]:
        """Refine modes by the last Gauss-Newton iterations; with any other method they are only scored."""
        config = self._config.refine
        if config.method == "gauss-newton":
            narrow = coverage.with_width(config.outline.last_cauchy)
            return self._refine(narrow, modes, selection=self._last_selection)
        return self._assess(coverage, modes)

    def _finest(self, coverage: Coverage, modes: Sequence[PoseCandidate]) -> list[Fit]:
        """Refine modes at full image size by the chosen method."""
        config = self._config
        if config.refine.method == "gauss-newton":
            return self._refine(
                coverage, modes, iterations=config.refine.full_steps, selection=self._last_selection, continued=True
            )
        loss = loss_of_views(self._views, self._readings, config)
        scale = 0.3 * scale_of_change(self._readings)
        fits = []
        for mode in modes:
            at, count = refine_direct(
                config.refine.method, loss, mode.at, scale, config.refine.evaluations, config.seed
            )
            fits += assess(coverage, self._terms, at[None])
            self._direct_silhouettes += count
        return fits
