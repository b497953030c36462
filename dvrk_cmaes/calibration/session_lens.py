"""What a session tells of the camera file's aspect and lens: fy / fx, and the first radial coefficient."""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np

from dvrk_cmaes.calibration.blocks import CLEAR, FoundBlock, OutlineOfView, SeenBlock, ViewAsSeen
from dvrk_cmaes.calibration.linearise import SHARED_ERRORS
from dvrk_cmaes.camera import Camera
from dvrk_cmaes.camera.lens import COEFFICIENT_COUNTS
from dvrk_cmaes.config import EstimateConfig
from dvrk_cmaes.geometry import Float64
from dvrk_cmaes.pose.camera_errors import PARAMETERS, displacements, file_covariance

LENS: Final = "lens"
"""Name of the block."""

OF_LENS: Final = [PARAMETERS.index("aspect"), PARAMETERS.index("radial")]
_CAUSES: Final = "images that were stretched, --rectified with raw images or left out, or the file of another lens"


class Lens(SeenBlock):
    """The errors (2,) of a camera file: of log (fy / fx), and of the first radial coefficient."""

    is_linear = True

    def __init__(self, config: EstimateConfig, camera: Camera) -> None:
        super().__init__(LENS, np.sqrt(np.diag(file_covariance(camera, config.camera)))[OF_LENS])
        self.axes = ("aspect", "radial")

    def seen(self, name: str, by: ViewAsSeen, values: Float64) -> ViewAsSeen:
        """Return a view with another aspect and radial coefficient."""
        if not values.any():
            return by
        camera, (aspect, radial) = by.camera, values
        first, *others = camera.distortion or (0.0,) * COEFFICIENT_COUNTS[camera.model][-1]
        focal = camera.fx * np.exp(-aspect / 2), camera.fy * np.exp(aspect / 2)
        return replace(by, camera=replace(camera, fx=focal[0], fy=focal[1], distortion=(first + radial, *others)))

    def effect(self, outline: OutlineOfView) -> Float64:
        """Return the displacements of an outline's points by both."""
        camera, pixels = outline.view.camera, outline.points.pixels
        moved = displacements(camera, pixels, camera.normalise(pixels))[:, :, OF_LENS]
        return np.asarray(np.einsum("nk,nkp->np", outline.points.normals, moved))

    def stated(self, values: Float64, std: Float64) -> FoundBlock:
        """State both, and what the frames alone tell of them where that contradicts the file."""
        own = std / SHARED_ERRORS
        gained = np.maximum(own**-2 - self.std**-2, 1e-12)
        alone, spread = values / own**2 / gained, SHARED_ERRORS / np.sqrt(gained)
        off = np.abs(alone) / np.hypot(spread, self.std)
        texts = [
            f"fy / fx {100 * alone[0]:+z.1f} % (std {100 * spread[0]:.1f}) off",
            f"a radial coefficient {alone[1]:+z.2f} (std {spread[1]:.2f}) off",
        ]
        told = [text for text, far in zip(texts, off, strict=True) if far > CLEAR]
        doubt = f"the camera file is contradicted: these frames fit {' and '.join(told)}; likely causes: {_CAUSES}"
        stated = f"lens: fy / fx {100 * values[0]:+z.2f} % (std {100 * std[0]:.2f}), radial {values[1]:+z.3f}"
        each = (tuple(one.tolist()) for one in (values, std, self.std))
        given, known, file = each
        return FoundBlock(self.axes, given, known, file, f"{stated} (std {std[1]:.3f})", doubt if told else "")
