"""Points that are fixed on an instrument, in an image, and how they move there with pose and joints."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import accumulate, pairwise
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes import _kernel
from dvrk_cmaes.camera import Camera
from dvrk_cmaes.geometry import Float64, Posed
from dvrk_cmaes.instrument import Instrument
from dvrk_cmaes.silhouette.renderer import kernel_camera


class FixedPoints(Protocol):
    """N points on links."""

    @property
    def link(self) -> NDArray[np.integer[Any]]:
        """Index of the link of each point, (N,)."""

    @property
    def points(self) -> Float64:
        """The points (N, 3) in the links' frames, m."""

    @property
    def normals(self) -> Float64:
        """Directions (N, 2) in the image along which motion is measured, in units of their lengths."""


@dataclass(frozen=True, eq=False)
class MovingPoints:
    """N points in an image.

    depth : (N,) m. pixels : (N, 2). jacobian : (N, 6 + J), px, derivatives of their displacements along their normals,
    times the normals' lengths, by the small changes of `Posed`. Points that are nearer than 1 mm, or behind the camera,
    are projected as if they were this far away.
    """

    depth: Float64
    pixels: Float64
    jacobian: Float64


def moving_points(
    instrument: Instrument, camera: Camera, fixed: Sequence[FixedPoints], at: Posed
) -> list[MovingPoints]:
    """Project the points of each of C poses, which are in the camera's frame, and compute their motion."""
    root_from_link, by_joint = instrument.forward_with_derivatives(at.joints)
    ends = np.array(list(accumulate((len(group.points) for group in fixed), initial=0)), dtype=np.int64)
    link, points, normals = (joined(fixed, name) for name in ("link", "points", "normals"))
    moved = _kernel.move_points(
        kernel_camera(camera),
        ends,
        np.asarray(link, dtype=np.int64),
        points,
        normals,
        np.ascontiguousarray(at.pose),
        root_from_link,
        by_joint,
    )
    return [MovingPoints(*(array[begin:end] for array in moved)) for begin, end in pairwise(ends.tolist())]


def joined(groups: Sequence[object], name: str) -> NDArray[Any]:
    """Return one array of the same name of several groups, one after another; a single one is not copied."""
    arrays = [getattr(group, name) for group in groups]
    return np.ascontiguousarray(arrays[0] if len(arrays) == 1 else np.concatenate(arrays))
