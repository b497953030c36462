"""Errors of a mask on one side of the instrument: a shadow that is taken for it, or an edge that a highlight cuts.

The shadow of an instrument has its outline, displaced in one direction. A mask that takes it for the instrument lies
outside the silhouette by a max(0, n . d), for normals n, a direction d in the image and a displacement of a px. It does
so near the wrist, where the instrument is near tissue. What cuts an edge, such as a highlight or tissue in front of it,
displaces one side of the shaft inwards along a stretch.

Which of these errors a mask has is not known; each is a hypothesis of a certain probability, under which its size is
positive and half normal. The errors of a hypothesis differ from those of a wrong distance of the instrument: they begin
at some place of the shaft, and they are on one side of wrist and jaws, too.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.camera import Camera
from dvrk_cmaes.geometry import Posed
from dvrk_cmaes.instrument import Instrument
from dvrk_cmaes.pose.terms.shared_errors import image_axis
from dvrk_cmaes.silhouette import OutlinePoints

Float64 = NDArray[np.float64]

_DIRECTIONS = 16  # in which a shadow may lie
_REACHES = np.array([0.007, 0.010, 0.015])  # m around a point of the axis, within which a mask takes it for the tool
_CENTRE = -0.003  # m along the shaft, from its distal end to that point
_SHADOW, _SHADOW_PX = 0.4, 5.0  # probability of a shadow, and standard deviation of its size
# Stretches, m along the shaft back from the point, that may be displaced inwards.
_STRETCHES = np.array([[-0.03, 0.004], [-0.03, 0.008], [-0.03, 0.014], [0.0, 0.008], [0.004, 0.015]])
_CUT, _CUT_PX = 0.2, 3.0  # probability of a side that is cut, and standard deviation of the size
_SOFT = 10.0  # px, in which an error begins and ends
_ASIDE = 0.5  # least cosine of the angle between the normal and the direction across, for a point of a side
_NEAREST = 1e-3  # m; a point that is nearer, or behind the camera, is taken to be this far away


@dataclass(frozen=True, eq=False)
class OneSidedErrors:
    """K hypotheses of a one-sided error of the N points of an outline.

    ``columns`` (N, K) are the shares of its size with which each displaces the points outwards, ``deviations`` (K,),
    px, the standard deviations of the sizes, and ``probabilities`` (K,) those of the hypotheses beforehand.
    """

    columns: Float64
    deviations: Float64
    probabilities: Float64


def one_sided_errors(outline: OutlinePoints, instrument: Instrument, camera: Camera, seen: Posed) -> OneSidedErrors:
    """Return the hypotheses for the outline of one pose ``seen`` in a camera; none for an instrument without a shaft.

    Their number does not depend on the outline.
    """
    if instrument.shaft is None:
        return OneSidedErrors(np.zeros((len(outline.pixels), 0)), np.zeros(0), np.zeros(0))
    normals = outline.normals / np.linalg.norm(outline.normals, axis=1)[:, None]
    shaft = instrument.shaft
    centre = seen.pose[:3, :3] @ (shaft.point + (shaft.distal_end + _CENTRE) * shaft.direction) + seen.pose[:3, 3]
    centre[2] = max(centre[2], _NEAREST)
    px_per_m = camera.fx / centre[2]
    apart = outline.pixels - camera.project(centre[None])[0]

    angles = 2 * np.pi * np.arange(_DIRECTIONS) / _DIRECTIONS
    facing = np.maximum(normals @ np.stack([np.cos(angles), np.sin(angles)]), 0.0)
    near = _ramp(_REACHES * px_per_m - np.linalg.norm(apart, axis=1)[:, None])
    shadows = (facing[:, :, None] * near[:, None, :]).reshape(len(normals), -1)

    axis = image_axis(instrument, camera, seen)
    aside, back = normals @ np.array([-axis[1], axis[0]]), -apart @ axis
    begin, end = _STRETCHES.T * px_per_m
    within = _ramp(back[:, None] - begin) * _ramp(end - back[:, None])
    sides = [(outline.link == 0) & (sign * aside > _ASIDE) for sign in (1.0, -1.0)]
    cuts = np.column_stack([-within * side[:, None] for side in sides])

    counts = shadows.shape[1], cuts.shape[1]
    return OneSidedErrors(
        columns=np.column_stack([shadows, cuts]),
        deviations=np.repeat([_SHADOW_PX, _CUT_PX], counts),
        probabilities=np.repeat([_SHADOW / counts[0], _CUT / counts[1]], counts),
    )


def _ramp(inside: Float64) -> Float64:
    """Return 0 far outside a limit and 1 far inside, by the distance inside it, px."""
    return np.asarray(np.clip(inside / _SOFT + 0.5, 0.0, 1.0))
