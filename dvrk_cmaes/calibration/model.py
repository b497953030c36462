"""Prediction of each frame's pose and joints from a session's calibration and the frame's readings, with covariance.

One ``camera_from_base`` and one offset per joint hold for the whole session (true = reading + offset). The errors that
vary from frame to frame are independent and normal: an error of each joint's reading, and a small additional change of
the root's pose, the slack, for errors that no joint explains (lens distortion, flexing of the arm).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.calibration.blocks import BASE, OFFSETS, Base, Calibration, Offsets
from dvrk_cmaes.calibration.endoscope import Endoscope
from dvrk_cmaes.config import EstimateConfig, SessionConfig
from dvrk_cmaes.geometry import Bool, Float64, Posed, adjoint, inverse
from dvrk_cmaes.instrument import Instrument
from dvrk_cmaes.instrument.arm import OUTER_JOINTS, Arm, base_from_root_and_jacobian
from dvrk_cmaes.joints.names import ECM_JOINTS
from dvrk_cmaes.pose.terms.tips_term import Expected

ROLL: Final = 3
"""Place of roll among the errors that vary from frame to frame; the instrument's joints follow."""
_UNREAD_STD = np.pi  # rad, standard deviation of a joint that has no reading


def usual_deviations(config: SessionConfig, joint_names: Sequence[str]) -> Float64:
    """Return the configured standard deviations (10 + J,) of the errors that vary from frame to frame.

    They are those of the readings of the outer joints (4,), rad and m, and of the instrument's joints (J,), rad, then
    of the slack (6,), of the root's pose along and about its axes, m and rad. Their squares are variance components.
    """
    outer = [np.deg2rad(config.arm_deg)] * 2 + [config.insertion_mm * 1e-3, np.deg2rad(config.roll_deg)]
    joints = np.deg2rad([config.jaw_deg if name == "jaw" else config.wrist_deg for name in joint_names])
    return np.array([*outer, *joints, *[config.slack_mm * 1e-3] * 3, *[np.deg2rad(config.slack_deg)] * 3])


def spread_names(joint_names: Sequence[str]) -> tuple[str, ...]:
    """Return the names of standard deviations that differ: of all joints, and of the slack's places and rotations."""
    return (*OUTER_JOINTS, *joint_names, "slack_translation", "slack_rotation")


def named_deviations(deviations: Float64, joint_names: Sequence[str]) -> dict[str, float]:
    """Return standard deviations (10 + J,) by name."""
    return dict(zip(spread_names(joint_names), np.delete(deviations, [-5, -4, -2, -1]).tolist(), strict=True))


def offset_deviations(config: EstimateConfig, joint_names: Sequence[str]) -> Float64:
    """Return the standard deviations (2 + J,) of the offsets about zero before the session, m and rad."""
    angles = np.deg2rad([config.session.roll_offset_deg, *(config.readings.of(name) for name in joint_names)])
    return np.array([config.session.insertion_offset_mm * 1e-3, *angles])


@dataclass(frozen=True, eq=False)
class Correction:
    """Correction of the readings of roll and of the instrument's joints in N frames, beyond their offsets.

    ``values`` and ``variances`` (N, 1 + J), rad and rad^2, are the expected errors and the variances of these.
    """

    values: Float64
    variances: Float64

    @classmethod
    def none(cls, frames: int, joints: int) -> Correction:
        """Return the correction that changes nothing, for J joints."""
        return cls(np.zeros((frames, 1 + joints)), np.zeros((frames, 1 + joints)))

    def subset(self, index: Sequence[int] | NDArray[np.integer]) -> Correction:
        """Return the correction of the frames at some indices."""
        return Correction(self.values[index], self.variances[index])


@dataclass(frozen=True, eq=False)
class SessionModel:
    """Model that predicts the poses and joints of N frames from their readings and a calibration.

    Parameters
    ----------
    outer : (N, 4)
        Readings of the outer joints, rad and m.
    joints : (N, J)
        Readings of the instrument's joints, rad; NaN where there is none.
    names
        Names of the instrument's joints.
    usual, deviations : (10 + J,)
        Standard deviations of the errors that vary from frame to frame, as of `usual_deviations`: their initial
        values, and those now.
    arm, roll_offset
        Kinematics of the outer arm, as in `base_from_root`.
    inflation : (N, 1 + J)
        Factors on the standard deviations of roll and of the instrument's joints in each frame.
    correction
        What the cables are known to add to the readings of roll and of the instrument's joints.
    offset_std : (2 + J,)
        Prior standard deviations of the offsets about zero, m and rad.
    endoscope
        Where an endoscope that moves is in each frame; None for one that stands still.
    """

    outer: Float64
    joints: Float64
    names: tuple[str, ...]
    usual: Float64
    deviations: Float64
    arm: Arm
    roll_offset: float
    inflation: Float64
    correction: Correction
    offset_std: Float64
    endoscope: Endoscope | None = None
    _last: dict[bytes, tuple[Float64, Float64]] = field(default_factory=dict, init=False)

    @classmethod
    def of(
        cls,
        readings: Sequence[Mapping[str, float]],
        instrument: Instrument,
        config: EstimateConfig,
        arm: Arm,
        endoscope: Endoscope | None = None,
    ) -> SessionModel:
        """Return the model of frames, given the readings of each by joint name, rad and m."""
        names = instrument.joint_names
        joints, deviations = _columns(readings, names), usual_deviations(config.session, names)
        none, std = Correction.none(*joints.shape), offset_deviations(config, names)
        return cls(
            outer=outer_readings(readings),
            joints=joints,
            names=names,
            usual=deviations,
            deviations=deviations,
            arm=arm,
            roll_offset=instrument.roll_offset,
            inflation=np.ones(none.values.shape),
            correction=none,
            offset_std=std,
            endoscope=endoscope,
        )

    def calibration(self, camera_from_base: Float64, offsets: Float64) -> Calibration:
        """Return that of a base (4, 4), m, and offsets (2 + J,); an endoscope has the values of its start."""
        found = Calibration((Base(), Offsets(self.offset_std)), {BASE: camera_from_base, OFFSETS: offsets})
        moves = self.endoscope
        return found if moves is None else found.with_blocks(moves.block, endoscope=moves.start)

    def camera_from_base(self, calibration: Calibration) -> Float64:
        """Compute the base (N, 4, 4) in each frame's camera."""
        if self.endoscope is None or calibration.endoscope is None:
            return np.broadcast_to(calibration.camera_from_base, (len(self.outer), 4, 4))
        return np.asarray(self.endoscope.relative(calibration.endoscope)[0] @ calibration.camera_from_base)

    @property
    def _has_reading(self) -> Bool:
        return ~np.isnan(self.joints)

    def base_from_root(self, offsets: Float64) -> Float64:
        """Compute the forward kinematics (N, 4, 4) of the corrected readings and offsets (2 + J,)."""
        return self._kinematics(offsets)[0]

    def _kinematics(self, offsets: Float64) -> tuple[Float64, Float64]:
        """Compute the forward kinematics (N, 4, 4), and their Jacobian (N, 6, 4) by the outer joints.

        Those of the last offsets are kept, since one step of an estimation needs them several times.
        """
        key = offsets[:2].tobytes()
        if key not in self._last:
            outer = self.outer.copy()
            outer[:, 2] += offsets[0]
            outer[:, 3] += offsets[1] + self.correction.values[:, 0]
            self._last.clear()
            self._last[key] = base_from_root_and_jacobian(outer, self.arm, roll_offset=self.roll_offset)
        return self._last[key]

    def predict(self, calibration: Calibration) -> Posed:
        """Predict the root's pose in the camera and the joints of each of the N frames.

        A joint without a reading is predicted at its offset.
        """
        read = np.where(self._has_reading, self.joints, 0.0)
        poses = self.camera_from_base(calibration) @ self.base_from_root(calibration.offsets)
        at = Posed(np.asarray(poses), read + calibration.offsets[2:] + self.correction.values[:, 1:])
        for block in calibration.predicted:
            if (change := block.change(self, calibration)) is not None:
                at = at.moved(change)
        return at

    def jacobian(self, calibration: Calibration) -> Float64:
        """Compute the Jacobian (N, 6 + J + E, K) of the predictions by a step of the calibration.

        Changes of the predictions are in each root's axes, m and rad, followed by those of the E unknowns that change
        what is seen.
        """
        count, places = 6 + len(self.names), [calibration.place(block.name) for block in calibration.seen]
        further = np.concatenate([np.zeros(0, np.intp), *(np.r_[place] for place in places)])
        out = np.zeros((len(self.outer), count + len(further), len(calibration.deviation)))
        for block in calibration.predicted:
            out[:, :count] = block.carried(out[:, :count], calibration)
            out[:, :count, calibration.place(block.name)] = block.derivative(self, calibration)
        out[:, count + np.arange(len(further)), further] = 1.0
        return out

    @property
    def spreads(self) -> dict[str, float]:
        """Standard deviations from frame to frame by name, for those who correct by the offsets only."""
        off = np.pad(np.std(self.correction.values, axis=0), (ROLL, 6))
        return named_deviations(np.hypot(self.deviations, off), self.names)

    def root_from_camera(self, calibration: Calibration) -> Float64:
        """Compute the matrices (N, 6, 6) that turn small changes in the axes of the reference camera to the roots'."""
        return adjoint(inverse(calibration.camera_from_base @ self.base_from_root(calibration.offsets)))

    def by_errors(self, calibration: Calibration) -> Float64:
        """Compute the changes (N, 6 + J, 10 + J) of the predictions by the errors that vary from frame to frame.

        They are in the root's axes and of the joints, m and rad; zero by a joint that has no reading.
        """
        out = np.zeros((len(self.outer), 6 + len(self.names), len(self.deviations)))
        out[:, :6, : ROLL + 1] = self._kinematics(calibration.offsets)[1]
        out[:, 6:, ROLL + 1 : -6] = np.eye(len(self.names)) * self._has_reading[:, None]
        out[:, :6, -6:] = np.eye(6)
        return out

    @property
    def std(self) -> Float64:
        """Standard deviations (N, 10 + J) of the errors that vary from frame to frame, in each frame."""
        return self.deviations * np.pad(self.inflation, ((0, 0), (ROLL, 6)), constant_values=1.0)

    def covariance(self, calibration: Calibration) -> Float64:
        """Compute the covariance (N, 6 + J, 6 + J) of each frame's pose and joints, given a calibration.

        Axes are the changes of the root's pose in its own axes and the joints, m and rad.
        """
        variances = self.std**2 + np.pad(self.correction.variances, ((0, 0), (ROLL, 6)))
        by_errors = self.by_errors(calibration)
        out = (by_errors * variances[:, None]) @ np.swapaxes(by_errors, 1, 2)
        out[:, 6:, 6:] += np.eye(len(self.names)) * np.where(self._has_reading, 0.0, _UNREAD_STD**2)[:, None]
        if self.endoscope is not None and calibration.endoscope is not None:
            moves = self.root_from_camera(calibration) @ self.endoscope.relative(calibration.endoscope)[2]
            out[:, :6, :6] += moves @ np.swapaxes(moves, 1, 2)
        return np.asarray(out)

    def priors(self, calibration: Calibration) -> list[Expected]:
        """Return the prior of each frame's pose and joints."""
        predicted = self.predict(calibration)
        information = np.linalg.inv(self.covariance(calibration))
        return [Expected(predicted[k], of_frame) for k, of_frame in enumerate(information)]

    def subset(self, index: Sequence[int] | NDArray[np.integer]) -> SessionModel:
        """Return the model of the frames at some indices."""
        return replace(
            self,
            outer=self.outer[index],
            joints=self.joints[index],
            inflation=self.inflation[index],
            correction=self.correction.subset(index),
            endoscope=None if self.endoscope is None else self.endoscope.subset(index),
        )


def ecm_readings(readings: Sequence[Mapping[str, float]]) -> Float64:
    """Return the ECM's readings of N frames as an array (N, 4), rad and m; NaN where there is none."""
    return _columns(readings, ECM_JOINTS)


def outer_readings(readings: Sequence[Mapping[str, float]]) -> Float64:
    """Return the outer joints' readings of N frames as an array (N, 4), rad and m; NaN where there is none."""
    return _columns(readings, OUTER_JOINTS)


def _columns(readings: Sequence[Mapping[str, float]], names: Sequence[str]) -> Float64:
    """Return the readings of some joints as an array (N, K); NaN where there is none."""
    return np.array([[own.get(name, np.nan) for name in names] for own in readings]).reshape(-1, len(names))


def frames_alike(times: Float64, seconds: float) -> Float64:
    """Return the number of frames (N,), itself included, that err like each frame and count as one with it.

    Parameters
    ----------
    times : (N,)
        Times of the frames, s; frames without one (NaN) count by themselves.
    seconds
        Time in which frames err alike.
    """
    known, out = np.isfinite(times), np.ones(len(times))
    in_order, half = np.sort(times[known]), seconds / 2
    first = np.searchsorted(in_order, times[known] - half, side="left")
    out[known] = np.searchsorted(in_order, times[known] + half, side="right") - first
    return out
