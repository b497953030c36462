"""Segmentation of the instrument in an image.

`segment` returns a mask, with or without prompts (a box around the instrument, points on it, points beside it). It uses
one of two models: ``classic`` uses colours and edges and needs no weights; ``sam2`` runs an exported checkpoint of
Segment Anything 2.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.errors import InputError, nearest_first
from dvrk_cmaes.segment.segmentation import (
    MODELS,
    Background,
    Box,
    Model,
    Pixel,
    Segmentation,
    check_background,
    check_prompts,
)

__all__ = ["MODELS", "Box", "Model", "Pixel", "Segmentation", "segment"]


def segment(
    image: NDArray[np.uint8],
    *,
    box: Box | None = None,
    points: Sequence[Pixel] = (),
    not_points: Sequence[Pixel] = (),
    model: Model = "classic",
    weights: str | Path | None = None,
    threads: int = 2,
    background: NDArray[np.uint8] | None = None,
) -> Segmentation:
    """Segment the instrument in an image.

    Parameters
    ----------
    image
        (H, W, 3) uint8, BGR.
    box
        Left, top, right, bottom of a box around the instrument, px.
    points, not_points
        Pixels (u, v) on the instrument, and pixels that are not.
    model
        ``classic`` or ``sam2``.
    weights
        Folder of a checkpoint's exported files, for ``sam2``.
    threads
        Number of threads of ``sam2``; ``classic`` uses the threads of OpenCV.
    background
        (h, w, 3) uint8, BGR, of any size: what the camera sees without the instrument, for ``classic``. Without, it is
        taken for a smooth surface, as of paper, where the colours alone give a guess.

    Raises
    ------
    InputError
        Prompts outside the image, a background of another shape, an unknown model, ``sam2`` without weights or
        ``classic`` with weights.
    """
    image = np.asarray(image)
    check_prompts(image, box, points, not_points)
    if background is not None:
        check_background(background)
    if model == "classic":
        if weights is not None:
            raise InputError("weights: the classic model has none; expected them only with model sam2")
        from dvrk_cmaes.silhouette.threads import single_blas_thread

        with single_blas_thread():
            return _segment_classic(image, background, box=box, points=points, not_points=not_points)
    if model == "sam2":
        if weights is None:
            raise InputError("weights: model sam2 needs the folder of an exported checkpoint")
        from dvrk_cmaes.segment.sam2 import segment_sam2

        return segment_sam2(image, Path(weights), threads, box=box, points=points, not_points=not_points)
    raise InputError(f"model: expected one of {', '.join(nearest_first(str(model), MODELS))}, got {model!r}")


def _segment_classic(
    image: NDArray[np.uint8],
    background: NDArray[np.uint8] | None,
    *,
    box: Box | None,
    points: Sequence[Pixel],
    not_points: Sequence[Pixel],
) -> Segmentation:
    """Segment by a background, if one is known, or else by colours; where that gives a guess, by the other one."""
    from dvrk_cmaes.frames.field_of_view import outside_view
    from dvrk_cmaes.segment.background import segment_before, smooth_background
    from dvrk_cmaes.segment.classic import segment_classic
    from dvrk_cmaes.segment.confidence import GUESS
    from dvrk_cmaes.segment.prompts import draw_prompts

    def before(behind: NDArray[np.uint8], kind: Background) -> Segmentation:
        prompts = draw_prompts(image.shape, 1.0, box, points, not_points).with_outside(outside_view(image))
        return replace(segment_before(image, behind, prompts), before=kind)

    known = None if background is None else before(background, "learned background")
    if known is not None and known.confidence >= GUESS:
        return known
    found = segment_classic(image, box=box, points=points, not_points=not_points)
    if found.confidence >= GUESS:
        return found
    smooth = smooth_background(image)
    others = [known, None if smooth is None else before(smooth, "smooth background")]
    return max([found, *(other for other in others if other is not None)], key=lambda each: each.confidence)
