"""Log-odds of instrument against background by the colours of an image.

Under changing illumination, the colours of a surface lie near a ray through black in BGR space. Instruments are grey,
so their ray is the grey axis; tissue and drapes have rays of other directions. `greyness_log_odds` compares the
distances of a pixel from these rays in units of the image's noise; for dark pixels the distances are within the noise
and the log-odds are near 0. Given a first mask, `ColourTable` compares the colour histograms of instrument and
background.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.geometry import Bool, Float32
from dvrk_cmaes.segment.regions import distance_to

T = TypeVar("T", np.uint8, np.float32)

_GREY = np.ones((1, 3), np.float32) / np.sqrt(np.float32(3))
_RAYS = 3  # number of rays of the background
# standard deviation about a ray, as a fraction of the brightness; larger for steel, which reflects its surroundings
_DEVIATION = {"background": 0.06, "tool": 0.12}
_LARGEST_TOOL_ODDS = 4.5  # bound of the log-odds for instrument, by the distance from the background's rays
_BINS = np.array([24, 24, 20])  # of the histogram, for the three features
_NEAR_ZERO = 1e-5  # added to frequencies before the logarithm
_DECAY = 12.0  # px; near an outline, pixels are weighted by exp(-distance from it / this)
_SAMPLED = 320  # px, longer side of an image whose noise is that of all pixels, and not of every second one or fewer
LARGEST_COLOUR_ODDS = 4.0
"""Bound of the log-odds by histograms."""


@dataclass(frozen=True, eq=False)
class Colours:
    """Colour features of an image.

    smooth : (H, W, 3) float32, BGR, the denoised image, grey levels plus 1.
    noise : standard deviation of the image's noise, grey levels, at least 1.
    features : (H, W, 3) float32, logarithms of blue / green, of red / green, and of the brightness.
    brightness : (H, W) float32, the largest channel of ``smooth``.
    """

    smooth: Float32
    noise: float
    features: Float32
    brightness: Float32

    @property
    def shape(self) -> tuple[int, int]:
        """Height and width."""
        return self.smooth.shape[0], self.smooth.shape[1]

    @property
    def guide(self) -> Float32:
        """Features whose edges the graph cut follows: logarithm of the brightness, and colourfulness, (H, W, 2)."""
        colourful = np.hypot(self.features[..., 0], self.features[..., 1])
        return np.stack([self.features[..., 2], colourful], axis=-1)


def measure_colours(image: NDArray[np.uint8]) -> Colours:
    """Denoise an image (H, W, 3) uint8 BGR and compute its colour features."""
    noise = max(_noise(image), 1.0)
    smooth = np.asarray(cv2.bilateralFilter(image, 7, 30, 3), np.float32) + 1
    brightness = brightest(smooth)
    blue, green, red = cv2.split(smooth + 4 * noise)  # ratios of values within the noise tend to 1
    features = np.log(np.stack([blue / green, red / green, brightness + 4 * noise], axis=-1))
    return Colours(smooth, noise, features, brightness)


def brightest(image: NDArray[T]) -> NDArray[T]:
    """Return the largest channel (H, W) of an image (H, W, 3), in a tenth of the time that NumPy takes."""
    return np.asarray(cv2.max(cv2.max(image[..., 0], image[..., 1]), image[..., 2]), image.dtype)


def greyness_log_odds(colours: Colours) -> Float32:
    """Return log-odds of instrument against background (H, W), by the distances of colours from rays through black.

    The background's rays are those of the pixels whose saturation is above Otsu's threshold.
    """
    lit, lifted = colours.brightness > 6 * colours.noise, 4 * colours.noise
    saturation = 1 - (lifted - brightest(-colours.smooth)) / (colours.brightness + lifted)
    background = lit & (saturation > _threshold(saturation[lit]))
    if not background.any():
        return np.zeros(colours.shape, np.float32)
    from_background = _ray_distance(colours, _background_rays(colours.smooth[background]), _DEVIATION["background"])
    from_tool = _ray_distance(colours, _GREY, _DEVIATION["tool"])
    return np.asarray(np.minimum(from_background, _LARGEST_TOOL_ODDS) - from_tool, np.float32)


class ColourTable:
    """Colour histograms of regions of one image."""

    def __init__(self, colours: Colours) -> None:
        features = colours.features.reshape(-1, 3)
        low, high = np.percentile(features[:: max(len(features) // 20_000, 1)], [0.5, 99.5], axis=0)
        cells = ((colours.features - low) / (high - low + 1e-6) * _BINS).astype(np.int32)
        cells = np.clip(cells, 0, _BINS - 1)
        self._cell = (cells[..., 0] * _BINS[1] + cells[..., 1]) * _BINS[2] + cells[..., 2]
        self._any = 1 / max(int(np.count_nonzero(np.bincount(self._cell.ravel()))), 1)

    def log_odds(self, tool: Float32 | Bool, background: Float32 | Bool, *, unseen: float = 0.0) -> Float32:
        """Return the log-odds (H, W) of each pixel's colour in one region against another; each (H, W) bool or weights.

        ``unseen`` is the share of the instrument whose colours are assumed to be uniform over the colours of the image.
        With a share above 0, colours that occur neither in ``background`` nor in ``tool`` have positive log-odds.
        """
        of_tool = (1 - unseen) * self._share(tool) + unseen * self._any
        odds = np.log((of_tool + _NEAR_ZERO) / (self._share(background) + _NEAR_ZERO))
        return np.asarray(odds[self._cell], np.float32)

    def _share(self, region: Float32 | Bool) -> NDArray[np.float64]:
        """Return the normalised histogram of a region, smoothed by a Gaussian, one value a cell."""
        from scipy.ndimage import gaussian_filter  # takes 0.2 s to import; masks are followed without

        counts = np.bincount(self._cell.ravel(), weights=np.ravel(region), minlength=int(_BINS.prod()))
        blurred = gaussian_filter(counts.reshape(_BINS), 1.2, mode="nearest").ravel()
        return np.asarray(blurred / max(blurred.sum(), 1e-9))


def _noise(image: NDArray[np.uint8]) -> float:
    """Estimate an image's noise, grey levels, by the median of the difference of two Laplacians (Immerkaer, 1996)."""
    mixed = np.array([[1, -2, 1], [-2, 4, -2], [1, -2, 1]], np.float32)
    step = max(max(image.shape) // _SAMPLED, 1)
    return float(np.median(np.abs(cv2.filter2D(image, cv2.CV_32F, mixed)[::step, ::step])) / (0.6745 * 6))


def _threshold(values: Float32) -> float:
    """Return Otsu's threshold of values between 0 and 1; 0 without values."""
    if not len(values):
        return 0.0
    levels = np.clip(values * 255, 0, 255).astype(np.uint8).reshape(-1, 1)
    return float(cv2.threshold(levels, 0, 255, cv2.THRESH_BINARY + cv2.THRESH_OTSU)[0]) / 255


def _background_rays(pixels: Float32) -> Float32:
    """Cluster the directions of pixels (N, 3) by k-means; returns the clusters' unit directions (K, 3).

    The initial clusters are equal parts of the pixels in the order of their first principal component. With fewer than
    20 pixels a cluster, the one mean direction (1, 3) is returned.
    """
    directions = pixels[:: max(len(pixels) // 8000, 1)]
    directions = directions / np.linalg.norm(directions, axis=1, keepdims=True)
    middle = directions.mean(axis=0, keepdims=True)
    if len(directions) >= 20 * _RAYS:
        along = (directions - middle) @ np.linalg.svd(np.cov(directions.T))[0][:, 0]
        labels = (along.argsort().argsort() * _RAYS // len(along)).astype(np.int32)[:, None]
        criteria = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 20, 1e-4)
        start = cv2.KMEANS_USE_INITIAL_LABELS  # deterministic: no random initial clusters
        middle = cv2.kmeans(directions.astype(np.float32), _RAYS, labels, criteria, 1, start)[2]
    return np.asarray(middle / np.linalg.norm(middle, axis=1, keepdims=True), np.float32)


def _ray_distance(colours: Colours, rays: Float32, deviation: float) -> Float32:
    """Return half the squared distance (H, W) of each pixel from the nearest ray, in units of its standard deviation.

    The variance is that of the noise plus that of colours about a ray, ``deviation`` times the brightness squared.
    """
    squares = np.einsum("ijk,ijk->ij", colours.smooth, colours.smooth)
    along = np.max([colours.smooth @ ray for ray in rays], axis=0)
    variance = (2 * colours.noise) ** 2 + (deviation * colours.brightness) ** 2
    return np.asarray(np.maximum(squares - along**2, 0) / (2 * variance), np.float32)


def local_colour_log_odds(table: ColourTable, mask: Bool) -> Float32:
    """Return log-odds of instrument (H, W) by colour histograms inside and outside a mask, taken near its outline."""
    inside, outside = (np.exp(-distance_to(~side) / _DECAY) * side for side in (mask, ~mask))
    return np.clip(table.log_odds(inside, outside), -LARGEST_COLOUR_ODDS, LARGEST_COLOUR_ODDS)
