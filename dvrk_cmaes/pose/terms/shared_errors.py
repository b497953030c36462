"""Errors that many points of a mask's contour share: a margin all round, a shadow beside the shaft.

A segmenter's errors do not average out along the contour. What stretches of contour share is described by M errors, px
outwards, that are normal with zero mean and independent of each other: a margin of the whole mask; the error of each
side of the shaft, as a whole and at nodes every 8 mm between which it is linear; and for each other link the error of
what faces forwards, backwards and to each side. These are consider parameters: nobody asks for their values, and they
are eliminated, so that the pose is told only by what they cannot explain. The errors of both sides of the shaft as a
whole last for some tenths of a second: images of a session that follow each other share them, too.

Their standard deviations are in proportion to the noise of the frame's contour. Noise that stays the same over more
contour than a segmentation's usually does tells of shadows, which lie on the sides of the shaft above all. The factors
were fitted to the tips of 563 made frames of three generators, of which 248 are of followed recordings whose masks have
shadows that last for seconds; the kinds of masks are those of smooth and of rough segmenters.
"""

from __future__ import annotations

from dataclasses import dataclass

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

LASTING = 2
"""Number of shared errors of a view, the first ones, that last from frame to frame: both sides of the shaft's."""

DIRECTIONS = np.array([[1.0, -1.0, 0.0, 0.0], [0.0, 0.0, 1.0, -1.0]])
"""Right, left, down and up in the image, (2, 4)."""

MEAN_ERRORS = 1 + LASTING + DIRECTIONS.shape[1]
"""Number of the mean errors of all masks (`mean_errors`)."""

_NODES = 0.008  # m along the shaft
_LEAST_POINTS = 4  # of the outline that an error changes, for it to count
_AHEAD = 0.004  # m, to another point of the shaft's axis
NEAREST = 1e-3  # m; points that are nearer, or behind the camera, are taken to be this far away

# Standard deviations, in those of the contour's noise.
_MARGIN, _NODE, _SIDE, _LINK = 0.1, 0.2, 0.15, 0.15
_LEAST_SIDE = 0.25  # px, of a side of the shaft
# The same, in those of the part of the noise that stays the same over more contour than usual.
_SIDE_OF_LONG, _LINK_OF_LONG = 0.8, 0.3
_USUALLY_SEEN = 0.5  # px, of an error at a pose, beyond which it is larger than usual by ...
_SEEN_FACTOR = 2.0  # ... that many standard deviations a pixel
_MOST_SEEN = 8.0  # px
_LEAST_SHARE = 1e-9
_USUAL_LENGTH, _LENGTH_SCALE = 19.0, 17.0  # px of contour


@dataclass(frozen=True, eq=False)
class SharedErrors:
    """M shared errors of the N points of an outline.

    ``columns`` (N, M) are the shares with which each displaces the points outwards; ``deviations`` (M,), px, are their
    standard deviations. The first `LASTING` are those of both sides of the shaft as a whole, also where the outline
    has no such side, and the next one is the margin.
    """

    columns: Float64
    deviations: Float64

    def as_seen(self, offsets: Float64) -> SharedErrors:
        """Return the errors with standard deviations as large as the mask shows them, where that is more than usual.

        A shadow that is taken for the shaft moves one side of the mask by several pixels for a second. A few such
        frames would pull a session's solution as hard as many that are right: the farther a stretch of the mask lies
        from where a pose expects it, the less it tells. The margin of the whole mask stays as it is.

        Parameters
        ----------
        offsets : (N,)
            By how much the mask lies outwards of the outline's points, px.
        """
        shares = np.maximum(self.columns.sum(axis=0), _LEAST_SHARE)
        seen = self.columns.T @ np.clip(offsets, -_MOST_SEEN, _MOST_SEEN) / shares
        more = _SEEN_FACTOR * np.maximum(np.abs(seen) - _USUALLY_SEEN, 0.0)
        more[LASTING] = 0.0
        return SharedErrors(self.columns, np.hypot(self.deviations, more))

    @property
    def information(self) -> Float64:
        """What is known of the errors beforehand, (M, M)."""
        return np.diag(1 / self.deviations**2)


def shared_errors(
    outline: OutlinePoints, instrument: Instrument, camera: Camera, seen: Posed, noise: OutlineNoise
) -> SharedErrors:
    """Return the shared errors of the outline of one pose ``seen`` in a camera, for a contour with some noise."""
    normals = outline.normals / np.linalg.norm(outline.normals, axis=1)[:, None]
    axis = image_axis(instrument, camera, seen)
    ahead, aside = normals @ axis, normals @ np.array([-axis[1], axis[0]])
    shaft, sides = _sides(outline, instrument, aside)
    side, link = side_deviation(noise), np.hypot(_LINK * noise.sigma, _LINK_OF_LONG * _long(noise))
    groups = [(np.column_stack(sides).astype(np.float64), side), (np.ones((len(ahead), 1)), _MARGIN * noise.sigma)]
    groups += [(_between_nodes(outline, instrument, of_side), _NODE * noise.sigma) for of_side in sides]
    for number in np.flatnonzero(np.bincount(outline.link[~shaft])):
        facing = np.maximum(np.column_stack([ahead, -ahead, aside, -aside]), 0.0)
        groups.append((facing * (outline.link == number)[:, None], link))
    columns = np.concatenate([values for values, _ in groups], axis=1)
    deviations = np.concatenate([np.full(values.shape[1], deviation) for values, deviation in groups])
    counts = (columns > 0).sum(axis=0) >= _LEAST_POINTS
    counts[: LASTING + 1] = True  # the margin, too
    return SharedErrors(columns[:, counts], deviations[counts])


def mean_errors(outline: OutlinePoints, instrument: Instrument, camera: Camera, seen: Posed) -> Float64:
    """Return the displacements of an outline's points by mean errors of all masks, times the normals' lengths, px.

    They are (N, 7): by a margin all round, by the errors of both sides of the shaft, and by those of what faces right,
    left, down and up in the image, px each. Arguments are as in `shared_errors`.
    """
    along, aside = image_axis(instrument, camera, seen)
    _, sides = _sides(outline, instrument, outline.normals @ np.array([-aside, along]))
    length = np.linalg.norm(outline.normals, axis=1)
    facing = np.maximum(outline.normals @ DIRECTIONS, 0.0)
    return np.column_stack([length, *(length * side for side in sides), facing])


def _sides(outline: OutlinePoints, instrument: Instrument, aside: Float64) -> tuple[Bool, list[Bool]]:
    """Return which points (N,) are of the shaft, and of each side of it; ``aside`` (N,) is how they face across it."""
    shaft = outline.link == 0 if instrument.shaft is not None else np.zeros(len(aside), dtype=np.bool_)
    return shaft, [shaft & (sign * aside > 0) for sign in (1.0, -1.0)]


def side_deviation(noise: OutlineNoise) -> float:
    """Return the standard deviation, px, of the error of a side of the shaft as a whole."""
    return float(np.sqrt((_SIDE * noise.sigma) ** 2 + (_SIDE_OF_LONG * _long(noise)) ** 2 + _LEAST_SIDE**2))


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


def _long(noise: OutlineNoise) -> float:
    """Return the standard deviation, px, of the part of the noise that stays the same over more contour than usual."""
    return float(noise.sigma * np.sqrt(max(noise.length - _USUAL_LENGTH, 0.0) / _LENGTH_SCALE))


def without_last(terms: Quadratic, information: Float64) -> Quadratic:
    """Eliminate the last M unknowns of N quadratic terms, of which (M, M) is known beforehand, about zero.

    From terms of D + M unknowns, (N, D + M), to those of the first D, (N, D).
    """
    return Quadratic(*_kernel.eliminate_last(terms.information, terms.slope, information))


def _between_nodes(outline: OutlinePoints, instrument: Instrument, of_side: Bool) -> Float64:
    """Return the shares (N, M) of the errors at nodes along one side of the shaft in those of the outline's points."""
    if instrument.shaft is None or not of_side.any():
        return np.zeros((len(of_side), 0))
    along = (outline.points[of_side] - instrument.shaft.point) @ instrument.shaft.direction / _NODES
    nodes = np.arange(np.floor(along.min()), np.ceil(along.max()) + 1)
    shares = np.zeros((len(of_side), len(nodes)))
    shares[of_side] = np.maximum(1 - np.abs(along[:, None] - nodes), 0.0)
    return shares
