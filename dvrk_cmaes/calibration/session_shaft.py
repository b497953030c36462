"""What a session's frames tell of the radius of the shaft, against that of the instrument.

A thicker shaft looks as wide as a thinner one nearby. The arm tells the distance of the remote centre and of the wrist,
so a session tells both apart, beside the focal length of a camera whose file is right.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from dvrk_cmaes.calibration.constants import CLEAR, Constant, Linearised, OutlineOfView, ViewAsSeen
from dvrk_cmaes.geometry import Float64, apply
from dvrk_cmaes.io.encode import Document
from dvrk_cmaes.io.typed_document import Number
from dvrk_cmaes.pose.terms.shared_errors import NEAREST

SHAFT = "shaft"
"""Name of the constant."""

_STD = 0.01  # of the logarithm of the radius, between tools of one kind
_WEAK_STD = 0.5  # of the same where it is asked which tool is there
_LEAST = 0.05
"""Share of the radius, beyond which a shaft is another one.

A margin that is taken off all masks explains a part of it; in nine made recordings the right one was found to 0.5 %.
"""


class ShaftRadius(Constant):
    """The logarithm (1,) of the factor on the radius of the shaft, of an instrument with some radius, m."""

    is_linear = True

    def __init__(self, radius: float) -> None:
        super().__init__(SHAFT, np.array([_STD]))
        self._radius = radius

    def seen(self, name: str, by: ViewAsSeen, values: Float64) -> ViewAsSeen:
        """Return the view as it is: the outlines are linearised with the instrument as it is."""
        return by

    def effect(self, outline: OutlineOfView) -> Float64:
        """Return the displacements of the points on both sides of the shaft by its radius."""
        view, points = outline.view, outline.points
        sides = view.sides_of_shaft(points, outline.at).sum(axis=1)
        seen = outline.at.seen_from(view.view_from_camera)
        depth = np.maximum(apply(seen.pose, points.points)[:, 2], NEAREST)
        length = np.linalg.norm(points.normals, axis=1)
        return np.asarray(sides * length * view.camera.fx * self._radius / depth)[:, None]


@dataclass(frozen=True)
class SessionShaft(Document):
    """The factor on the radius of the instrument's shaft that a session's frames fit, and its standard deviation."""

    radius_scale: Number
    std_radius_scale: Number

    @classmethod
    def of(cls, there: Linearised, known: Mapping[str, Float64 | float]) -> SessionShaft:
        """Tell the factor from outlines that were linearised in it, with what is known of other constants."""
        values, covariance = there.with_std({**known, SHAFT: _WEAK_STD})
        place = there.solution.calibration.place(SHAFT).start
        scale = float(np.exp(values[place]))
        return cls(scale, scale * float(np.sqrt(covariance[place, place])))

    @property
    def contradicts(self) -> bool:
        """Whether the frames contradict the radius of the instrument."""
        return abs(self.radius_scale - 1) > max(_LEAST, CLEAR * self.std_radius_scale)

    def contradiction(self) -> str:
        """Say by how much the frames contradict the radius of the instrument's shaft; empty where they do not."""
        if not self.contradicts:
            return ""
        than = "thicker" if self.radius_scale > 1 else "thinner"
        return (
            f"the shaft is {100 * abs(self.radius_scale - 1):.0f} % (std {100 * self.std_radius_scale:.0f}) {than} "
            "than the instrument's: another instrument (--instrument), or another focal length than the camera file's"
        )
