"""The last steps on a mask whose outline wavers: least squares that know how the outline's errors hang together.

A segmenter's outline wavers by a pixel or more over some twenty pixels. Points close to each other are then off by
nearly as much, so that their sum says little, but their difference, the place of a bend or the far end of an edge
against the near one, says a lot. Generalised least squares weigh sums and differences by what they are worth
(Aitken): with errors e of covariance C and rates J, the step solves (J C^-1 J^T + P) x = J C^-1 e - p, P and p from the
priors. C = s^2 (0.95 exp(-pi (d / 21)^2) + 0.05 * 21 I) and the pixel grid's, d px apart; its small uncorrelated
part, as large as all of the noise taken for white, stands for what of the errors is not smooth. What is more than
``_CLIP`` standard deviations off is a segmenter's mistake and left out.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.evidence.outline_noise import OutlineNoise, sampled
from dvrk_cmaes.geometry import moved
from dvrk_cmaes.pose.refine.outline import OutlineRefiner
from dvrk_cmaes.silhouette import OutlinePoints

Float64 = NDArray[np.float64]

SHARPER = 0.65
"""How much smaller the covariance of a pose is after these steps, as 90 % intervals on 236 made frames say."""

_ROUGHEST = 0.6  # px; a finer outline is mostly right to the pixel, and the outline's own loss does better
_LONGEST = 25.0  # px; what is off over longer stretches is the instrument's shape, not the segmenter
_WAVE = 21.0  # px
_SMOOTH = 0.95
_CLIP = 2.5
_REACH = 8  # px from the outline, within which the mask's edge is sought
_GRID = 1 / 12  # px^2
_INFLATION = 2.0  # of the variances: from the truth, the outline alone leads farther away than it says
_POINTS = 1000  # at most: the cost grows with their third power
_STEPS = 6
_LARGEST_STEP = 6.0  # standard deviations


def wavers(noise: OutlineNoise) -> bool:
    """Whether a mask's outline is of the kind that these steps are for."""
    return noise.sigma > _ROUGHEST and noise.length < _LONGEST


def fit_wavering(refiner: OutlineRefiner, pose: Float64, joints: Float64) -> tuple[Float64, Float64]:
    """Refine a pose (4, 4) and joints (J,) that are right but for the last millimetre, by a full-size refiner."""
    for _ in range(_STEPS):
        outline, rates = refiner.outline_rates(pose, joints)
        error, lengths = _offsets(refiner.mask, outline)
        known = np.isfinite(error) & (sampled(refiner.weight, outline.pixels) > 0.5)
        if known.sum() < 40:
            return pose, joints
        sigma = max(1.4826 * float(np.median(np.abs(error[known]))), 0.5)
        index = np.flatnonzero(known & (np.abs(error) < _CLIP * sigma))
        if len(index) > _POINTS:
            index = np.sort(np.random.default_rng(0).choice(index, _POINTS, replace=False))
        error, lengths, pixels = error[index], lengths[index], outline.pixels[index]
        rates = rates[index] / lengths[:, None]
        variance = max(float(np.mean(error**2)) - _GRID / 2, 0.02)
        apart = pixels[:, None] - pixels
        covariance = variance * _SMOOTH * np.exp(-np.pi / _WAVE**2 * np.einsum("ijk,ijk->ij", apart, apart))
        covariance[np.diag_indices(len(index))] += variance * (1 - _SMOOTH) * _WAVE + _GRID / lengths**2
        solved = np.linalg.solve(covariance, np.c_[rates, error])
        information, slope = rates.T @ solved[:, :-1] / _INFLATION, -rates.T @ solved[:, -1] / _INFLATION
        refiner.priors.add(information, slope, pose, joints)
        step = -np.linalg.solve(information, slope)
        size = float(np.sqrt(step @ information @ step))
        step *= min(1.0, _LARGEST_STEP / max(size, 1e-12))
        pose, joints = moved(pose, step[:6]), refiner.priors.held(joints + step[6:])
        if size < 0.3:
            break
    return pose, joints


def _offsets(mask: NDArray[np.bool_], outline: OutlinePoints) -> tuple[Float64, Float64]:
    """How far outside of each outline point the mask's edge is, px across the outline, NaN where there is none near.

    Sought along the row, or where the outline is flat the column. Also the length of outline of each point, px.
    """
    lengths = np.linalg.norm(outline.normals, axis=1)
    flat = np.abs(outline.normals[:, 0]) < np.abs(outline.normals[:, 1])
    error = np.full(len(lengths), np.nan)
    for vertical in (False, True):
        index = np.flatnonzero(flat == vertical)
        edges = np.diff((mask.T if vertical else mask).astype(np.int8), axis=1)
        along, across = outline.pixels[index].T[:: -1 if vertical else 1]
        outwards = np.sign(outline.normals[index, int(vertical)])
        row = np.clip(np.rint(across).astype(int), 0, len(edges) - 1)
        column = np.floor(along).astype(int)[:, None] + np.arange(-_REACH, _REACH + 1)
        seen = (column >= 0) & (column < edges.shape[1])
        found = edges[row[:, None], np.clip(column, 0, edges.shape[1] - 1)] == -outwards[:, None]
        off = np.where(seen & found, column + 0.5 - along[:, None], np.inf)
        nearest = off[np.arange(len(index)), np.abs(off).argmin(axis=1)]
        error[index] = np.where(np.isfinite(nearest), nearest * outwards, np.nan)
    return error / lengths, lengths
