"""The instrument in an image, when it is known which instrument: its own shape is the strongest prior.

As region-based trackers do: a first pose is fitted to a first mask; the image's colours are learned anew just inside
and just outside of that pose's silhouette, and the image is cut again, held to the silhouette but for what its colours
say clearly. And once more from there.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.camera import Camera
from dvrk_cmaes.config import EstimateConfig
from dvrk_cmaes.errors import DvrkCmaesError
from dvrk_cmaes.estimation import estimate
from dvrk_cmaes.evidence.outline_noise import signed_distance
from dvrk_cmaes.results.result import Result
from dvrk_cmaes.segment import Box, Model, Pixel, Segmentation, segment
from dvrk_cmaes.segment.classic import refine_outline
from dvrk_cmaes.segment.field_of_view import outside_view
from dvrk_cmaes.segment.prompts import draw_prompts
from dvrk_cmaes.silhouette import Body, Renderer

Bool = NDArray[np.bool_]
Float32 = NDArray[np.float32]

_ROUNDS = 2
_LEAST_OVERLAP = 0.8  # of a silhouette with the mask that it was fitted to, for it to say more than the mask
_SLACK = 3.0  # px either side of the silhouette's outline, where the image alone decides
_STEEPNESS = 0.5  # log-odds a px beyond that
_LARGEST = 3.0  # log-odds


@dataclass(frozen=True)
class SegmentSettings:
    """How a frame without a mask gets one: the model, and the folder of its weights where it has any."""

    model: Model = "classic"
    weights: Path | None = None


@dataclass(frozen=True)
class Hints:
    """What somebody said of where the instrument is, in pixels of the image; see `dvrk_cmaes.segment.segment`."""

    box: Box | None = None
    points: Sequence[Pixel] = ()
    not_points: Sequence[Pixel] = ()


@dataclass(frozen=True, eq=False)
class Segmenter:
    """Finds masks of one instrument; what a frame without a mask is handed to."""

    body: Body
    config: EstimateConfig
    settings: SegmentSettings = SegmentSettings()
    hints: Hints = Hints()

    def __call__(
        self,
        image: NDArray[np.uint8],
        camera: Camera,
        joints: Mapping[str, float],
        ignore: Bool | None = None,
    ) -> Segmentation:
        """Find the instrument in an image (H, W, 3) BGR of the camera's size; as `segment_with_instrument`."""
        return segment_with_instrument(
            image,
            camera,
            joints,
            self.body,
            ignore=ignore,
            config=self.config,
            settings=self.settings,
            hints=self.hints,
        )


def segment_with_instrument(
    image: NDArray[np.uint8],
    camera: Camera,
    joints: Mapping[str, float] | None,
    body: Body,
    *,
    ignore: Bool | None = None,
    config: EstimateConfig | None = None,
    settings: SegmentSettings | None = None,
    hints: Hints | None = None,
) -> Segmentation:
    """Find a known instrument in an image, with or without prompts.

    Parameters
    ----------
    image
        (H, W, 3) uint8, BGR, of the camera's size.
    camera, joints, body, ignore, config
        As in `estimate`.
    settings
        The model that finds the first mask; a learned one's outline is kept as it is.
    hints
        Where the instrument is.

    Returns
    -------
    Segmentation
        The first note says which model found it and how far it is trusted.

    Raises
    ------
    InputError
        As `estimate` and `segment`.
    DvrkCmaesError
        Nothing was found that could be the instrument.
    """
    settings, hints = settings or SegmentSettings(), hints or Hints()
    threads = (config or EstimateConfig()).threads
    found = segment(
        image,
        box=hints.box,
        points=hints.points,
        not_points=hints.not_points,
        model=settings.model,
        weights=settings.weights,
        threads=threads,
    )
    if not found.mask.any() or (ignore is not None and not (found.mask & ~ignore).any()):
        raise DvrkCmaesError("no instrument found in the image; a mask, a box or a point on the instrument would help")
    if settings.model == "classic":
        prompts = draw_prompts(image.shape, 1.0, hints.box, hints.points, hints.not_points)
        prompts = prompts.seen(outside_view(image))
        for _ in range(_ROUNDS):
            pose = estimate(found.mask, camera, joints, body, ignore=ignore, config=config)
            silhouette = drawn(pose, camera, body)
            if _overlap(silhouette, found.mask, ignore) < _LEAST_OVERLAP:
                break
            again = refine_outline(image, silhouette, prompts, _odds(silhouette))
            if not again.mask.any():
                break
            found = again
    how = f"mask found in the image by the {settings.model} model, confidence {found.confidence:.2f}"
    return replace(found, notes=(how, *found.notes))


def drawn(pose: Result, camera: Camera, body: Body) -> Bool:
    """Silhouette of a pose that was found, (H, W)."""
    if pose.camera_from_root is None:
        return np.zeros((camera.height, camera.width), np.bool_)
    joints = np.array([pose.joints[name] for name in body.instrument.joint_names])
    return np.asarray(Renderer(body, camera, threads=1).masks(pose.camera_from_root[None], joints[None])[0])


def _odds(silhouette: Bool) -> Float32:
    """Log-odds of instrument (H, W) that a silhouette stands for."""
    away = signed_distance(silhouette)
    beyond = np.sign(away) * np.maximum(np.abs(away) - _SLACK, 0)
    return np.asarray(np.clip(-_STEEPNESS * beyond, -_LARGEST, _LARGEST), np.float32)


def _overlap(silhouette: Bool, mask: Bool, ignore: Bool | None) -> float:
    """Intersection over union of a silhouette and a mask, where pixels count; 0 for one that says nothing."""
    if silhouette.all() or not silhouette.any():
        return 0.0
    counts = np.ones_like(mask) if ignore is None else ~ignore
    return float((silhouette & mask & counts).sum() / max(((silhouette | mask) & counts).sum(), 1))
