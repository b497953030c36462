"""Smooth motion of an arm before a camera, as in a video: configurations that are passed one after the other."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import PchipInterpolator

from dvrk_cmaes.instrument import Instrument
from dvrk_cmaes.instrument.arm import OUTER_JOINTS, Arm, base_from_root
from dvrk_cmaes.synth.truth import Truth

Float64 = NDArray[np.float64]

SECONDS_BETWEEN: Final = (0.7, 1.6)
"""Range of the time from one configuration to the next, s."""


@dataclass(frozen=True, eq=False)
class ArmMotion:
    """Joint values of an arm and its instrument as smooth functions of time.

    ``path`` interpolates the outer joints and the instrument's joints, rad and m, at a time in seconds.
    """

    instrument: Instrument
    arm: Arm
    camera_from_base: Float64
    path: PchipInterpolator

    @classmethod
    def through(
        cls, camera_from_base: Float64, truths: Sequence[Truth], arm: Arm, rng: np.random.Generator
    ) -> ArmMotion:
        """Pass at least two configurations of an arm, the first of them at time 0.

        Between them every joint moves monotonically; the times from one to the next are random.
        """
        values = np.array([[*(truth.outer[name] for name in OUTER_JOINTS), *truth.values] for truth in truths])
        times = np.concatenate([[0.0], np.cumsum(rng.uniform(*SECONDS_BETWEEN, len(truths) - 1))])
        return cls(truths[0].instrument, arm, camera_from_base, PchipInterpolator(times, values))

    @property
    def seconds(self) -> float:
        """Time of the last configuration, s."""
        return float(self.path.x[-1])

    def at(self, time: float) -> Truth:
        """Return pose and joints at a time, s, at most that of the last configuration."""
        values = self.path(time)
        outer = dict(zip(OUTER_JOINTS, values[:4].tolist(), strict=True))
        joints = dict(zip(self.instrument.joint_names, values[4:].tolist(), strict=True))
        reached = base_from_root(outer, self.arm, roll_offset=self.instrument.roll_offset)
        return Truth(self.instrument, self.camera_from_base @ reached, joints, outer)
