"""Distance transforms of masks: outside a mask by one of three methods, and inside a mask."""

from __future__ import annotations

import cv2
import numpy as np

from dvrk_cmaes.errors import InputError, nearest_first
from dvrk_cmaes.geometry import Bool, Float32, Float64

FIELDS = ("fmm", "exact", "chamfer")
"""Methods: fast marching (scikit-fmm), as in the paper; SciPy's exact Euclidean transform; OpenCV's 5 x 5 chamfer."""

_MARCHED = 1.5  # largest ratio of distances by fast marching to exact ones; it is below that of the city-block distance
_GRID = 2.0  # px, beyond the farthest pixel that is needed
_ORDER = 2  # of the fast marching's differences
FARTHEST = 1000.0
"""Largest distance, px; the squares of larger ones are not exact in single precision."""


def distance_field(mask: Bool, method: str = "fmm", *, where: Bool | None = None) -> Float64:
    """Compute the distance, px, from each pixel to the mask (H, W), (H, W); 0 inside.

    Distances are measured from the mask's outline, half a pixel outside the centres of its outermost pixels. The mask
    must be neither empty nor full. With ``where`` (H, W), only the distances of those pixels are needed; others may be
    0. Raises `InputError` for an unknown method.
    """
    if method == "fmm":
        # Distances inside are not needed: of the mask, only the pixels next to its outline take part.
        inside = cv2.erode(mask.astype(np.uint8), np.ones((5, 5), np.uint8), borderType=cv2.BORDER_REPLICATE) > 0
        # The front is marched from near to far, and distances that it has reached do not change any more.
        farthest = FARTHEST if where is None else float(distance_within(~mask)[where].max(initial=0.0))
        narrow = 0.0 if farthest >= FARTHEST else _MARCHED * farthest + _GRID
        return np.maximum(_marched(np.where(mask, -1.0, 1.0), inside, narrow), 0.0)
    if method == "exact":
        from scipy.ndimage import distance_transform_edt

        return np.maximum(np.asarray(distance_transform_edt(~mask), dtype=np.float64) - 0.5, 0.0)
    if method == "chamfer":
        return np.maximum(cv2.distanceTransform((~mask).astype(np.uint8), cv2.DIST_L2, 5).astype(np.float64) - 0.5, 0.0)
    raise InputError(f"distance field: expected one of {', '.join(nearest_first(method, FIELDS))}, got {method!r}")


def _marched(sign: Float64, left_out: Bool, narrow: float) -> Float64:
    """March a front from where ``sign`` (H, W) changes, up to ``narrow`` px, 0 for any; 0 where it does not come.

    ``skfmm.distance`` takes pixels that are left out as a masked array, and returns one. It imports numpy.ma for that,
    a twentieth of a whole command's processor time, so that the compiled function below it is called, as it does.
    """
    from skfmm import pfmm

    try:
        flags = np.where(left_out, pfmm.MASK, pfmm.FAR).astype(np.longlong)
        none = np.zeros(sign.shape, dtype=np.longlong)
        marched = pfmm.cFastMarcher(sign, np.ones(2), flags, None, none, 0, pfmm.DISTANCE, _ORDER, narrow, 0)
    except (AttributeError, TypeError):  # another release's has other parameters
        marched = np.ma.filled(pfmm.distance(np.ma.MaskedArray(sign, left_out), order=_ORDER, narrow=narrow), 0.0)
    return np.where(marched == np.finfo(np.float64).max, 0.0, np.asarray(marched, dtype=np.float64))


def distance_within(mask: Bool) -> Float32:
    """Compute the distance, px, at most 1000, from each pixel of a mask (H, W) to the nearest one outside; 0 there.

    OpenCV computes square roots with either of two methods of different accuracy, depending on the memory alignment of
    the array. The squared distances are therefore rounded to integers and their roots taken again.
    """
    distance = cv2.distanceTransform(np.asarray(mask, np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    near = np.minimum(distance, np.float32(FARTHEST))
    return np.asarray(np.sqrt(np.rint(near * near)), dtype=np.float32)
