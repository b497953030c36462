"""What a session says of each of its frames before one looks at it, and how sure that is.

One ``camera_from_base`` and one offset a joint hold for the whole session (true = reading + offset). What is left from
frame to frame is a small deviation of each joint, of stated spread, and a little slack of the whole (lens, flexing).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.config import SessionConfig
from dvrk_cmaes.geometry import change_between, inverse, moved, shift_of_change
from dvrk_cmaes.instrument.arm import OUTER_JOINTS, ROLL_OFFSET, Arm, base_from_root
from dvrk_cmaes.pose.refine.priors import PosePrior

Float64 = NDArray[np.float64]

BASE_AXES = ("tx", "ty", "tz", "rx", "ry", "rz")
"""Small changes of camera_from_base, in the base's own axes."""

OUTER_OFFSETS = ("insertion", "roll")
"""Joints of the arm whose readings may be off by a constant; yaw's and pitch's are the base's rotation's to explain."""

_UNKNOWN = np.pi  # rad: the spread of a joint that was not read
_STEP = 1e-5


@dataclass(frozen=True, eq=False)
class Spreads:
    """Standard deviations from frame to frame: of the outer joints (4,), rad and m, and of the instrument's (J,), rad.

    ``slack`` (6,) is that of the root's pose along and about its own axes, m and rad, beside what the joints explain.
    """

    outer: Float64
    joints: Float64
    slack: Float64

    @classmethod
    def of(cls, config: SessionConfig, joint_names: Sequence[str]) -> Spreads:
        """Spreads as configured, before a session has shown its own."""
        outer = [np.deg2rad(config.arm_deg)] * 2 + [config.insertion_mm * 1e-3, np.deg2rad(config.roll_deg)]
        joints = np.deg2rad([config.jaw_deg if name == "jaw" else config.wrist_deg for name in joint_names])
        slack = [config.slack_mm * 1e-3] * 3 + [np.deg2rad(config.slack_deg)] * 3
        return cls(np.array(outer), joints, np.array(slack))


@dataclass(frozen=True, eq=False)
class Calibration:
    """One session's constants: ``camera_from_base`` (4, 4) and offsets (2 + J,) in the order of `SessionModel.axes`."""

    camera_from_base: Float64
    offsets: Float64

    def changed(self, step: Float64) -> Calibration:
        """Return the calibration after a step (6 + 2 + J,): the base's in its own axes, then the offsets'."""
        return Calibration(moved(self.camera_from_base, step[:6]), self.offsets + step[6:])


class SessionModel:
    """Predicts N frames from their readings.

    ``outer`` (N, 4) and ``joints`` (N, J) are readings, rad and m; those of the instrument's joints may be NaN.
    """

    def __init__(
        self,
        outer: Float64,
        joints: Float64,
        joint_names: Sequence[str],
        spreads: Spreads,
        *,
        arm: Arm = "classic",
        roll_offset: float = ROLL_OFFSET,
        stretch: Float64 | None = None,
    ) -> None:
        self.stretch = np.ones((len(outer), 1 + len(joint_names))) if stretch is None else stretch
        self.outer = outer
        self.joints = joints
        self.names = tuple(joint_names)
        self.spreads = spreads
        self._arm: Arm = arm
        self._roll_offset = roll_offset
        self._known = ~np.isnan(joints)

    @property
    def axes(self) -> tuple[str, ...]:
        """Names of a step's components."""
        return (*BASE_AXES, *OUTER_OFFSETS, *self.names)

    def with_spreads(self, spreads: Spreads) -> SessionModel:
        """Return the same readings with other spreads."""
        return self.of_readings(self.outer, self.joints, spreads, self.stretch)

    def with_stretch(self, stretch: Float64) -> SessionModel:
        """Return the same frames, the spreads of whose roll and joints are so many times as wide, (N, 1 + J)."""
        return self.of_readings(self.outer, self.joints, stretch=stretch)

    def of_readings(
        self, outer: Float64, joints: Float64, spreads: Spreads | None = None, stretch: Float64 | None = None
    ) -> SessionModel:
        """Return a model of other frames on the same arm."""
        used = self.spreads if spreads is None else spreads
        return SessionModel(
            outer, joints, self.names, used, arm=self._arm, roll_offset=self._roll_offset, stretch=stretch
        )

    def base_from_root(self, offsets: Float64) -> Float64:
        """Forward kinematics with offsets taken out of the readings, (N, 4, 4)."""
        outer = self.outer.copy()
        outer[:, 2] += offsets[0]
        outer[:, 3] += offsets[1]
        return base_from_root(outer, self._arm, roll_offset=self._roll_offset)

    def predict(self, calibration: Calibration) -> tuple[Float64, Float64]:
        """Poses (N, 4, 4) and joints (N, J) that are expected; a joint that was not read is expected at its offset."""
        read = np.where(self._known, self.joints, 0.0)
        poses = calibration.camera_from_base @ self.base_from_root(calibration.offsets)
        return np.asarray(poses), read + calibration.offsets[2:]

    def jacobian(self, calibration: Calibration) -> Float64:
        """Change of what is expected, in each root's axes, with a step of the calibration, (N, 6 + J, 6 + 2 + J)."""
        count = len(self.names)
        out = np.zeros((len(self.outer), 6 + count, 8 + count))
        out[:, :6, :6] = shift_of_change(inverse(self.base_from_root(calibration.offsets)))
        out[:, 2, 6] = 1.0  # insertion slides the root along its z axis, roll turns it about that
        out[:, 5, 7] = 1.0
        out[:, 6:, 8:] = np.eye(count)
        return out

    def outer_loadings(self, calibration: Calibration) -> Float64:
        """Give the changes (4, N, 6 + J) of frames with one standard deviation of each outer joint."""
        here = self.base_from_root(calibration.offsets)
        out = np.zeros((len(OUTER_JOINTS), len(here), 6 + len(self.names)))
        for k in range(len(OUTER_JOINTS)):
            outer = self.outer.copy()
            outer[:, k] += _STEP
            there = self.of_readings(outer, self.joints).base_from_root(calibration.offsets)
            out[k, :, :6] = change_between(here, there) * self.spreads.outer[k] / _STEP
        out[3] *= self.stretch[:, :1]
        return out

    def covariance(self, calibration: Calibration) -> Float64:
        """Covariance of a frame's pose and joints about what is expected, (N, 6 + J, 6 + J), in the root's axes."""
        count = len(self.names)
        loadings = self.outer_loadings(calibration)
        out = np.einsum("kni,knj->nij", loadings, loadings)
        out[:, :6, :6] += np.diag(self.spreads.slack**2)
        joint = np.where(self._known, (self.spreads.joints * self.stretch[:, 1:]) ** 2, _UNKNOWN**2)
        out[:, 6:, 6:] += joint[:, :, None] * np.eye(count)
        return np.asarray(out)

    def priors(self, calibration: Calibration, *, loosened: float = 1.0) -> list[PosePrior]:
        """Return what is expected of each frame, with the spreads ``loosened`` times as wide."""
        poses, joints = self.predict(calibration)
        information = np.linalg.inv(self.covariance(calibration) * loosened**2)
        return [PosePrior(p, q, i) for p, q, i in zip(poses, joints, information, strict=True)]

    def subset(self, index: Sequence[int] | NDArray[np.integer]) -> SessionModel:
        """Return the model of some of the frames."""
        return self.of_readings(self.outer[index], self.joints[index], stretch=self.stretch[index])


def outer_readings(readings: Sequence[Mapping[str, float]]) -> Float64:
    """Return readings of the outer joints of N frames, (N, 4), NaN where there are none."""
    return np.array([[r.get(name, np.nan) for name in OUTER_JOINTS] for r in readings]).reshape(-1, len(OUTER_JOINTS))
