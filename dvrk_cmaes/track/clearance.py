"""How far lines across an outline run within the silhouette and beside it, before they meet the outline again."""

from __future__ import annotations

from typing import Final

import numpy as np

from dvrk_cmaes.geometry import Float32, Float64

MOST_CLEARANCE: Final = 10
"""Longest piece of a line on either side of the outline that is looked at, in pixels of the image as it is sampled."""

_LARGEST_SCALE = 4  # of an image that is sampled at a reduced size

_BESIDE = 2.0  # px, farthest distance from a line of a point at which the outline crosses it
_OPPOSED = -0.2  # cosine between normals, below which a point lies on another side of the instrument
_NEXT = 1.0  # px along the line, within which a point is the same crossing


def clearance_of(pixels: Float64, normals: Float64) -> Float32:
    """Find where the lines through outline points (N, 2) along their normals (N, 2) cross the outline again.

    Returns the lengths (2, N), px, of the lines within the silhouette and beside it, as far as they are looked at.
    """
    at, outwards = pixels.astype(np.float32), normals.astype(np.float32)
    tangents = outwards[:, ::-1] * np.array([1, -1], np.float32)
    along = outwards @ at.T - np.einsum("nd,nd->n", outwards, at)[:, None]
    across = tangents @ at.T - np.einsum("nd,nd->n", tangents, at)[:, None]
    row, column = np.nonzero((np.abs(across) < _BESIDE) & (outwards @ outwards.T < _OPPOSED))
    distance = along[row, column]
    lengths = np.full((2, len(at)), _LARGEST_SCALE * MOST_CLEARANCE, np.float32)
    for side, away in zip(lengths, (-distance, distance), strict=True):
        beyond = away > _NEXT
        np.minimum.at(side, row[beyond], away[beyond])
    return lengths
