"""What passes before the instrument in a synthetic recording: another shaft, and tissue over the tips."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Literal

import numpy as np

from dvrk_cmaes.camera import Camera
from dvrk_cmaes.geometry import Bool
from dvrk_cmaes.synth.masks import tissue_region
from dvrk_cmaes.synth.truth import Truth

_SHAFT_PASSES: Final = (0.3, 0.42)  # shares of the recording between which another shaft passes
_TISSUE_COVERS: Final = (0.78, 0.86)  # between which tissue covers the tips
_SHAFT_WIDTH: Final = 0.044  # of the image's width, half that of the other shaft
_SHAFT_DEPTH: Final = 0.06  # m
_TISSUE: Final = 34.0  # px at 640 x 480, radius


@dataclass(frozen=True, eq=False)
class Occluder:
    """What is before the instrument in a frame, and the pixels (H, W) that it covers."""

    kind: Literal["shaft", "tissue"]
    region: Bool


def passing_occluder(
    camera: Camera, truth: Truth, share: float, rng: np.random.Generator, baseline: float = 0.0
) -> Occluder | None:
    """Draw what passes before the instrument at a share of the recording, 0 to 1; None if nothing does.

    ``baseline`` m is how far the camera is to the right of the first one, from which the other shaft appears farther to
    the left.
    """
    shape = (camera.height, camera.width)
    begin, end = _SHAFT_PASSES
    if begin < share < end:
        v, u = np.mgrid[: shape[0], : shape[1]]
        u = u + camera.fx * baseline / _SHAFT_DEPTH
        along = (u - shape[1] / 2) * np.cos(0.5) + (v - shape[0] / 2) * np.sin(0.5)
        place = ((share - begin) / (end - begin) - 0.5) * 1.4 * shape[1]
        return Occluder("shaft", np.asarray(np.abs(along - place) < _SHAFT_WIDTH * shape[1]))
    begin, end = _TISSUE_COVERS
    if begin < share < end and (truth.tips[:, 2] > 0).all():
        centre = camera.project(truth.tips).mean(axis=0)
        return Occluder("tissue", tissue_region(shape, rng, centre, _TISSUE * shape[1] / 640))
    return None
