"""Segmentation of the instrument in an image.

`segment` returns a mask, with or without prompts (a box around the instrument, points on it, points beside it). It uses
one of two models: ``classic`` uses colours and edges and needs no weights; ``sam2`` runs an exported checkpoint of
Segment Anything 2.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.errors import InputError, nearest_first
from dvrk_cmaes.segment.segmentation import MODELS, Box, Model, Pixel, Segmentation, check_prompts

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

    Raises
    ------
    InputError
        Prompts outside the image, an unknown model, ``sam2`` without weights or ``classic`` with weights.
    """
    image = np.asarray(image)
    check_prompts(image, box, points, not_points)
    if model == "classic":
        if weights is not None:
            raise InputError("weights: the classic model has none; expected them only with model sam2")
        from dvrk_cmaes.segment.classic import segment_classic

        return segment_classic(image, box=box, points=points, not_points=not_points)
    if model == "sam2":
        if weights is None:
            raise InputError("weights: model sam2 needs the folder of an exported checkpoint")
        from dvrk_cmaes.segment.sam2 import segment_sam2

        return segment_sam2(image, Path(weights), threads, box=box, points=points, not_points=not_points)
    raise InputError(f"model: expected one of {', '.join(nearest_first(str(model), MODELS))}, got {model!r}")
