"""Segmentation of the instrument in an image.

`segment` returns a mask, with or without prompts (a box around the instrument, points on it, points off it). It uses
one of two models: ``classic`` needs no weights, and looks for the instrument by its meshes, if it is given, and by
colours and edges; ``sam2`` runs an exported checkpoint of Segment Anything 2.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.errors import InputError, nearest_first
from dvrk_cmaes.geometry import Float32, Posed
from dvrk_cmaes.segment.segmentation import (
    GUESS,
    MODELS,
    Box,
    Hints,
    Model,
    Pixel,
    Segmentation,
    check_background,
    check_prompts,
    nothing_found,
)

if TYPE_CHECKING:
    from dvrk_cmaes.camera import Camera
    from dvrk_cmaes.instrument import Instrument
    from dvrk_cmaes.silhouette import Body

_DIFFERS = 0.3  # share of a mask that differs from a known background, below which it is a guess
_SAME = 0.4  # confidence of such a mask, at most

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
    instrument: Instrument | Body | str | Path | None = None,
    camera: Camera | None = None,
    joints: Mapping[str, float] | None = None,
    expected: Posed | None = None,
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
    instrument
        The instrument, as in `dvrk_cmaes.estimate`: ``classic`` then also looks for its shape, of which no colour needs
        to be known. Without, it uses colours and edges alone.
    camera
        The camera of the image; without, one with the usual angle of view of endoscopes is assumed.
    joints
        Readings of the instrument's joints by name, rad. Any may be missing.
    expected
        Where the instrument is expected: of several candidates ``classic`` takes the nearest one.

    Raises
    ------
    InputError
        Prompts outside the image, a background of another shape, an unknown model, ``sam2`` without weights or
        ``classic`` with weights.
    """
    image = np.asarray(image)
    hints = Hints(box, tuple(points), tuple(not_points))
    check_prompts(image, hints)
    if background is not None:
        check_background(background)

    def classic() -> Segmentation:
        from dvrk_cmaes.silhouette.threads import single_blas_thread

        with single_blas_thread():
            return with_classic(image, background, hints, instrument, camera, joints, expected)

    if model == "classic":
        if weights is not None:
            raise InputError("weights: the classic model has none; expected them only with model sam2")
        return classic()
    if model == "sam2":
        if weights is None:
            raise InputError("weights: model sam2 needs the folder of an exported checkpoint")
        from dvrk_cmaes.segment.sam2 import segment_sam2

        return segment_sam2(image, Path(weights), threads, hints, classic)
    raise InputError(f"model: expected one of {', '.join(nearest_first(str(model), MODELS))}, got {model!r}")


def with_classic(
    image: NDArray[np.uint8],
    background: NDArray[np.uint8] | None,
    hints: Hints,
    instrument: Instrument | Body | str | Path | None,
    camera: Camera | None,
    joints: Mapping[str, float] | None,
    expected: Posed | None,
) -> Segmentation:
    """Segment by a background, if one is known, and by the instrument's shape, colours or a smooth surface.

    A mask by other means than a known background is a guess where it hardly differs from that.
    """
    from dvrk_cmaes.segment.background import (
        differing_region,
        differing_share,
        foreground_log_odds,
        segment_before,
        smooth_background,
    )
    from dvrk_cmaes.segment.classic import rough_mask, segment_classic
    from dvrk_cmaes.segment.model_masks import segment_by_model
    from dvrk_cmaes.segment.prompts import draw_prompts
    from dvrk_cmaes.silhouette.prepare import prepare

    body = None if instrument is None else prepare(instrument)
    prompts = draw_prompts(image, hints)

    @cache
    def rough() -> Segmentation:
        return rough_mask(image, hints)

    @cache
    def before_smooth() -> Segmentation:
        behind = smooth_background(image)
        if behind is None:
            return nothing_found(image.shape)
        return replace(segment_before(image, foreground_log_odds(image, behind), prompts), before="smooth background")

    def roughly() -> Segmentation:
        return rough() if rough().confidence >= GUESS or not before_smooth().mask.any() else before_smooth()

    def by_colours() -> Segmentation:
        found = segment_classic(image, prompts, rough())
        return found if found.confidence >= GUESS else max(found, before_smooth(), key=lambda each: each.confidence)

    def found_by(
        roughly: Callable[[], Segmentation], otherwise: Callable[[], Segmentation], odds: Float32 | None = None
    ) -> Segmentation:
        if body is None:
            return otherwise()
        return segment_by_model(image, body, camera, joints, prompts, roughly, otherwise, odds, expected)

    if background is None:
        return found_by(roughly, by_colours)
    odds = foreground_log_odds(image, background)
    region = Segmentation(differing_region(odds))
    found = found_by(lambda: region, lambda: segment_before(image, odds, prompts), odds)
    found = replace(found, before="learned background", odds=odds)
    if found.confidence >= GUESS:
        return found
    other = found_by(roughly, by_colours)
    if differing_share(other.mask, odds) < _DIFFERS:
        notes = (*other.notes, "it looks like the background that the other images show")
        other = replace(other, confidence=min(other.confidence, _SAME), notes=notes)
    return other if other.confidence >= GUESS or not found.mask.any() else found
