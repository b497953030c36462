"""Refinement of the modes that the global search found, with their mirror twins, and the check of a rig at the best.

Modes are refined at a small and at the full size. The check is how far each further view of a rig would turn, if the
masks alone decided.

At the pose that fits all views together, the distances of one view's contour from the outline show where that view
alone would have the instrument. A small rotation w of the view about the reference camera moves the instrument in
that view only, so w is estimated together with the pose. A wrong baseline looks like a rotation as well: at the
distance z, an error e of the baseline is a rotation by e / z.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from dvrk_cmaes.camera.rig import turned_place
from dvrk_cmaes.config import EstimateConfig
from dvrk_cmaes.geometry import Float64, Posed, adjoint, inverse
from dvrk_cmaes.joints.prior import Readings
from dvrk_cmaes.pose.refine.gauss_newton import Fit, Steps, assess, refine
from dvrk_cmaes.pose.refine.information import ALL, Selection, eliminate, information_of_views
from dvrk_cmaes.pose.search.starts import PoseCandidate, best_per_mode, is_twin, twin_of
from dvrk_cmaes.pose.terms.coverage import CorrelatedContour, Coverage, contour_errors, has_correlated_noise
from dvrk_cmaes.pose.terms.sized_view import SizedView
from dvrk_cmaes.pose.terms.term import Quadratic, Term, sum_of_locals
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
        """The divisor of the small size, at which the mask is still large enough to distinguish modes."""
        mask = self._views[0].evidence.mask
        legible = int(np.sqrt(np.count_nonzero(mask) / _LEAST_AREA))
        return max(1, min(int(mask.shape[1] / self._config.refine.width_px + 0.5), legible))

    def _coverage(self, shrink: int) -> Coverage:
        """Return the coverage of all views at 1 / ``shrink`` of the main one's size."""
        outline, width = self._config.refine.outline, self._views[0].evidence.camera.width
        if shrink > 1:  # where modes only need to be distinguished
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
            # A twin's outline is nearly as good as that of the mode: only that of the best is refined, in `_finish`.
            twins = twin_of(instrument, Posed.stacked([mode.at for mode in final]))
            final += assess(finest, self._terms, twins)
        return self._finish(finest, final)

    def _finish(self, finest: Coverage, modes: list[Fit]) -> tuple[list[Fit], list[Rotation]]:
        """Estimate the noise of the outline from the best mode, and refine the modes with the resulting weights."""
        best = min(modes, key=lambda mode: mode.score)
        noises = [view.noise_at(best.at) for view in self._views]
        coverage = finest.changed(correlations=[noise.length for noise in noises])
        # Modes that are clearly worse, by score and by outline score, are not refined again, only scored. The twin of
        # the best is, unless the readings decide: its minimum is near the mirror image only, which by an exact mask may
        # be clearly worse.
        instrument, by_readings = self._decimated.instrument, best.score - best.outline_score + _CLEARLY_WORSE
        close = [
            mode
            for mode in modes
            if mode.score < best.score + _CLEARLY_WORSE
            or mode.outline_score < best.outline_score + _CLEARLY_WORSE / 3
            or (
                instrument.has_twin
                and mode.score - mode.outline_score < by_readings
                and is_twin(instrument, best.at, mode.at)
            )
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


Rotation = tuple[Float64, Float64]
"""Rotation (3,), rad, of a view about the reference camera's axes, and its covariance (3, 3)."""

_REACH = 24  # px, in which the contour is searched
_UNKNOWN = np.pi**2  # variance of a rotation, rad^2, where a contour is out of reach
_STEPS = 16
_TOLERANCE = 0.05  # length of a step, in standard deviations per parameter, below which a fit stops
_LIKELY = 2.0  # standard deviations of a rotation, up to which the views may agree ...
_LARGEST_LIKELY = np.deg2rad(0.25)  # ... unless the rotation is larger than this


def rotations_of_views(
    views: Sequence[SizedView], terms: Sequence[Term], at: Posed, informations: Sequence[Float64]
) -> list[Rotation]:
    """Fit the rotation of each view but the first together with the pose.

    ``informations`` (6 + J, 6 + J) are those of the views at the pose, as by `information_of_views`. One step suffices
    for views that agree within the errors. Others are turned and fitted further, because the errors of the contours can
    only be found from the disagreement of the views once that is removed.
    """
    if len(views) == 1:
        return []
    turns = np.zeros((len(views) - 1, 3))
    if not all(information.any() for information, _, _ in _contours(views, turns, at)):
        return [(turn, _UNKNOWN * np.eye(3)) for turn in turns]
    settled, turns = _fitted(views, terms, at, turns, 1)
    rotations = _with_covariances(turns, at, informations)
    if not any(_disagrees(*rotation) for rotation in rotations):
        return rotations
    settled, turns = _fitted(views, terms, settled, turns, _STEPS)
    return _with_covariances(turns, settled, information_of_views(_placed(views, turns), terms, settled))


def _placed(views: Sequence[SizedView], turns: Float64) -> list[SizedView]:
    """Return the views, of which all but the first are turned."""
    pairs = zip(views[1:], turns, strict=True)
    return [views[0], *(view.placed(turned_place(view.view.view_from_camera, turn)) for view, turn in pairs)]


def _contours(views: Sequence[SizedView], turns: Float64, at: Posed) -> list[tuple[Float64, Float64, Float64]]:
    """Compare the outlines of one pose with the contours in the turned views, as `SizedView.contours`."""
    errors = contour_errors(_REACH)
    return [view.contours(at[None], errors) for view in _placed(views, turns)]


def _fitted(
    views: Sequence[SizedView], terms: Sequence[Term], at: Posed, turns: Float64, steps: int
) -> tuple[Posed, Float64]:
    """Fit the rotations of the views but the first together with the pose, by some steps of Gauss-Newton."""
    own = 6 + len(at.joints)
    for _ in range(steps):
        others = sum_of_locals(terms, at[None])
        information, slope = np.zeros((own + turns.size, own + turns.size)), np.zeros(own + turns.size)
        information[:own, :own], slope[:own] = others.information[0], others.slope[0]
        for k, (of_view, slope_of_view, _) in enumerate(_contours(views, turns, at)):
            columns = np.eye(own, own + turns.size)
            if k > 0:
                columns[:, own + 3 * (k - 1) : own + 3 * k] = _by_rotation(at)
            information += columns.T @ of_view[0] @ columns
            slope += columns.T @ slope_of_view[0]
        step = -np.asarray(np.linalg.solve(_invertible(information), slope), dtype=np.float64)
        at, turns = at.moved(step[:own]), turns + step[own:].reshape(-1, 3)
        for term in terms:
            at = term.allowed(at)
        if step @ information @ step < _TOLERANCE**2 * len(step):
            break
    return at, turns


def _with_covariances(turns: Float64, at: Posed, informations: Sequence[Float64]) -> list[Rotation]:
    """Return the rotations with their covariances, given the information of each view about the pose ``at``."""
    by_rotation = _by_rotation(at)
    found = []
    for k, turn in enumerate(turns, start=1):
        about = _about_rotation(informations, k, by_rotation)
        in_reach = np.trace(about) > 0  # not where a view was turned so far that its contour is out of reach
        found.append((turn, np.asarray(np.linalg.inv(about)) if in_reach else _UNKNOWN * np.eye(3)))
    return found


def _by_rotation(at: Posed) -> Float64:
    """Return the small changes (6 + J, 3) of one pose in a view by a rotation of the view."""
    columns = np.zeros((6 + len(at.joints), 3))
    columns[:6] = adjoint(inverse(at.pose))[:, 3:]
    return columns


def _about_rotation(informations: Sequence[Float64], view: int, by_rotation: Float64) -> Float64:
    """Return the information (3, 3) about the rotation of one view, with the pose eliminated."""
    of_view, whole = informations[view], _invertible(np.sum(informations, axis=0))
    cross = of_view @ by_rotation
    both = Quadratic.zero(1, len(whole) + 3)
    both.information[0] = np.block([[whole, cross], [cross.T, by_rotation.T @ cross]])
    nothing = np.zeros((1, len(whole)))
    left = eliminate(both, nothing, np.zeros((1, *whole.shape)), np.zeros(3)).left
    reduced = left.information[0, len(whole) :, len(whole) :]
    return np.asarray(reduced + 1e-6 * np.trace(reduced) * np.eye(3))


def _invertible(information: Float64) -> Float64:
    """Return an information with little added, so that it is invertible where a joint is not observable."""
    diagonal = np.diag(information)
    return np.asarray(information + np.diag(1e-9 * diagonal + 1e-12 * max(float(diagonal.max()), 1.0)))


def _disagrees(rotation: Float64, covariance: Float64) -> bool:
    """Return whether a rotation (3,), rad, with its covariance is larger than the errors of the contours explain."""
    significance = float(np.sqrt(rotation @ np.linalg.solve(covariance, rotation)))
    return significance > _LIKELY or float(np.linalg.norm(rotation)) > _LARGEST_LIKELY
