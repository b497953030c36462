"""Distances of a mask from its contour, and the contour's errors: their standard deviation and correlation length.

The contour errors of a segmentation are correlated over many pixels, so a thousand contour points hold far fewer
independent measurements. Both parameters are estimated from the residuals along the contour. They determine the weight
of the outline relative to the readings, and the covariance of the pose.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes import _kernel
from dvrk_cmaes.errors import InputError, nearest_first
from dvrk_cmaes.evidence.quantiles import NORMAL_MEDIAN, median
from dvrk_cmaes.evidence.shaft_edges import Contour
from dvrk_cmaes.geometry import Bool, Float32, Float64

_LEAST_SIGMA = 0.25  # px; that of an exact mask, from quantisation to pixels
_LENGTHS = (2.0, 40.0)  # px, smallest and largest correlation length
_REMAP_WIDTH = 512  # points in a row; OpenCV limits each side of the array that it samples
CLIP = 3.0  # standard deviations; larger errors are outliers of the segmentation
_NEXT = 1.0  # px, of margins for which pixels 2 px from the outline and farther count alike
_NEIGHBOURS = cv2.MORPH_CROSS, cv2.MORPH_RECT


@dataclass(frozen=True)
class OutlineNoise:
    """Errors of a mask's contour: standard deviation, px, and correlation length, px.

    One correlation length of contour counts as one independent measurement.
    """

    sigma: float
    length: float

    def inflation(self, pixel_scale: float) -> float:
        """Return the factor on the covariance of a pose that was computed for small Gaussian errors.

        The errors of a rough contour are neither small nor Gaussian. The factor was fitted to 240 synthetic frames of
        all levels; with it, the 90 % intervals contain the truth in 85 to 100 % of the frames of each level.

        Parameters
        ----------
        pixel_scale
            That of the camera.
        """
        return 1.0 + (self.sigma / (1.2 * pixel_scale)) ** 2


def signed_distance(mask: NDArray[np.bool_]) -> NDArray[np.float32]:
    """Compute the signed distance, px, to a mask's outline, negative inside, (H, W); neither empty nor full."""
    return np.where(mask, 0.5 - distance_within(mask), distance_within(~mask) - 0.5).astype(np.float32)


def less_margin(mask: NDArray[np.bool_], margin: float) -> NDArray[np.float32]:
    """Return a mask (H, W) less a margin, px, all round: the share of each that is left, 0 to 1.

    The mask is neither empty nor full. A pixel keeps 0.5 - ``margin`` less its signed distance, so that of a margin
    below a pixel only the distances of the pixels next to the outline count, of which there are three.
    """
    if abs(margin) >= _NEXT:
        return _share_left(signed_distance(mask), margin)
    distances = np.sqrt(np.array([0, 1, 2, 4], dtype=np.float32))
    shares = np.zeros(256, dtype=np.float32)
    shares[:4] = _share_left(np.float32(0.5) - distances, margin)
    shares[4:7] = _share_left(distances[1:] - np.float32(0.5), margin)
    outside = _place(~mask)
    return np.asarray(cv2.LUT(np.where(outside > 0, outside + np.uint8(3), _place(mask)), shares))


def _share_left(signed: NDArray[np.float32], margin: float) -> NDArray[np.float32]:
    """Return the share of each pixel that is left less a margin, px, from its signed distance."""
    return np.asarray(np.clip(0.5 - margin - signed, 0, 1), dtype=np.float32)


def _place(mask: NDArray[np.bool_]) -> NDArray[np.uint8]:
    """Return 0 outside a mask (H, W), 1 beside a pixel outside, 2 where one is at a corner, 3 farther in."""
    image = mask.astype(np.uint8)
    beside, around = (cv2.erode(image, cv2.getStructuringElement(shape, (3, 3))) for shape in _NEIGHBOURS)
    return np.asarray(image + beside + around)


def distances_to(silhouette: NDArray[np.bool_], pixels: Float64) -> Float64:
    """Compute the signed distances (N,), px, of pixels (N, 2) to a silhouette's outline, as `signed_distance`."""
    return _kernel.signed_distances(silhouette, pixels, FARTHEST)


def sampled(image: NDArray[np.float32], at: NDArray[np.floating]) -> Float64:
    """Sample an image (H, W) at pixels (N, 2) with bilinear interpolation, (N,)."""
    rows = -(-len(at) // _REMAP_WIDTH)
    if rows == 0:
        return np.zeros(0)
    padded = np.zeros((rows * _REMAP_WIDTH, 2), dtype=np.float32)
    padded[: len(at)] = at
    u, v = padded.reshape(rows, _REMAP_WIDTH, 2).transpose(2, 0, 1)
    values = cv2.remap(
        image, np.ascontiguousarray(u), np.ascontiguousarray(v), cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
    )
    return np.asarray(values.ravel()[: len(at)], dtype=np.float64)


def measure_noise(contour: Contour, silhouette: NDArray[np.bool_]) -> OutlineNoise:
    """Estimate the noise of a mask's contour from its distances to the silhouette (H, W) fitted to it."""
    if len(contour.pixels) < 40 or silhouette.all() or not silhouette.any():
        return OutlineNoise(sigma=2.0, length=_LENGTHS[1])
    error = distances_to(silhouette, contour.pixels)
    sigma = max(NORMAL_MEDIAN * median(np.abs(error)), _LEAST_SIGMA)
    error = np.clip(error, -CLIP * sigma, CLIP * sigma)
    rms = max(float(np.sqrt(np.mean(error**2))), _LEAST_SIGMA)
    spacing = median(np.linalg.norm(np.diff(contour.pixels, axis=0), axis=1))
    most = min(int(_LENGTHS[1]), len(error) // 4)
    variance = float(error @ error) / len(error) + 1e-12
    length = spacing
    for lag in range(1, most):
        correlation = float(error[lag:] @ error[:-lag]) / (len(error) - lag) / variance
        if correlation < 0.1:
            break
        length += 2 * correlation * spacing
    return OutlineNoise(rms, float(np.clip(length, *_LENGTHS)))


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
