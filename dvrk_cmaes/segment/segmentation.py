"""Result, settings and prompts of a segmentation, and the check of an image and its prompts; common to all models."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.errors import InputError
from dvrk_cmaes.frames.keypoints import Hints as Hints
from dvrk_cmaes.geometry import Float32
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
    confidence : 0 to 1; below 0.5, the mask is called a guess.
    notes : messages for the user about the mask.
    before : the background that the instrument was segmented against, if there was one.
    odds : (h, w), log-odds of instrument by a learned background, of any size.
    others : masks of further instruments in the image, if these were looked for; the surest one first.
    """

    mask: NDArray[np.bool_]
    confidence: float = 1.0
    notes: tuple[str, ...] = field(default=())
    before: Background | None = None
    odds: Float32 | None = None
    others: tuple[Segmentation, ...] = ()


def nothing_found(shape: tuple[int, ...]) -> Segmentation:
    """Return the empty mask of an image of a shape (H, W, ...)."""
    return Segmentation(np.zeros(shape[:2], np.bool_), 0.0, ("no instrument found",))


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


def check_background(background: NDArray[np.uint8]) -> None:
    """Raise InputError for a background that is not (h, w, 3) uint8."""
    if not (isinstance(background, np.ndarray) and background.dtype == np.uint8 and background.size):
        raise InputError(f"background: expected (h, w, 3) uint8, got {described(background)}")
    if background.ndim != 3 or background.shape[2] != 3:
        raise InputError(f"background: expected (h, w, 3) uint8, got {background.shape} {background.dtype}")


def check_prompts(image: NDArray[np.uint8], hints: Hints) -> None:
    """Raise InputError for an image that is not (H, W, 3) uint8, a point outside it, or an empty box or one outside."""
    if image.ndim != 3 or image.shape[2] != 3 or image.dtype != np.uint8 or not image.size:
        raise InputError(f"image: expected (H, W, 3) uint8, got {image.shape} {image.dtype}")
    height, width = image.shape[:2]
    size = f"the {width} x {height} image"
    for name, pixels in (("point", hints.points), ("not-point", hints.not_points)):
        for u, v in pixels:
            if not (math.isfinite(u) and math.isfinite(v) and -0.5 <= u < width - 0.5 and -0.5 <= v < height - 0.5):
                raise InputError(f"{name}: expected a pixel of {size}, got {u:g},{v:g}")
    if hints.box is None:
        return
    left, top, right, bottom = hints.box
    got = ",".join(f"{value:g}" for value in hints.box)
    if not all(math.isfinite(value) for value in hints.box) or right <= left or bottom <= top:
        raise InputError(f"box: expected x0,y0,x1,y1 with x0 < x1 and y0 < y1, got {got}")
    if left >= width - 0.5 or top >= height - 0.5 or right < -0.5 or bottom < -0.5:
        raise InputError(f"box: expected one that meets {size}, got {got}")
