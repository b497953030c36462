"""Attribution of a doubtful pose to its mask or to the pose, where the mask was found in the image.

The pixels where the pose's silhouette and the mask differ are classified by colour, with histograms of the pixels where
the two agree. If most of these pixels are classified as in the silhouette, the mask is probably wrong; if most are
classified as in the mask, the pose or its inputs (instrument, camera, readings) are probably wrong.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.evidence.gather import window_around
from dvrk_cmaes.geometry import Bool
from dvrk_cmaes.segment.colours import ColourTable, measure_colours
from dvrk_cmaes.segment.regions import distance_to
from dvrk_cmaes.segment.segmentation import GUESS, Segmentation

_TOLERANCE = 2.5  # px by which the outlines may differ
_AROUND = 40.0  # px, width of the surroundings from which the background's histogram is taken
_LEAST_SHARE = 0.01  # share of the mask's area; if fewer pixels differ, the two agree
_SURE = 0.9  # confidence from which a mask that the pixels' colours support is taken to be right
CLEARLY = 0.65
"""Share of the differing pixels from which they decide for one of the two."""


def attribute_doubt(
    image: NDArray[np.uint8], segmentation: Segmentation, silhouette: Bool, ignore: Bool | None = None
) -> str:
    """Return a message that says whether a doubtful pose is probably due to the mask that it was fitted to.

    Parameters
    ----------
    image
        (H, W, 3) uint8, BGR.
    segmentation
        The mask that was found in the image.
    silhouette
        (H, W), the silhouette of the pose.
    ignore
        (H, W), pixels that are not compared.
    """
    if segmentation.confidence < GUESS:
        return f"the mask is probably to blame: it is a guess, confidence {segmentation.confidence:.2f}"
    sides_with_mask = colours_side_with(image, segmentation.mask, silhouette, ignore)
    if sides_with_mask is None:
        if segmentation.confidence < _SURE:
            return (
                f"whether mask or pose is to blame cannot be told: they agree, confidence {segmentation.confidence:.2f}"
            )
        return "the mask is probably not to blame: the silhouette fits it, and the image bears it out"
    if sides_with_mask > CLEARLY and segmentation.confidence >= _SURE:
        return (
            "the mask is probably not to blame: where the silhouette differs from it, the image's colours side with "
            "the mask; instrument, camera or readings may be wrong"
        )
    if sides_with_mask < 1 - CLEARLY:
        return (
            "the mask is probably to blame: where it differs from the silhouette, the image's colours side with the "
            "silhouette"
        )
    return "whether mask or pose is to blame cannot be told: the image's colours side with neither clearly"


def colours_side_with(image: NDArray[np.uint8], mask: Bool, other: Bool, ignore: Bool | None = None) -> float | None:
    """Return the share of the pixels in which two masks (H, W) differ whose colours are as the first one says.

    Colours of instrument and background are those of an image's (H, W, 3) pixels where the masks agree. Pixels near the
    outlines of both, and those of ``ignore`` (H, W), do not count. None where the masks hardly differ.
    """
    differ = (mask & (distance_to(other) > _TOLERANCE)) | (other & (distance_to(mask) > _TOLERANCE))
    if ignore is not None:
        differ &= ~ignore
    if differ.sum() < _LEAST_SHARE * mask.sum():
        return None
    both, neither = mask & other, ~(mask | other) & (distance_to(mask | other) < _AROUND)
    left, top, width, height = window_around(mask | other, round(_AROUND))
    window = np.s_[top : top + height, left : left + width]
    odds = ColourTable(measure_colours(np.ascontiguousarray(image[window]))).log_odds(both[window], neither[window])
    return float(((odds > 0) == mask[window])[differ[window]].mean())
