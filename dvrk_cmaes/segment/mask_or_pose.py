"""When a pose is doubtful and its mask was found in the image: which of the two is to blame, as far as can be told.

Where the pose's silhouette and the mask differ, somebody is wrong. The colours there decide, by tables counted where
the two agree: if the image bears out the silhouette, the mask is wrong; if it bears out the mask, the pose is, or what
it was made from: instrument, camera, readings.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.evidence.gather import window_around
from dvrk_cmaes.segment.colours import ColourTable, look
from dvrk_cmaes.segment.confidence import GUESS
from dvrk_cmaes.segment.regions import distance_to
from dvrk_cmaes.segment.segmentation import Segmentation

Bool = NDArray[np.bool_]

_TOLERANCE = 2.5  # px by which outlines may differ
_AROUND = 40.0  # px about both, where colours are compared
_LEAST_SHARE = 0.01  # of the instrument's area, on which the two must differ for it to matter
_SURE = 0.9  # confidence at which a mask that nothing speaks against is right
_CLEARLY = 0.65  # share of the differing pixels that takes one side


def who_is_to_blame(image: NDArray[np.uint8], found: Segmentation, silhouette: Bool, ignore: Bool | None = None) -> str:
    """Say in words whether a mask or the pose fitted to it is to blame for the doubt about the pose.

    Parameters
    ----------
    image
        (H, W, 3) uint8, BGR.
    found
        The mask that was found in it.
    silhouette
        (H, W), the pose's.
    ignore
        (H, W), pixels that count neither way.
    """
    if found.confidence < GUESS:
        return f"the mask is probably to blame: it is a guess, confidence {found.confidence:.2f}"
    mask = found.mask
    differ = (mask & (distance_to(silhouette) > _TOLERANCE)) | (silhouette & (distance_to(mask) > _TOLERANCE))
    if ignore is not None:
        differ &= ~ignore
    if differ.sum() < _LEAST_SHARE * mask.sum():
        if found.confidence < _SURE:
            return f"whether mask or pose is to blame cannot be told: they agree, confidence {found.confidence:.2f}"
        return "the mask is probably not to blame: the silhouette fits it, and the image bears it out"
    both, neither = mask & silhouette, ~(mask | silhouette) & (distance_to(mask | silhouette) < _AROUND)
    left, top, width, height = window_around(mask | silhouette, round(_AROUND))
    window = np.s_[top : top + height, left : left + width]
    odds = ColourTable(look(np.ascontiguousarray(image[window]))).log_odds(both[window], neither[window])
    sides_with_mask = float(((odds > 0) == mask[window])[differ[window]].mean())
    if sides_with_mask > _CLEARLY and found.confidence >= _SURE:
        return (
            "the mask is probably not to blame: where the silhouette differs from it, the image's colours side with "
            "the mask; instrument, camera or readings may be wrong"
        )
    if sides_with_mask < 1 - _CLEARLY:
        return (
            "the mask is probably to blame: where it differs from the silhouette, the image's colours side with the "
            "silhouette"
        )
    return "whether mask or pose is to blame cannot be told: the image's colours side with neither clearly"
