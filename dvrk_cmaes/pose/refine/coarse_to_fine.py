"""Refinement of the modes that the global search found, at a small and at the full size, with their mirror twins."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from dvrk_cmaes.config import EstimateConfig
from dvrk_cmaes.geometry import Posed
from dvrk_cmaes.joints.prior import Readings
from dvrk_cmaes.pose.refine.gauss_newton import Fit, Steps, assess, refine
from dvrk_cmaes.pose.refine.information import ALL, Selection, information_of_views
from dvrk_cmaes.pose.refine.rig_rotation import Rotation, rotations_of_views
from dvrk_cmaes.pose.search.starts import PoseCandidate, best_per_mode, twin_of
from dvrk_cmaes.pose.terms.contour import CorrelatedContour, has_correlated_noise
from dvrk_cmaes.pose.terms.coverage import Coverage
from dvrk_cmaes.pose.terms.sized_view import SizedView
from dvrk_cmaes.pose.terms.tips_term import terms_of_frame
from dvrk_cmaes.pose.views import FrameView
from dvrk_cmaes.silhouette import Body, Renderer

_LEAST_AREA = 800.0  # px of a mask in the small images
_FULL_STEPS = 6  # largest number of iterations at full size before the noise is estimated
_AT_FULL = 3  # best modes that are refined at full size, mirror twins not counted
_FULL = Selection(share=0.93, gap=30.0)
"""Which modes go on after each iteration at full size; at the small size, all do until they have converged."""
_CLEARLY_WORSE = 15.0  # difference of the negative log-likelihood
_AS_GOOD = 3.0  # difference of the negative log-likelihood
_FARTHEST = 1.0  # m, of an instrument that an endoscope sees; a refinement that leads beyond has diverged
_OF_CONTOUR = Steps(6, tolerance=0.1, tested="none", largest=6.0)  # from a pose that is nearly right


def _not_diverged(fits: list[Fit]) -> list[Fit]:
    """Leave out the fits of an instrument farther away than an endoscope sees; the nearest stays if all are."""
    distances = [float(np.linalg.norm(fit.at.pose[:3, 3])) for fit in fits]
    near = [fit for fit, distance in zip(fits, distances, strict=True) if distance < _FARTHEST]
    return near or [fits[int(np.argmin(distances))]]


class LocalSearch:
    """Refines modes of one frame on all of its views, of which the first is the main one.

    ``decimated`` is the instrument with fewer faces, for small images.
    """

    def __init__(self, views: Sequence[FrameView], decimated: Body, readings: Readings, config: EstimateConfig) -> None:
        self._views = tuple(views)
        self._decimated = decimated
        self._config = config
        self._terms = terms_of_frame(views, readings, config.refine.outline)
        self.renderers: list[Renderer] = []
        """What has drawn the views so far, without their own renderers."""

    @property
    def _small(self) -> int:
        """The divisor of the small size, at which the mask is still large enough to tell modes."""
        mask = self._views[0].evidence.mask
        legible = int(np.sqrt(np.count_nonzero(mask) / _LEAST_AREA))
        return max(1, min(int(mask.shape[1] / self._config.refine.width_px + 0.5), legible))

    def _coverage(self, shrink: int) -> Coverage:
        """Return the coverage of all views at 1 / ``shrink`` of the main one's size."""
        outline, width = self._config.refine.outline, self._views[0].evidence.camera.width
        if shrink > 1:  # where modes only need to be told apart
            outline = replace(outline, cauchy=outline.small_cauchy, lines_per_pixel=1)
        sized = []
        for view in self._views:
            camera, own, small = view.evidence.camera, 1, None
            if shrink > 1:
                own = max(1, round(shrink * camera.width / width))
                small = Renderer(self._decimated, camera, threads=self._config.threads)
            sized.append(SizedView(view, blur=outline.blur, shrink=own, renderer=small))
        self.renderers += [view.renderer for view in sized]
        return Coverage(sized, outline)

    def _refine(
        self, coverage: Coverage, modes: Sequence[PoseCandidate], selection: Selection, iterations: int | None = None
    ) -> list[Fit]:
        """Refine candidates or modes on the coverage and all other terms; those that diverge are left out.

        ``iterations``, if given, are their largest number, after which another refinement continues.
        """
        shrink = coverage.views[0].shrink
        steps = Steps.of(self._config.refine.outline, shrink, iterations)
        by_differences = self._config.refine.derivatives == "differences"
        at = Posed.stacked([mode.at for mode in modes])
        fits = refine(coverage, self._terms, at, steps, selection, "differences" if by_differences else "closed-form")
        return _not_diverged(fits)

    def refine(self, candidates: Sequence[PoseCandidate]) -> tuple[list[Fit], list[Rotation]]:
        """Refine what a search found in small images, and the best of it at full size; best modes first.

        They include the mirror twins of all of them if the instrument has such. Also returns the rotation by which each
        view but the first would turn at the best mode, as `rotations_of_views`.
        """
        instrument, small = self._decimated.instrument, self._small
        modes: Sequence[PoseCandidate] = best_per_mode(candidates, mirrored=instrument)
        if small > 1:
            refined = self._refine(self._coverage(small), modes, ALL)
            found = best_per_mode(refined, most=_AT_FULL, mirrored=instrument)
            scores, of_outline = zip(*((fit.score, fit.outline_score) for fit in found), strict=True)
            modes = [found[i] for i in _FULL.continuing(scores, of_outline, len(found))]
        finest = self._coverage(1)
        final = self._refine(finest, modes, _FULL, _FULL_STEPS)
        if instrument.has_twin:
            # A twin's outline is as good as that of the mode: these iterations would hardly move it.
            twins = twin_of(instrument, Posed.stacked([mode.at for mode in final]))
            final += assess(finest, self._terms, twins)
        return self._finish(finest, final)

    def _finish(self, finest: Coverage, modes: list[Fit]) -> tuple[list[Fit], list[Rotation]]:
        """Estimate the noise of the outline from the best mode, and refine the modes with the resulting weights."""
        best = min(modes, key=lambda mode: mode.score)
        noises = [view.noise_at(best.at) for view in self._views]
        coverage = finest.changed(correlations=[noise.length for noise in noises])
        # Modes that are clearly worse, by score and by outline score, are not refined again, only scored.
        close = [
            mode
            for mode in modes
            if mode.score < best.score + _CLEARLY_WORSE or mode.outline_score < best.outline_score + _CLEARLY_WORSE / 3
        ]
        far = [mode.at for mode in modes if mode not in close]
        rest = assess(coverage, self._terms, Posed.stacked(far)) if far else []
        narrow = coverage.changed(cauchy=self._config.refine.outline.last_cauchy)
        modes = best_per_mode([*self._refine(narrow, close, _FULL), *rest])
        first, *others = _not_diverged(modes)
        if all(has_correlated_noise(noise) for noise in noises):
            first = self._with_correlated_noise(coverage, first)
        of_views = information_of_views(coverage.views, self._terms, first.at)
        rotations = rotations_of_views(coverage.views, self._terms, first.at, of_views)
        return [replace(first, information=np.sum(of_views, axis=0)), *others], rotations

    def _with_correlated_noise(self, coverage: Coverage, mode: Fit) -> Fit:
        """Return a mode where generalised least squares put it; where it was, if that is clearly worse by its score."""
        (fit,) = refine(CorrelatedContour(coverage.views), self._terms, Posed.stacked([mode.at]), _OF_CONTOUR)
        is_as_good = assess(coverage, self._terms, fit.at[None])[0].score < mode.score + _AS_GOOD
        return replace(mode, at=fit.at) if is_as_good else mode
