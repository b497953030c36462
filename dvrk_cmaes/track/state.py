"""State of the filter: the arm's base, offsets of readings, and the motion that no reading explains."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.geometry import change_between, moved

Float64 = NDArray[np.float64]


@dataclass(frozen=True)
class Layout:
    """Indices of the parts of an error of the state, for an instrument with ``joints`` = J joints.

    base : small change of camera_from_base in the base's axes. roll : offset of the roll's reading. offsets : offsets
    of the instrument's joints. slack : small change of the root's pose in its own axes that no
    reading explains. rate : velocity of the root in its own axes, and of the joints, that no reading explains.
    """

    joints: int

    base = slice(0, 6)
    roll = 6

    @property
    def offsets(self) -> slice:
        """Offsets of the J joints."""
        return slice(7, 7 + self.joints)

    @property
    def slack(self) -> slice:
        """Change of the root's pose that no reading explains."""
        return slice(7 + self.joints, 13 + self.joints)

    @property
    def rate(self) -> slice:
        """Velocities that no reading explains."""
        return slice(13 + self.joints, 19 + 2 * self.joints)

    @property
    def size(self) -> int:
        """Number of components."""
        return 19 + 2 * self.joints


@dataclass(frozen=True, eq=False)
class FilterState:
    """Mean and covariance of the state.

    The root's pose in the camera is ``camera_from_base @ base_from_root(readings) @ slack``. ``offsets`` (1 + J,), rad,
    are those of roll and the joints: true = reading + offset. ``slack`` is (4, 4);
    ``rate`` (6 + J,) per second; ``covariance`` (D, D) in the order of `Layout`.
    """

    camera_from_base: Float64
    offsets: Float64
    slack: Float64
    rate: Float64
    covariance: Float64

    @property
    def layout(self) -> Layout:
        """Indices of the parts."""
        return Layout(len(self.offsets) - 1)

    def changed(self, step: Float64) -> FilterState:
        """Return the state after an error (D,) is added to the mean."""
        at = self.layout
        base, slack = moved(np.array([self.camera_from_base, self.slack]), np.array([step[at.base], step[at.slack]]))
        return replace(
            self,
            camera_from_base=base,
            offsets=self.offsets + step[at.roll : at.offsets.stop],
            slack=slack,
            rate=self.rate + step[at.rate],
        )

    def difference(self, other: FilterState) -> Float64:
        """Return the error (D,) that changes the mean into another state's."""
        parts = [
            change_between(self.camera_from_base, other.camera_from_base),
            other.offsets - self.offsets,
            change_between(self.slack, other.slack),
            other.rate - self.rate,
        ]
        return np.concatenate(parts)
