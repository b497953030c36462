"""Errors that many points of a mask's contour share: a margin all round, a shadow beside the shaft.

A segmenter's errors do not average out along the contour. What stretches of contour share is described by M errors, px
outwards, that are normal with zero mean and independent of each other: a margin of the whole mask; the error of each
side of the shaft, as a whole and at nodes every 8 mm between which it is linear; and for each other link the error of
what faces forwards, backwards and to each side. These are consider parameters: nobody asks for their values, and they
are eliminated, so that the pose is determined only by what they cannot explain. The errors of both sides of the shaft
as a whole last for some tenths of a second: images of a session that follow each other share them, too.

Their standard deviations are in proportion to the noise of the frame's contour. Noise that stays the same over more
contour than a segmentation's usually does indicates shadows, which lie on the sides of the shaft above all. The factors
were fitted to the tips of 563 made frames of three generators, of which 248 are of followed recordings whose masks have
shadows that last for seconds; the kinds of masks are those of smooth and of rough segmenters.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes import _kernel
from dvrk_cmaes.camera import Camera
from dvrk_cmaes.evidence.outline_noise import OutlineNoise
from dvrk_cmaes.geometry import Posed
from dvrk_cmaes.instrument import Instrument
from dvrk_cmaes.pose.terms.term import Quadratic
from dvrk_cmaes.silhouette import OutlinePoints

Float64 = NDArray[np.float64]
Bool = NDArray[np.bool_]

SIDES = 2
"""Number of shared errors of a view, the first ones: of both sides of the shaft as a whole."""

SHOWN = _kernel.Shown(usual=0.5, factor=2.0, most=8.0)
"""How errors at a pose are larger than usual beyond 0.5 px: by 2 standard deviations a pixel, up to 8 px."""

_NODES = 0.008  # m along the shaft
_LEAST_POINTS = 4  # of the outline that an error changes, for it to count
_AHEAD = 0.004  # m, to another point of the shaft's axis
NEAREST = 1e-3  # m; points that are nearer, or behind the camera, are taken to be this far away

# Standard deviations, in those of the contour's noise.
_MARGIN, _NODE, _SIDE, _LINK = 0.1, 0.2, 0.15, 0.15
_LEAST_SIDE = 0.25  # px, of a side of the shaft
# The same, in those of the part of the noise that stays the same over more contour than usual.
_SIDE_OF_LONG, _LINK_OF_LONG = 0.8, 0.3
_USUAL_LENGTH, _LENGTH_SCALE = 19.0, 17.0  # px of contour


def shared_errors(
    outline: OutlinePoints,
    instrument: Instrument,
    camera: Camera,
    seen: Posed,
    noise: OutlineNoise,
    offsets: Float64 | None = None,
) -> tuple[Float64, Float64]:
    """Return the M shared errors of an outline of N points, of one pose ``seen`` in a camera with some noise.

    They are the shares (N, M) with which each displaces the points outwards, and their standard deviations (M,), px.
    The first `SIDES` are those of both sides of the shaft as a whole, also where the outline has no such side, and the
    next one is the margin.

    With ``offsets`` (N,), px, by which the mask lies outwards of the points, standard deviations are as large as the
    mask shows the errors, where that is more than usual. A shadow that is taken for the shaft moves one side of the
    mask by several pixels for a second. A few such frames would pull a session's solution as hard as many that are
    right: the farther a stretch of the mask lies from where a pose expects it, the less it weighs. The margin of the
    whole mask stays as it is.
    """
    link, points = outline.link.astype(np.int64), np.ascontiguousarray(outline.points)
    axis, known = image_axis(instrument, camera, seen).tolist(), deviations_of(noise)
    return _kernel.shared_errors(
        link, np.ascontiguousarray(outline.normals), points, axis, known, sharing(instrument), offsets, SHOWN
    )


def deviations_of(noise: OutlineNoise) -> list[float]:
    """Return the standard deviations of shared errors, px: a side of the shaft's, the margin, a node's, a link's."""
    sigma, length = noise.sigma, noise.length
    long = sigma * np.sqrt(max(length - _USUAL_LENGTH, 0.0) / _LENGTH_SCALE)  # of what is the same over more contour
    link = float(np.hypot(_LINK * sigma, _LINK_OF_LONG * long))
    side = float(np.sqrt((_SIDE * sigma) ** 2 + (_SIDE_OF_LONG * long) ** 2 + _LEAST_SIDE**2))
    return [side, _MARGIN * sigma, _NODE * sigma, link]


def sharing(instrument: Instrument) -> _kernel.Sharing:
    """Return which points of an instrument's outline share errors."""
    shaft = instrument.shaft
    axis = None if shaft is None else np.array([shaft.point, shaft.direction], dtype=np.float64)
    return _kernel.Sharing(axis, _NODES, _LEAST_POINTS)


def sides_of_shaft(outline: OutlinePoints, instrument: Instrument, camera: Camera, seen: Posed) -> Bool:
    """Return which points (N, 2) are on each side of the shaft. Arguments are as in `shared_errors`."""
    along, aside = image_axis(instrument, camera, seen)
    across = outline.normals @ np.array([[-aside, aside], [along, -along]])
    return np.asarray((across > 0) & (outline.link == 0)[:, None] & (instrument.shaft is not None))


def image_axis(instrument: Instrument, camera: Camera, seen: Posed) -> Float64:
    """Return the unit vector (2,) in the image along which the shaft points, at the root's origin.

    Parameters
    ----------
    instrument, camera
        The instrument; the camera that sees it.
    seen
        The pose in the camera's frame.
    """
    along = np.array([0.0, 0.0, 1.0]) if instrument.shaft is None else instrument.shaft.direction
    ends = seen.pose[:3, 3] - np.array([[0.0], [_AHEAD]]) * (seen.pose[:3, :3] @ along)
    ends[:, 2] = np.maximum(ends[:, 2], NEAREST)
    here, back = camera.project(ends)
    length = float(np.linalg.norm(here - back))
    return np.asarray((here - back) / length if length > 0 else np.array([1.0, 0.0]))


def without_last(terms: Quadratic, information: Float64) -> Quadratic:
    """Eliminate the last M unknowns of N quadratic terms, of which (M, M) is the prior information, about zero.

    From terms of D + M unknowns, (N, D + M), to those of the first D, (N, D).
    """
    return Quadratic(*_kernel.eliminate_last(terms.information, terms.slope, information))
