"""What the colours of an image say about where the instrument is.

Instruments are grey: their pixels lie near a ray through black along grey, whatever light falls on them; tissue and
drapes are colourful, and lie near rays of their own, in shadow as in light. Distances to those rays, in units of the
image's noise, say which one a pixel belongs to, and say nothing where it is too dark to tell (`greyness`). Once some
of the instrument is found, its true colours and the background's are counted in tables (`ColourTable`).
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

Bool = NDArray[np.bool_]
Float32 = NDArray[np.float32]

_GREY = np.ones(3, np.float32) / np.sqrt(np.float32(3))
_RAYS = 3  # of the background
_SPREAD = {"background": 0.06, "tool": 0.12}  # about a ray, of the brightness; steel mirrors what is around it
_FARTHEST = 4.5  # log-odds that being unlike the background may count for
_COLOURFUL = 2.0  # log-odds that being colourful may count against, where the instrument may have any colour
_BINS = np.array([24, 24, 20])
_NEAR_ZERO = 1e-5


@dataclass(frozen=True, eq=False)
class Colours:
    """An image made ready for looking at its colours.

    smooth : (H, W, 3) float32, without its grain, BGR.
    noise : standard deviation of that grain, grey levels, at least 1.
    features : (H, W, 3) float32, the logarithms of blue to green, red to green, and of the brightness.
    brightness, saturation : (H, W) float32, the largest channel and how much larger it is than the smallest, 0 to 1.
    """

    smooth: Float32
    noise: float
    features: Float32
    brightness: Float32
    saturation: Float32

    @property
    def shape(self) -> tuple[int, int]:
        """Height and width."""
        return self.smooth.shape[0], self.smooth.shape[1]

    @property
    def guide(self) -> Float32:
        """What an outline should follow the edges of: brightness and colourfulness, (H, W, 2)."""
        colourful = np.hypot(self.features[..., 0], self.features[..., 1])
        return np.stack([self.features[..., 2], colourful], axis=-1)


def look(image: NDArray[np.uint8]) -> Colours:
    """Take the grain out of an image (H, W, 3) uint8 BGR and measure its colours."""
    noise = max(_noise(image), 1.0)
    smooth = np.asarray(cv2.bilateralFilter(image, 7, 30, 3), np.float32) + 1
    brightness = smooth.max(axis=2)
    lifted = smooth + 4 * noise  # ratios of values within the noise mean nothing
    features = np.log(
        np.stack([lifted[..., 0] / lifted[..., 1], lifted[..., 2] / lifted[..., 1], lifted.max(axis=2)], axis=-1)
    )
    saturation = (brightness - smooth.min(axis=2)) / (brightness + 4 * noise)
    return Colours(smooth, noise, features, brightness, saturation)


def greyness(
    colours: Colours, background: Bool | None = None, tool: Bool | None = None, *, any_colour: bool = False
) -> Float32:
    """Log-odds of instrument against background, (H, W), by what a pixel's colour is a brighter or darker shade of.

    Parameters
    ----------
    colours
        The image.
    background
        (H, W), where there is surely no instrument; unless given, the more colourful of the image's two kinds of
        pixels (Otsu's threshold on the saturation).
    tool
        (H, W), where there surely is; its colours count as the instrument's beside grey.
    any_colour
        Whether what is unlike the background is more likely instrument, though it is colourful itself.
    """
    lit = colours.brightness > 6 * colours.noise
    if background is None:
        background = lit & (colours.saturation > _threshold(colours.saturation[lit]))
    elif (background & lit).any():
        background = background & lit
    if not background.any():
        return np.zeros(colours.shape, np.float32)
    rays = [_GREY] if tool is None else [_GREY, *_rays(colours.smooth[tool], 1)]
    from_background = _off_rays(colours, _rays(colours.smooth[background], _RAYS), _SPREAD["background"])
    from_tool = _off_rays(colours, rays, _SPREAD["tool"])
    if any_colour:
        from_tool = np.minimum(from_tool, _COLOURFUL)
    return np.asarray(np.minimum(from_background, _FARTHEST) - from_tool, np.float32)


class ColourTable:
    """How often each colour occurs in a region, for regions of one image."""

    def __init__(self, colours: Colours) -> None:
        features = colours.features.reshape(-1, 3)
        low, high = np.percentile(features[:: max(len(features) // 20_000, 1)], [0.5, 99.5], axis=0)
        cells = ((colours.features - low) / (high - low + 1e-6) * _BINS).astype(np.int32)
        cells = np.clip(cells, 0, _BINS - 1)
        self._cell = (cells[..., 0] * _BINS[1] + cells[..., 1]) * _BINS[2] + cells[..., 2]
        self._any = 1 / max(len(np.unique(self._cell)), 1)

    def log_odds(self, tool: Float32 | Bool, background: Float32 | Bool, *, unseen: float = 0.0) -> Float32:
        """Log-odds (H, W) of each pixel's colour in the one region against the other; regions may be weights.

        ``unseen`` is the share of the instrument that may have any colour of the image: what the background has none
        of is then more likely instrument, though it looks like nothing found of it yet.
        """
        of_tool = (1 - unseen) * self._share(tool) + unseen * self._any
        odds = np.log((of_tool + _NEAR_ZERO) / (self._share(background) + _NEAR_ZERO))
        return np.asarray(odds[self._cell], np.float32)

    def _share(self, region: Float32 | Bool) -> NDArray[np.float64]:
        """Share of a region's pixels in each cell, blurred: colours nearby are as likely."""
        counts = np.bincount(self._cell.ravel(), weights=np.ravel(region), minlength=int(_BINS.prod()))
        blurred = gaussian_filter(counts.reshape(_BINS), 1.2, mode="nearest").ravel()
        return np.asarray(blurred / max(blurred.sum(), 1e-9))


def _noise(image: NDArray[np.uint8]) -> float:
    """Estimate an image's grain, grey levels, from its second differences both ways (Immerkaer 1996), by the median."""
    mixed = np.array([[1, -2, 1], [-2, 4, -2], [1, -2, 1]], np.float32)
    return float(np.median(np.abs(cv2.filter2D(image.astype(np.float32), -1, mixed))) / (0.6745 * 6))


def _threshold(values: Float32) -> float:
    """Otsu's threshold of values between 0 and 1."""
    if not len(values):
        return 0.0
    levels = np.clip(values * 255, 0, 255).astype(np.uint8).reshape(-1, 1)
    return float(cv2.threshold(levels, 0, 255, cv2.THRESH_BINARY + cv2.THRESH_OTSU)[0]) / 255


def _rays(pixels: Float32, count: int) -> Float32:
    """Find the directions (count, 3) that pixels (N, 3) lie about, starting from an even cut along their spread."""
    directions = pixels[:: max(len(pixels) // 8000, 1)]
    directions = directions / np.linalg.norm(directions, axis=1, keepdims=True)
    middle = directions.mean(axis=0, keepdims=True)
    if count > 1 and len(directions) >= 20 * count:
        along = (directions - middle) @ np.linalg.svd(np.cov(directions.T))[0][:, 0]
        labels = (along.argsort().argsort() * count // len(along)).astype(np.int32)[:, None]
        criteria = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 20, 1e-4)
        start = cv2.KMEANS_USE_INITIAL_LABELS  # no random numbers
        middle = cv2.kmeans(directions.astype(np.float32), count, labels, criteria, 1, start)[2]
    return np.asarray(middle / np.linalg.norm(middle, axis=1, keepdims=True), np.float32)


def _off_rays(colours: Colours, rays: Float32 | list[Float32], spread: float) -> Float32:
    """Half the squared distance (H, W) of each pixel from the nearest ray, in units of its noise and spread."""
    squares = (colours.smooth**2).sum(axis=2)
    along = np.max([colours.smooth @ ray for ray in rays], axis=0)
    variance = (2 * colours.noise) ** 2 + (spread * colours.brightness) ** 2
    return np.asarray(np.maximum(squares - along**2, 0) / (2 * variance), np.float32)
