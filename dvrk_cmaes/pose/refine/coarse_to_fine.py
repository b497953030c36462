"""Coarse-to-fine refinement of the candidates of the global search to a few modes, including the mirror twin."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.config import EstimateConfig
from dvrk_cmaes.evidence.gather import Evidence
from dvrk_cmaes.evidence.outline_noise import OutlineNoise, measure_noise
from dvrk_cmaes.geometry import moved, rotation_angle
from dvrk_cmaes.instrument import Instrument
from dvrk_cmaes.joints.prior import Readings
from dvrk_cmaes.pose.refine.correlated_noise import fit_correlated, has_correlated_noise
from dvrk_cmaes.pose.refine.direct import refine_direct
from dvrk_cmaes.pose.refine.information import pose_information
from dvrk_cmaes.pose.refine.outline import OutlineFit, OutlineRefiner
from dvrk_cmaes.pose.refine.selection import ALL, Selection
from dvrk_cmaes.pose.search.global_search import Candidate, scale_of_change
from dvrk_cmaes.pose.search.modes import HasPose, are_distinct, best_per_mode
from dvrk_cmaes.pose.search.objective import Objective
from dvrk_cmaes.silhouette import Renderer

Float64 = NDArray[np.float64]

_TWIN_ANGLE = np.deg2rad(40)  # between a mode and the mirror twin of another that count as the same
_CLEARLY_WORSE = 15.0  # difference of the negative log-likelihood
_AS_GOOD = 3.0  # difference of the negative log-likelihood
_AGREEING = 2  # candidates that have reached the same mode, which suffice if no other mode is nearly as good
_TWINS = 3  # best candidates whose mirror twins are refined as well


def is_twin(instrument: Instrument, a: HasPose, b: HasPose) -> bool:
    """Return whether two modes are mirror twins of each other."""
    pose, _ = instrument.twin(a.camera_from_root, a.joints)
    return bool(rotation_angle(pose, b.camera_from_root) < _TWIN_ANGLE)


def _stacked(modes: Sequence[HasPose]) -> tuple[Float64, Float64]:
    """Stack the poses (C, 4, 4) and joints (C, J) of modes."""
    return np.stack([mode.camera_from_root for mode in modes]), np.stack([mode.joints for mode in modes])


def _agree(modes: Sequence[OutlineFit], gap: float) -> bool:
    """Return whether several poses have reached the best one's mode, and no other mode is nearly as good.

    Another mode is nearly as good if its score is worse by less than ``gap``, or its outline alone is better. Where
    both outlines are as good as the noise allows, the readings decide.
    """
    best = min(modes, key=lambda mode: mode.score)
    others = [mode for mode in modes if are_distinct(mode, best)]
    return len(modes) - len(others) >= _AGREEING and all(
        mode.score > best.score + gap and mode.outline_score >= best.outline_score for mode in others
    )


class Refiner(Protocol):
    """Refines poses on the masks of one frame, and counts the silhouettes rendered and the rays traced."""

    @property
    def silhouettes(self) -> int:
        """Number of silhouettes rendered so far."""

    @property
    def rays(self) -> int:
        """Number of rays traced so far."""

    def assess(self, pose: Float64, joints: Float64) -> OutlineFit:
        """Score one pose (4, 4) and its joints (J,) without refining them."""

    def refine_all(
        self,
        poses: Float64,
        joints: Float64,
        *,
        iterations: int | None = None,
        cauchy: float | None = None,
        selection: Selection = ALL,
    ) -> list[OutlineFit]:
        """Refine poses (C, 4, 4) and their joints (C, J); arguments as in `OutlineRefiner`."""


class LocalSearch:
    """Refines modes of one frame, and counts the silhouettes rendered and the rays traced.

    ``renderer`` renders the instrument at full detail, ``coarse`` a decimated one for small images.
    """

    def __init__(
        self,
        renderer: Renderer,
        coarse: Renderer,
        evidence: Evidence,
        readings: Readings,
        config: EstimateConfig,
    ) -> None:
        self._renderer = renderer
        self._coarse = coarse
        self._evidence = evidence
        self._readings = readings
        self._config = config
        self._last_selection = Selection(config.refine.last_share, config.refine.last_gap)
        self.silhouettes = 0
        self.rays = 0

    def _refiner(self, shrink: int, *, correlation: float | None = None) -> Refiner:
        outline = self._config.refine.outline
        if correlation is not None:
            outline = replace(outline, correlation=correlation)
        if shrink > 1:
            outline = replace(outline, cauchy=outline.small_cauchy)
        renderer = self._coarse if shrink > 2 else self._renderer
        return OutlineRefiner(renderer, self._evidence, self._readings, outline, shrink=shrink)

    def _refine(
        self,
        refiner: Refiner,
        modes: Sequence[HasPose],
        *,
        cauchy: float | None = None,
        iterations: int | None = None,
        selection: Selection = ALL,
    ) -> list[OutlineFit]:
        before = refiner.silhouettes, refiner.rays
        fits = []
        if modes:
            fits = refiner.refine_all(*_stacked(modes), cauchy=cauchy, iterations=iterations, selection=selection)
        self.silhouettes += refiner.silhouettes - before[0]
        self.rays += refiner.rays - before[1]
        return fits

    def _twin(self, mode: HasPose) -> Candidate:
        return Candidate(*self._renderer.body.instrument.twin(mode.camera_from_root, mode.joints), mode.score)

    def _missing_twin(self, best: HasPose, others: Sequence[HasPose]) -> list[Candidate]:
        """Return the best mode's mirror twin in a list, which is empty if there is none or the others include it."""
        instrument = self._renderer.body.instrument
        if not instrument.has_twin or any(is_twin(instrument, best, other) for other in others):
            return []
        return [self._twin(best)]

    def refine(self, candidates: Sequence[Candidate]) -> list[OutlineFit]:
        """Refine candidates at increasing image sizes; returns the remaining modes, the best first.

        They include the mirror twin of the best mode if the instrument has one.
        """
        config, instrument = self._config, self._renderer.body.instrument
        full_width = self._evidence.camera.width
        coarse = self._refiner(max(1, round(full_width / config.refine.width_px)))
        twins = [self._twin(candidate) for candidate in candidates[:_TWINS]] if instrument.has_twin else []
        c = config.refine
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
            modes = best_per_mode(self._refine(self._refiner(2), modes, selection=self._last_selection))
        finest = self._refiner(1)
        final = self._finest(finest, modes[: c.modes])
        best = min(final, key=lambda m: m.score)
        if missing := self._missing_twin(best, final):
            final += self._finest(finest, missing)
        return self._finish(final)

    def _finish(self, modes: list[OutlineFit]) -> list[OutlineFit]:
        """Estimate the noise of the outline from the best mode, and refine the modes with the resulting weights."""
        best = min(modes, key=lambda m: m.score)
        noises = self._noises(best)
        refiner = self._last_refiner(noises)
        # Modes that are clearly worse, by score and by outline score, are not refined again, only scored.
        close = [
            mode
            for mode in modes
            if mode.score < best.score + _CLEARLY_WORSE or mode.outline_score < best.outline_score + _CLEARLY_WORSE / 3
        ]
        rest = [refiner.assess(mode.camera_from_root, mode.joints) for mode in modes if mode not in close]
        modes = best_per_mode([*self._last(refiner, close), *rest])
        if missing := self._missing_twin(modes[0], modes[1:]):
            modes = best_per_mode([*modes, *self._last(refiner, missing)])
        first, *others = modes
        if self._config.refine.method == "gauss-newton":
            fitted = self._fit_correlated(refiner, noises, first)
            if fitted is not None and fitted.score < first.score + _AS_GOOD:
                first = replace(first, camera_from_root=fitted.camera_from_root, joints=fitted.joints)
        return [replace(first, information=self._information(refiner, first)), *others]

    def _noises(self, mode: HasPose) -> tuple[OutlineNoise, ...]:
        """Estimate the noise of each mask's contour from its distances to the silhouette of a mode."""
        silhouette = self._renderer.masks(mode.camera_from_root[None], mode.joints[None])[0]
        return (measure_noise(self._evidence.contour, silhouette),)

    def _last_refiner(self, noises: Sequence[OutlineNoise]) -> Refiner:
        """Return the refiner at full image size with the weights that follow from the contours' noise."""
        return self._refiner(1, correlation=noises[0].length)

    def _fit_correlated(self, refiner: Refiner, noises: Sequence[OutlineNoise], mode: OutlineFit) -> OutlineFit | None:
        """Refine a mode by generalised least squares; None where the contours' noise is not of that kind."""
        if not isinstance(refiner, OutlineRefiner) or not has_correlated_noise(noises[0]):
            return None
        return refiner.assess(*fit_correlated(refiner, mode.camera_from_root, mode.joints))

    def _information(self, refiner: Refiner, mode: OutlineFit) -> Float64:
        """Compute the information (6 + J, 6 + J) about the small changes of a refined mode."""
        assert isinstance(refiner, OutlineRefiner)
        return pose_information(refiner, mode, self._noises(mode)[0])

    def _last(self, refiner: Refiner, modes: Sequence[HasPose]) -> list[OutlineFit]:
        """Refine modes by the last Gauss-Newton iterations; with any other method they are only scored."""
        if self._config.refine.method == "gauss-newton":
            config = self._config.refine
            return self._refine(refiner, modes, cauchy=config.outline.last_cauchy, selection=self._last_selection)
        return [refiner.assess(mode.camera_from_root, mode.joints) for mode in modes]

    def _finest(self, refiner: Refiner, modes: Sequence[HasPose]) -> list[OutlineFit]:
        """Refine modes at full image size by the chosen method."""
        config = self._config
        if config.refine.method == "gauss-newton":
            return self._refine(refiner, modes, iterations=config.refine.full_steps, selection=self._last_selection)
        objective = self._objective()
        scale = 0.3 * scale_of_change(self._readings)
        fits = []
        for mode in modes:

            def loss(change: Float64, mode: HasPose = mode) -> Float64:
                step = change * scale
                return objective(moved(mode.camera_from_root, step[:, :6]), mode.joints + step[:, 6:])

            change, _, count = refine_direct(
                config.refine.method, loss, len(scale), config.refine.evaluations, config.seed
            )
            step = change * scale
            fits.append(refiner.assess(moved(mode.camera_from_root, step[:6]), mode.joints + step[6:]))
            self.silhouettes += count
        return fits

    def _objective(self) -> Callable[[Float64, Float64], Float64]:
        """Return the loss (C,) of poses (C, 4, 4) and joints (C, J) at full image size."""
        config = self._config
        return Objective(
            self._renderer,
            self._evidence,
            self._readings,
            config.weights,
            decay=config.decay_px,
            field=config.distance_field,
        )
