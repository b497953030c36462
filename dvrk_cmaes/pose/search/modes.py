"""Modes: poses far enough apart that no refinement leads from one to the other."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.geometry import rotation_angle

Float64 = NDArray[np.float64]


class HasPose(Protocol):
    """Anything with a pose, joints and a score; lower scores are better."""

    @property
    def camera_from_root(self) -> Float64:
        """(4, 4)."""

    @property
    def joints(self) -> Float64:
        """(J,) rad."""

    @property
    def score(self) -> float:
        """Lower is better."""


P = TypeVar("P", bound=HasPose)


def apart(a: HasPose, b: HasPose, angle: float, joint: float) -> bool:
    """Whether two poses differ by more than an angle of rotation or by more than that in some joint, rad."""
    turned = float(rotation_angle(a.camera_from_root, b.camera_from_root))
    return turned > angle or bool(np.abs(a.joints - b.joints).max(initial=0.0) > joint)


def best_of_each(
    candidates: Sequence[P], *, angle: float = np.deg2rad(15), joint: float = np.deg2rad(25), most: int | None = None
) -> list[P]:
    """Return the best candidate of each mode, the best mode first."""
    kept: list[P] = []
    for candidate in sorted(candidates, key=lambda c: c.score):
        if all(apart(candidate, other, angle, joint) for other in kept):
            kept.append(candidate)
        if len(kept) == most:
            break
    return kept
