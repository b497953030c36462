"""Segmentation of a known instrument: its silhouette in an estimated pose is a prior for segmenting again.

As in region-based tracking, the image's colours are learned just inside and just outside the silhouette, and the image
is segmented again with the silhouette as a prior. `dvrk_cmaes.estimation.image_frame` alternates this with the estimate
of the pose.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.camera import Camera
from dvrk_cmaes.errors import DvrkCmaesError
from dvrk_cmaes.frames.seen_view import overlap_of
from dvrk_cmaes.geometry import Bool
from dvrk_cmaes.segment import Segmentation, segment
from dvrk_cmaes.segment.around import segmentation_around
from dvrk_cmaes.segment.background import foreground_log_odds
from dvrk_cmaes.segment.prompts import draw_prompts
from dvrk_cmaes.segment.segmentation import Hints, SegmentSettings
from dvrk_cmaes.silhouette import Body

_LEAST_OVERLAP = 0.8  # intersection over union of silhouette and mask, below which the silhouette is no prior


def segment_first(
    image: NDArray[np.uint8],
    ignore: Bool | None,
    *,
    settings: SegmentSettings,
    hints: Hints,
    threads: int,
    view: str = "",
    body: Body | None = None,
    camera: Camera | None = None,
    joints: Mapping[str, float] | None = None,
) -> Segmentation:
    """Segment the instrument in an image (H, W, 3) BGR of a view without a pose.

    ``ignore`` (H, W) are pixels that count neither way; ``body``, ``camera`` and ``joints`` are as in `segment`.

    Raises
    ------
    InputError
        As `segment`.
    DvrkCmaesError
        No pixel that counts was taken for the instrument.
    """
    segmentation = segment(
        image,
        **vars(hints),
        model=settings.model,
        weights=settings.weights,
        threads=threads,
        background=settings.backgrounds.get(view),
        instrument=body,
        camera=camera,
        joints=joints,
    )
    if not segmentation.mask.any() or (ignore is not None and not (segmentation.mask & ~ignore).any()):
        raise DvrkCmaesError("no instrument found in the image; a mask, a box or a point on the instrument would help")
    return segmentation


def segment_again(
    image: NDArray[np.uint8],
    silhouette: Bool,
    mask: Bool,
    ignore: Bool | None,
    *,
    hints: Hints,
    background: NDArray[np.uint8] | None = None,
) -> Segmentation | None:
    """Segment an image (H, W, 3) BGR with a silhouette (H, W) as prior.

    ``mask`` (H, W) is the mask that the silhouette's pose was fitted to. Returns None where silhouette and mask overlap
    too little for a prior, or where no pixel is taken for the instrument. Before a known ``background`` (h, w, 3) it is
    what differs from that, and else the colours near the outline, that count besides the silhouette.
    """
    counts = np.True_ if ignore is None else ~ignore
    if overlap_of(silhouette & counts, mask & counts) < _LEAST_OVERLAP:
        return None
    odds = None if background is None else foreground_log_odds(image, background)
    segmentation = segmentation_around(image, silhouette, draw_prompts(image, hints), colours=odds, local=odds is None)
    return segmentation if segmentation.mask.any() else None
