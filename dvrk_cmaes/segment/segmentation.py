"""Result, settings and prompts of a segmentation, and the check of an image and its prompts; common to all models."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.errors import InputError
from dvrk_cmaes.frames.keypoints import Hints as Hints
from dvrk_cmaes.io.arguments import described

Pixel = tuple[float, float]
Box = tuple[float, float, float, float]
Model = Literal["classic", "sam2"]
Background = Literal["learned background", "smooth background"]
MODELS: tuple[Model, ...] = get_args(Model)
GUESS = 0.5
"""Confidence below which a mask is called a guess."""


@dataclass(frozen=True, eq=False)
class Segmentation:
    """Mask of the instrument in an image, with a confidence.

    mask : (H, W) bool, True on the instrument.
    score : (H, W) float32, probability of instrument at each pixel, 0 to 1; None if there is none.
    confidence : 0 to 1; below 0.5, the mask is called a guess.
    notes : messages for the user about the mask.
    before : the background that the instrument was segmented against, if there was one.
    others : masks of further instruments in the image, if these were looked for; the surest one first.
    """

    mask: NDArray[np.bool_]
    score: NDArray[np.float32] | None = None
    confidence: float = 1.0
    notes: tuple[str, ...] = field(default=())
    before: Background | None = None
    others: tuple[Segmentation, ...] = ()


def noted(found: Segmentation) -> Segmentation:
    """Return a segmentation that says if it is a guess."""
    stated = found.confidence >= GUESS or "a guess" in found.notes
    return found if stated else replace(found, notes=("a guess", *found.notes))


@dataclass(frozen=True)
class SegmentSettings:
    """How masks are found in images: the model, and the folder of its weights if it has any.

    ``backgrounds`` are those before which the instrument moves, (h, w, 3) uint8 BGR by name of the view, "" for the
    only one; of views without one, masks are found in each image by itself. ``notes`` state which were learned, or why
    there is none.
    """

    model: Model = "classic"
    weights: Path | None = None
    backgrounds: Mapping[str, NDArray[np.uint8]] = field(default_factory=dict, compare=False)
    notes: tuple[str, ...] = field(default=(), compare=False)


def hints_within(hints: Hints, crop: tuple[int, int, int, int] | None) -> Hints:
    """Return prompts in pixels of a part of the image: left, top, width and height, px; None for all of it."""
    if crop is None:
        return hints
    left, top, *_ = crop
    box = hints.box and (hints.box[0] - left, hints.box[1] - top, hints.box[2] - left, hints.box[3] - top)
    points, not_points = ([(u - left, v - top) for u, v in each] for each in (hints.points, hints.not_points))
    return Hints(box, points, not_points)


def check_background(background: NDArray[np.uint8]) -> None:
    """Raise InputError for a background that is not (h, w, 3) uint8."""
    if not (isinstance(background, np.ndarray) and background.dtype == np.uint8 and background.size):
        raise InputError(f"background: expected (h, w, 3) uint8, got {described(background)}")
    if background.ndim != 3 or background.shape[2] != 3:
        raise InputError(f"background: expected (h, w, 3) uint8, got {background.shape} {background.dtype}")


def check_prompts(
    image: NDArray[np.uint8], box: Box | None, points: Sequence[Pixel], not_points: Sequence[Pixel]
) -> None:
    """Raise InputError for an image that is not a colour image, or for prompts outside it.

    Parameters
    ----------
    image
        (H, W, 3) uint8, BGR.
    box
        Left, top, right, bottom in pixels, or None.
    points, not_points
        Pixels (u, v) on the instrument and off it.

    Raises
    ------
    InputError
        An array that is not (H, W, 3) uint8, a point outside the image, a box that is empty or outside the image.
    """
    if image.ndim != 3 or image.shape[2] != 3 or image.dtype != np.uint8 or not image.size:
        raise InputError(f"image: expected (H, W, 3) uint8, got {image.shape} {image.dtype}")
    height, width = image.shape[:2]
    size = f"the {width} x {height} image"
    for name, pixels in (("point", points), ("not-point", not_points)):
        for u, v in pixels:
            if not (math.isfinite(u) and math.isfinite(v) and -0.5 <= u < width - 0.5 and -0.5 <= v < height - 0.5):
                raise InputError(f"{name}: expected a pixel of {size}, got {u:g},{v:g}")
    if box is None:
        return
    left, top, right, bottom = box
    if not all(math.isfinite(value) for value in box) or right <= left or bottom <= top:
        raise InputError(
            f"box: expected x0,y0,x1,y1 with x0 < x1 and y0 < y1, got {','.join(f'{value:g}' for value in box)}"
        )
    if left >= width - 0.5 or top >= height - 0.5 or right < -0.5 or bottom < -0.5:
        raise InputError(f"box: expected one that meets {size}, got {','.join(f'{value:g}' for value in box)}")
