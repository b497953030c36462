"""Prediction of the state from one image to the next, and of pose and joints from the state."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from math import cos, sin

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.config import TrackConfig
from dvrk_cmaes.geometry import Posed, adjoint, change_between, inverse, moved
from dvrk_cmaes.instrument.arm import Arm, base_from_root
from dvrk_cmaes.joints.cables import CableModel
from dvrk_cmaes.joints.sparse import LEAST_ERROR
from dvrk_cmaes.track.reading_buffer import ReadingAt
from dvrk_cmaes.track.state import FilterState, Layout

Float64 = NDArray[np.float64]

_STEP = 1e-5  # rad or m, of differences of the arm's kinematics
_ROLL = 3
_UNMODELLED_PLAY = 0.25  # share of the variance by play that a model of the cables leaves


@dataclass(frozen=True, eq=False)
class Anchor:
    """Readings on which a state's pose is based: ``outer`` (4,), ``joints`` (J,), and their rates per second.

    A joint without a reading keeps its last value, and what it does since is part of the state. ``outer_read`` and
    ``joint_read`` (J,) tell which were read, ``based`` whether the outer joints ever were, so that the base is the
    arm's. ``expected`` (1 + J,), rad, are the errors of roll and of the joints that a model of the cables expects
    there, None without one. ``frozen`` (J,) are readings of joints that stand still with those of the outer joints, NaN
    where there is none: what they tell is where the joints were, not how they move; None if none was looked at.
    ``sparse`` (4,) is how far the outer joints may be off between readings; None where that is not known.
    """

    outer: Float64
    joints: Float64
    outer_rate: Float64
    joint_rate: Float64
    outer_read: bool
    joint_read: NDArray[np.bool_]
    based: bool = False
    expected: Float64 | None = None
    frozen: Float64 | None = None
    sparse: Float64 | None = None

    @staticmethod
    def none(joints: int) -> Anchor:
        """Return the anchor before any reading, for J joints."""
        return Anchor(np.zeros(4), np.zeros(joints), np.zeros(4), np.zeros(joints), False, np.zeros(joints, np.bool_))

    @property
    def known(self) -> Float64:
        """Readings (J,) of the joints, also those that stand still; NaN where there is none."""
        frozen = np.full(len(self.joints), np.nan) if self.frozen is None else self.frozen
        return np.asarray(np.where(self.joint_read, self.joints, frozen))

    def moves_from(self, before: Anchor) -> bool:
        """Whether the outer joints are read, and their readings differ from those ``before``."""
        return self.outer_read and not np.array_equal(before.outer, self.outer)

    def then(self, reading: ReadingAt, *, moving: bool = True, expected: Float64 | None = None) -> Anchor:
        """Return the anchor of later readings; if they are not ``moving``, they are not used.

        ``expected`` (1 + J,) are the errors that a model of the cables expects of them.
        """
        outer_read = reading.has_outer and moving
        joint_read = ~np.isnan(reading.joints) & moving
        return Anchor(
            reading.outer if outer_read else self.outer,
            np.where(joint_read, reading.joints, self.joints),
            reading.outer_rate if outer_read else np.zeros(4),
            np.where(joint_read, reading.joint_rate, 0.0),
            outer_read,
            joint_read,
            self.based or outer_read,
            expected,
            None if moving else reading.joints,
            None if reading.sparse is None else reading.sparse.error,
        )


class MotionModel:
    """How the arm moves the instrument, and how the errors of its readings change.

    ``arm`` and ``roll_offset`` are the kinematics of the outer joints, as in `base_from_root`. ``cables`` is the model
    of the cables of roll and of the instrument's joints, None without one.
    """

    def __init__(
        self, config: TrackConfig, joints: int, arm: Arm, roll_offset: float, cables: CableModel | None = None
    ) -> None:
        self._cables = cables
        self._config = config
        self._at = Layout(joints)
        self._arm: Arm = arm
        self._roll_offset = roll_offset

    def _corrected(self, state: FilterState, anchor: Anchor) -> Float64:
        """Return the outer readings (4,) with the offset of roll."""
        outer = anchor.outer.copy()
        outer[_ROLL] += state.offsets[0]
        return outer

    def _root(self, state: FilterState, anchor: Anchor) -> Float64:
        """Return the pose (4, 4) of the root in the base by the readings."""
        yaw, pitch, insertion, roll = anchor.outer.tolist()
        angle = roll + float(state.offsets[0])
        turn = np.eye(4)
        turn[0, 0] = turn[1, 1] = cos(angle)
        turn[1, 0] = sin(angle)
        turn[0, 1] = -turn[1, 0]
        return np.asarray(_without_roll(yaw, pitch, insertion, self._arm, self._roll_offset) @ turn)

    def posed(self, state: FilterState, anchor: Anchor) -> Posed:
        """Return the root's pose in the camera and the joints of a state."""
        root = self._root(state, anchor)
        return Posed(state.camera_from_base @ root @ state.slack, anchor.joints + state.offsets[1:])

    def loadings(self, state: FilterState, anchor: Anchor) -> Float64:
        """Return the derivative (6 + J, D) of the small changes of pose and joints by the errors of the state."""
        return self.linearised(state, anchor)[1]

    def linearised(self, state: FilterState, anchor: Anchor) -> tuple[Posed, Float64]:
        """Return pose and joints of a state, and their `loadings`."""
        at, count = self._at, self._at.joints
        moved_root = self._root(state, anchor) @ state.slack
        out = np.zeros((6 + count, at.size))
        from_base, from_root = adjoint(inverse(np.array([moved_root, state.slack])))
        out[:6, at.base] = from_base
        out[:6, at.roll] = from_root[:, 5]
        out[:6, at.slack] = np.eye(6)
        out[6:, at.offsets] = np.eye(count)
        return Posed(state.camera_from_base @ moved_root, anchor.joints + state.offsets[1:]), out

    def slack_covariance(self, state: FilterState, anchor: Anchor, lag_std: float) -> Float64:
        """Return the covariance (6, 6) of what readings of the outer joints do not explain of the root's pose.

        ``lag_std``, s, is the standard deviation of the lag.
        """
        c = self._config
        outer = self._corrected(state, anchor)
        ends = base_from_root(
            np.concatenate([outer + _STEP * np.eye(4), outer[None]]), self._arm, roll_offset=self._roll_offset
        )
        by_joint = _small_change(ends[4], ends[:4]) / _STEP
        late = lag_std * (anchor.outer_rate @ by_joint)
        of_readings = np.array([*[np.deg2rad(c.arm_deg)] * 2, c.insertion_mm * 1e-3, 0.0])
        if anchor.sparse is not None:
            of_readings = np.where(anchor.sparse > LEAST_ERROR, np.hypot(of_readings, anchor.sparse), of_readings)
        errors = by_joint * of_readings[:, None]
        own = [c.slack_mm * 1e-3] * 3 + [np.deg2rad(c.slack_deg)] * 3
        return np.asarray(errors.T @ errors + np.diag(np.square(own)) + np.outer(late, late))

    def _drift(self, elapsed: float) -> Float64:
        """Return the variances (1 + J,) of what the offsets change in some time, s, by themselves: the wander."""
        drift = np.full(1 + self._at.joints, np.deg2rad(self._config.offset_drift_deg) ** 2 * elapsed)
        if self._cables is not None:
            drift += 2 * self._cables.wander**2 * elapsed / self._cables.seconds
        return drift

    def predict(
        self, state: FilterState, before: Anchor, anchor: Anchor, elapsed: float, lag_std: float
    ) -> tuple[FilterState, Float64]:
        """Return the state after ``elapsed`` s, in which the readings went from one anchor to the next.

        The derivative (D, D) of its error by that of the state before is returned, too.
        """
        at, c = self._at, self._config
        transition = np.eye(at.size)
        noise = np.zeros((at.size, at.size))
        diagonal = np.einsum("ii->i", noise)
        diagonal[at.base] = np.square([c.base_drift_mm * 1e-3] * 3 + [np.deg2rad(c.base_drift_deg)] * 3) * elapsed
        drift, play = self._drift(elapsed), np.deg2rad(c.offset_play_deg)
        if self._cables is not None:
            play *= _UNMODELLED_PLAY
        diagonal[at.roll] = drift[0] + play * abs(anchor.outer[_ROLL] - before.outer[_ROLL])
        again = anchor.joint_read & ~before.joint_read
        diagonal[at.offsets] = drift[1:] + play * np.where(again, 0.0, np.abs(anchor.joints - before.joints))
        late = lag_std**2
        diagonal[at.roll] += late * (anchor.outer_rate[_ROLL] - before.outer_rate[_ROLL]) ** 2
        diagonal[at.offsets] += late * (anchor.joint_rate - before.joint_rate) ** 2
        keep = float(np.exp(-elapsed / c.rate_seconds))
        along = c.rate_seconds * (1 - keep)  # s; the distance moved at a velocity that decays
        joint_rate = np.arange(at.rate.start + 6, at.rate.stop)
        pose_rate = np.arange(at.rate.start, at.rate.start + 6)
        slack, rate, offsets = state.slack, state.rate.copy(), state.offsets.copy()
        unread = ~anchor.joint_read
        offsets += _expected_change(before, anchor)
        # a joint that is read again stays where it is
        offsets[1:] += np.where(again, before.joints - anchor.joints, 0.0)
        offsets[1:] += np.where(unread, along * rate[6:], 0.0)
        offset_index = np.arange(at.offsets.start, at.offsets.stop)
        transition[offset_index[unread], joint_rate[unread]] = along
        transition[joint_rate, joint_rate] = np.where(unread, keep, 0.0)
        wide = np.deg2rad(c.joint_acceleration_deg) ** 2
        diagonal[joint_rate] = np.where(unread, wide * elapsed, 0.0)
        diagonal[offset_index[unread]] += wide * elapsed**3 / 3
        rate[6:] *= np.where(unread, keep, 0.0)
        if anchor.outer_read:
            # where the outer joints are read again, the pose follows from the base
            stay = float(np.exp(-elapsed / c.slack_seconds)) if before.outer_read else 0.0
            slack = moved(np.eye(4), stay * change_between(np.eye(4), slack))
            transition[at.slack, at.slack] = stay * np.eye(6)
            noise[at.slack, at.slack] = (1 - stay**2) * self.slack_covariance(state, anchor, lag_std)
            transition[pose_rate, pose_rate] = 0.0
            rate[:6] = 0.0
        else:
            slack = moved(slack, along * rate[:6])
            transition[at.slack, pose_rate] = along * np.eye(6)
            transition[pose_rate, pose_rate] = keep
            own = np.square(
                [c.acceleration_mm * 1e-3] * 3
                + [np.deg2rad(c.swing_acceleration_deg)] * 2
                + [np.deg2rad(c.joint_acceleration_deg)]
            )
            diagonal[pose_rate] = own * elapsed
            diagonal[at.slack] += own * elapsed**3 / 3
            rate[:6] *= keep
        covariance = transition @ state.covariance @ transition.T + noise
        covariance = (covariance + covariance.T) / 2
        return replace(state, offsets=offsets, slack=slack, rate=rate, covariance=covariance), transition


@lru_cache(maxsize=8)
def _without_roll(yaw: float, pitch: float, insertion: float, arm: Arm, roll_offset: float) -> Float64:
    """Return the pose (4, 4) of the root in the base at a reading of roll of zero; roll turns it about its z axis."""
    return base_from_root(np.array([yaw, pitch, insertion, 0.0]), arm, roll_offset=roll_offset)


def _expected_change(before: Anchor, anchor: Anchor) -> Float64:
    """Return how the cables change the offsets (1 + J,) of the joints that were read before and are read now."""
    read = np.concatenate([[before.outer_read and anchor.outer_read], before.joint_read & anchor.joint_read])
    if before.expected is None or anchor.expected is None:
        return np.zeros(len(read))
    return np.where(read, anchor.expected - before.expected, 0.0)


def _small_change(pose: Float64, other: Float64) -> Float64:
    """Return the changes (..., 6) from a pose (4, 4) to others (..., 4, 4) that hardly differ from it."""
    relative = inverse(pose) @ other
    axes = [relative[..., 2, 1], relative[..., 0, 2], relative[..., 1, 0]]
    return np.concatenate([relative[..., :3, 3], np.stack(axes, axis=-1)], axis=-1)
