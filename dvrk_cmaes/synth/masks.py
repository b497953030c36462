"""Simulation of segmentation errors: masks with coarse and noisy outlines, lumps, bites and holes.

A network's mask is a coarse map of logits, interpolated and thresholded at zero. Here the logits are the signed
distance from the true outline plus correlated noise, increased in lumps, decreased in bites and highlights, averaged
over coarse cells and interpolated.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.geometry import Bool, Float32, Indices
from dvrk_cmaes.synth.levels import Mistakes

SLIGHT: Final = Mistakes(cell=2, wave=0.6, wavelength=36.0, lumps=2, holes=1)
MEDIUM: Final = Mistakes(cell=3, wave=1.0, wavelength=30.0, lumps=6, holes=2)


@dataclass(frozen=True, eq=False)
class SimulatedMask:
    """A mask with simulated errors, and the highlights that are missing in it, both (H, W)."""

    mask: Bool
    holes: Bool


def simulate_segmentation(
    exact: Bool, rng: np.random.Generator, mistakes: Mistakes, occluder: Bool | None = None
) -> SimulatedMask:
    """Simulate the segmentation of a frame from its exact mask (H, W), without the pixels of ``occluder`` (H, W)."""
    shape = exact.shape
    visible = exact if occluder is None else exact & ~occluder
    logits = signed_distance(visible)
    logits += mistakes.wave * smooth_noise(shape, rng, mistakes.wavelength)
    v, u = np.mgrid[: shape[0], : shape[1]].astype(np.float32)
    outline = _inner(np.argwhere(visible & (np.abs(logits) < 1.5)), shape)
    for k, (row, column) in enumerate(rng.permutation(outline)[: mistakes.lumps]):
        lump = rng.uniform(*mistakes.lump_radius) - np.hypot(u - column, v - row)
        logits = np.maximum(logits, lump) if k % 2 else np.minimum(logits, -lump)
    holes = np.zeros(shape, dtype=np.bool_)
    inside = _inner(np.argwhere(signed_distance(visible) > 8), shape)
    for row, column in rng.permutation(inside)[: mistakes.holes]:
        hole = _glare(u - column, v - row, rng)
        logits = np.minimum(logits, -hole)
        holes |= hole > 0
    return SimulatedMask(_through_coarse_cells(logits, mistakes.cell) > 0, holes)


def _inner(places: Indices, shape: tuple[int, ...]) -> Indices:
    """Return the positions (N, 2), (row, column), that are more than 6 px from the image's border."""
    return places[np.all((places > 6) & (places < np.array(shape) - 7), axis=1)]


def _glare(u: Float32, v: Float32, rng: np.random.Generator) -> Float32:
    """Return the approximate signed distance, positive inside, of a small random ellipse about the origin."""
    turn, long, short = rng.uniform(0, np.pi), rng.uniform(3.5, 6.5), rng.uniform(2.2, 3.2)
    along, across = u * np.cos(turn) + v * np.sin(turn), v * np.cos(turn) - u * np.sin(turn)
    return np.asarray((1 - np.hypot(along / long, across / short)) * short, dtype=np.float32)


def _through_coarse_cells(logits: Float32, cell: int, limit: float = 8.0) -> Float32:
    """Clip logits (H, W) to the limit, average them over square cells, and interpolate them to (H, W) again."""
    height, width = logits.shape
    coarse = cv2.resize(
        np.clip(logits, -limit, limit), (-(-width // cell), -(-height // cell)), interpolation=cv2.INTER_AREA
    )
    return np.asarray(cv2.resize(coarse, (width, height), interpolation=cv2.INTER_CUBIC), dtype=np.float32)


def signed_distance(mask: Bool) -> Float32:
    """Return the signed distance from the mask's outline (H, W), px, positive inside."""
    inside = cv2.distanceTransform(mask.astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    outside = cv2.distanceTransform((~mask).astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    return np.asarray(np.where(mask, inside - 0.5, 0.5 - outside), dtype=np.float32)


def smooth_noise(shape: tuple[int, ...], rng: np.random.Generator, wavelength: float) -> Float32:
    """Draw correlated noise (H, W) of unit variance with a given wavelength, px."""
    # blurred white noise on a grid that is coarse for long wavelengths, interpolated to the image
    step = max(1.0, wavelength / 8)
    small = (int(shape[0] / step) + 8, int(shape[1] / step) + 8)
    noise = cv2.GaussianBlur(rng.standard_normal(small).astype(np.float32), (0, 0), wavelength / 4 / step)
    noise -= noise.mean()
    large = cv2.resize(noise / noise.std(), None, fx=step, fy=step, interpolation=cv2.INTER_CUBIC)
    return np.asarray(large[: shape[0], : shape[1]], dtype=np.float32)


def tissue_region(
    shape: tuple[int, ...], rng: np.random.Generator, centre: NDArray[np.floating], radius: float
) -> Bool:
    """Draw a round region (H, W) with an uneven outline about a pixel (u, v), such as tissue before the instrument."""
    v, u = np.mgrid[: shape[0], : shape[1]]
    angle, distance = np.arctan2(v - centre[1], u - centre[0]), np.hypot(u - centre[0], v - centre[1])
    reach = np.ones(shape)
    for k in (2, 3, 4, 5):
        reach += rng.uniform(0.01, 0.06) * np.cos(k * angle + rng.uniform(0, 2 * np.pi))
    return np.asarray(distance < radius * reach)
