"""Coarse-to-fine refinement of candidate poses on several views of one frame."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.config import EstimateConfig
from dvrk_cmaes.evidence.outline_noise import OutlineNoise, measure_noise
from dvrk_cmaes.geometry import moved
from dvrk_cmaes.joints.prior import Readings
from dvrk_cmaes.pose.refine.coarse_to_fine import LocalSearch, Refiner
from dvrk_cmaes.pose.refine.correlated_noise import fit_correlated, has_correlated_noise
from dvrk_cmaes.pose.refine.information import joint_information
from dvrk_cmaes.pose.refine.joint_refiner import JointRefiner
from dvrk_cmaes.pose.refine.outline import OutlineFit
from dvrk_cmaes.pose.refine.rig_rotation import rig_rotations
from dvrk_cmaes.pose.search.modes import HasPose
from dvrk_cmaes.pose.search.objective import Objective
from dvrk_cmaes.pose.views import FrameView, without_readings
from dvrk_cmaes.silhouette import Body, Renderer

Float64 = NDArray[np.float64]


_ROTATION_STEPS = 4
_SMALL_ROTATION = np.deg2rad(0.04)  # below which the views agree
_LIKELY = 2.0  # standard deviations of a rotation, up to which the views may agree ...
_LARGEST_LIKELY = np.deg2rad(0.25)  # ... unless the rotation is larger than this


class JointSearch(LocalSearch):
    """Refines modes of one frame on all of its views, of which the first is the main one.

    ``decimated`` is the instrument with fewer faces, for small images.
    """

    def __init__(self, views: Sequence[FrameView], decimated: Body, readings: Readings, config: EstimateConfig) -> None:
        main = views[0]
        cameras = [view.evidence.camera for view in views]
        self._coarse_renderers = [Renderer(decimated, camera, threads=config.threads) for camera in cameras]
        super().__init__(main.renderer, self._coarse_renderers[0], main.evidence, readings, config)
        self._views = tuple(views)
        self._rotations: list[tuple[Float64, Float64]] = []
        self._of_view = (readings, *([without_readings(readings)] * (len(views) - 1)))

    def _refiner(self, shrink: int, *, correlation: float | None = None) -> Refiner:
        return self._joint_refiner(shrink, [correlation] * len(self._views))

    def _last_refiner(self, noises: Sequence[OutlineNoise]) -> Refiner:
        return self._joint_refiner(1, [noise.length for noise in noises])

    def _joint_refiner(self, shrink: int, correlations: Sequence[float | None]) -> JointRefiner:
        """Return the refiner of all views at a reduced size; ``correlations`` replace the setting of that name."""
        outline = self._config.refine.outline
        if shrink > 1:
            outline = replace(outline, cauchy=outline.small_cauchy)
        width = self._evidence.camera.width
        widths = [view.evidence.camera.width for view in self._views]
        shrinks = [max(1, round(shrink * own / width)) if shrink > 1 else 1 for own in widths]
        renderers = [
            coarse if own > 2 else view.renderer
            for view, coarse, own in zip(self._views, self._coarse_renderers, shrinks, strict=True)
        ]
        settings = [outline if one is None else replace(outline, correlation=one) for one in correlations]
        return JointRefiner.of_views(self._views, renderers, self._readings, settings, shrinks=shrinks)

    def _noises(self, mode: HasPose, places: Sequence[Float64] = ()) -> tuple[OutlineNoise, ...]:
        """Estimate the noise of each mask; ``places`` are other ``view_from_camera`` (4, 4) than the rig's."""
        found = []
        for view, place in zip(self._views, places or [v.view_from_camera for v in self._views], strict=True):
            pose = place @ mode.camera_from_root
            silhouette = view.renderer.masks(pose[None], mode.joints[None])[0]
            found.append(measure_noise(view.evidence.contour, silhouette))
        return tuple(found)

    def _fit_correlated(self, refiner: Refiner, noises: Sequence[OutlineNoise], mode: OutlineFit) -> OutlineFit | None:
        if not all(has_correlated_noise(noise) for noise in noises):
            return None
        assert isinstance(refiner, JointRefiner)
        (main, _), *others = refiner.views
        return refiner.assess(*fit_correlated(main, mode.camera_from_root, mode.joints, others))

    def _information(self, refiner: Refiner, mode: OutlineFit) -> Float64:
        assert isinstance(refiner, JointRefiner)
        parts = self._parts(refiner, mode)
        self._rotations = self._fitted_rotations(refiner, mode, parts)
        return np.asarray(np.sum(parts, axis=0))

    def _parts(self, refiner: JointRefiner, mode: OutlineFit) -> list[Float64]:
        """Compute the information (6 + J, 6 + J) of each view about the small changes of a mode."""
        fits = [replace(mode, camera_from_root=view @ mode.camera_from_root) for _, view in refiner.views]
        noises = self._noises(mode, [view for _, view in refiner.views])
        return joint_information([each for each, _ in refiner.views], fits, noises)

    def _fitted_rotations(
        self, refiner: JointRefiner, mode: OutlineFit, parts: Sequence[Float64]
    ) -> list[tuple[Float64, Float64]]:
        """Fit the rotation of each further view together with the pose; returns it, rad, and its covariance.

        One step suffices for views that agree within the errors. Others are turned and the pose fitted anew, because
        the errors of the contours can only be told from the disagreement of the views once that is removed.
        """
        found = rig_rotations(refiner, mode, parts)
        total = [rotation for rotation, _ in found]
        if not any(_disagrees(*one) for one in found):
            return found
        for _ in range(_ROTATION_STEPS):
            if max(np.linalg.norm(rotation) for rotation, _ in found) < _SMALL_ROTATION:
                break
            main, *others = refiner.views
            turned = [
                (view, moved(seen, np.r_[np.zeros(3), rotation]))
                for (view, seen), (rotation, _) in zip(others, found, strict=True)
            ]
            refiner = refiner.with_views([main, *turned])
            mode = refiner.refine_all(mode.camera_from_root[None], mode.joints[None])[0]
            found = rig_rotations(refiner, mode, self._parts(refiner, mode))
            total = [before + rotation for before, (rotation, _) in zip(total, found, strict=True)]
        return [(rotation, covariance) for rotation, (_, covariance) in zip(total, found, strict=True)]

    @property
    def rotations(self) -> list[tuple[Float64, Float64]]:
        """Rotation of each view at the best mode and its covariance, as in `rig_rotations`; zero for the first view."""
        return [(np.zeros(3), np.zeros((3, 3))), *self._rotations]

    def _objective(self) -> Callable[[Float64, Float64], Float64]:
        config = self._config
        objectives = [
            Objective(
                view.renderer,
                view.evidence,
                readings,
                config.weights,
                decay=config.decay_px,
                field=config.distance_field,
            )
            for view, readings in zip(self._views, self._of_view, strict=True)
        ]

        def loss(poses: Float64, joints: Float64) -> Float64:
            pairs = zip(objectives, self._views, strict=True)
            return np.asarray(sum(one(view.view_from_camera @ poses, joints) for one, view in pairs))

        return loss


def _disagrees(rotation: Float64, covariance: Float64) -> bool:
    """Return whether a rotation (3,), rad, with its covariance is larger than the errors of the contours explain."""
    significance = float(np.sqrt(rotation @ np.linalg.solve(covariance, rotation)))
    return significance > _LIKELY or float(np.linalg.norm(rotation)) > _LARGEST_LIKELY
