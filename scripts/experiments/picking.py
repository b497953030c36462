"""Simulation of open-loop picking: an arm is calibrated once, moves by its readings alone, and closes its jaws.

The model
---------
Reading and truth. A reading r of a joint differs from the true value q. The errors of the arm's own joints (yaw, pitch,
insertion) are independent noise in each pose, 0.1 deg and 0.4 mm. The error of a cable-driven joint (roll, wrist pitch,
wrist yaw, jaw) is its error at the start plus a stretch that is proportional to the joint's motion since then:

    q - r = (q0 - r0) - c (r - r0)

A cable under friction and load stretches in proportion to its motion. The error is therefore linear in the joint's own
motion, as is assumed by the linear compensation of measured dVRK errors (Hwang et al., "Efficiently Calibrating
Cable-Driven Surgical Robots with RGBD Fiducial Sensing, Temporal Windowing, and Linear and Recurrent Neural Network
Compensation", 2020, arXiv 2003.08520). Hysteresis and coupling of the joints are not modelled.

The constant c is derived from published errors of a dVRK arm against fiducials: 12 deg rms of wrist pitch and 16 deg
rms of wrist yaw, over 5,531 poses in the whole range of the joints. Joints that are uniformly distributed over +-80 deg
have an rms of 80 / sqrt(3), and the stretch in this model is c times that: c = sqrt((12^2 + 16^2) / 2) / (80 / sqrt(3))
= 0.31. The whole published error is taken for stretch, and none of it for bias, so c is rather too large.

Control. The calibration is the result of one frame: a pose of the root in the camera and joint values. The base is
computed with the outer readings, so it contains the roll's bias, as on a robot. The controller knows the exact position
of the object and solves the inverse kinematics with the calibration. The motors reach the commanded readings exactly.

Grasping. The jaws open by 50 deg and close. A needle, a semicircle of radius 11.46 mm that lies across the jaws, is
picked if it passes between the jaws, at a distance from the yaw axis between 3 mm and the distance of the tips. A gauze
is a square with sides of 76 mm, perpendicular to the direction of the jaws. It is picked if both tips are within its
sides and below its surface and the yaw axis is above it. The intended depth of the tips is 4 mm.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from dvrk_cmaes.geometry import change_between, inverse
from dvrk_cmaes.instrument import Instrument
from dvrk_cmaes.instrument.arm import OUTER_JOINTS, base_from_root

Float64 = NDArray[np.float64]

ARM_NOISE: Final = {"yaw": np.deg2rad(0.1), "pitch": np.deg2rad(0.1), "insertion": 0.0004}
PUBLISHED_RMS_DEG: Final = {"wrist_pitch": 12.0, "wrist_yaw": 16.0}
WRIST_RANGE_DEG: Final = 80.0
STRETCH: Final = float(np.sqrt(np.mean(np.square(list(PUBLISHED_RMS_DEG.values())))) / (WRIST_RANGE_DEG / np.sqrt(3)))
"""c: the share of a cable-driven joint's motion that is lost by stretch."""

OPENING: Final = float(np.deg2rad(50.0))
NEEDLE_RADIUS: Final = 0.01146
GAUZE_SIDE: Final = 0.076
INNER_REACH: Final = 0.003  # m from the yaw axis, beyond which the jaws hold an object
GRASP_SHARE: Final = 0.7  # of the tips' distance from the yaw axis: position of the needle in the jaws
GAUZE_DEPTH: Final = 0.004  # m, intended depth of the tips below the surface
INSERTIONS: Final = (0.06, 0.22)  # m
_JAW_LINK: Final = "wrist_yaw_link"  # its z axis is the jaws' axis, its y axis the direction of the closed jaws


@dataclass(frozen=True, eq=False)
class Gripper:
    """The jaws of an instrument; ``reach`` is the distance of the tips from the yaw axis, m."""

    instrument: Instrument
    reach: float = field(init=False)

    def __post_init__(self) -> None:
        distances = [np.linalg.norm(tip.position) for tip in self.instrument.jaw_tips]
        object.__setattr__(self, "reach", float(np.mean(distances)))

    def root_from_jaws(self, wrist: Mapping[str, float]) -> Float64:
        """Return the pose (4, 4) of the link that carries the jaws, in the root link; joints by name, rad."""
        joints = np.array([wrist[name] for name in self.instrument.joint_names])
        index = [joint.child for joint in self.instrument.chain.joints].index(_JAW_LINK)
        return np.asarray(self.instrument.chain.forward(joints, [index])[0])


@dataclass(frozen=True, eq=False)
class Start:
    """The arm at its calibration: ``camera_from_base`` (4, 4), and all seven true joints and readings by name."""

    camera_from_base: Float64
    true: Mapping[str, float]
    read: Mapping[str, float]


@dataclass(frozen=True, eq=False)
class Calibration:
    """Calibration from one frame: ``camera_from_base`` (4, 4), and offsets of the wrist's readings, rad."""

    camera_from_base: Float64
    offsets: Mapping[str, float]

    @staticmethod
    def of(camera_from_root: Float64, joints: Mapping[str, float], start: Start) -> Calibration:
        """Calibrate with a frame's pose and joints and the outer readings, all taken for true."""
        base = np.asarray(camera_from_root @ inverse(base_from_root(start.read)))
        return Calibration(base, {name: joints[name] - start.read[name] for name in joints if name in start.read})


def camera_from_jaws(gripper: Gripper, camera_from_base: Float64, joints: Mapping[str, float]) -> Float64:
    """Return the pose (4, 4) of the jaws' link in the camera."""
    return np.asarray(camera_from_base @ base_from_root(joints) @ gripper.root_from_jaws(joints))


def predicted_jaws(gripper: Gripper, calibration: Calibration, read: Mapping[str, float]) -> Float64:
    """Return the pose (4, 4) of the jaws' link in the camera that the calibration predicts for readings."""
    joints = {name: value + calibration.offsets.get(name, 0.0) for name, value in read.items()}
    return camera_from_jaws(gripper, calibration.camera_from_base, joints)


def command(gripper: Gripper, calibration: Calibration, start: Start, goal: Float64) -> dict[str, float] | None:
    """Find the readings for which the calibration predicts a goal (4, 4) of the jaws; None if it is out of reach."""
    names = [*OUTER_JOINTS, *(name for name in gripper.instrument.joint_names if name != "jaw")]
    scale = np.array([1e-3] * 3 + [np.deg2rad(0.5)] * 3)

    def readings(values: Float64) -> dict[str, float]:
        jaw = OPENING - calibration.offsets.get("jaw", 0.0)
        return {**dict(zip(names, values.tolist(), strict=True)), "jaw": jaw}

    def residuals(values: Float64) -> Float64:
        return np.asarray(change_between(goal, predicted_jaws(gripper, calibration, readings(values))) / scale)

    found = least_squares(residuals, [start.read[name] for name in names], x_scale="jac", max_nfev=40)
    if found.cost > 1e-2:
        return None
    read = readings(found.x)
    limits = dict(zip(gripper.instrument.joint_names, gripper.instrument.limits, strict=True))
    beyond = any(not limits[n][0] <= read[n] <= limits[n][1] for n in names if n in limits)
    return None if beyond or not INSERTIONS[0] < read["insertion"] < INSERTIONS[1] else read


def moved_truth(
    start: Start, read: Mapping[str, float], noise: Mapping[str, float], stretch: float
) -> dict[str, float]:
    """Return the true joints at readings that were reached; ``noise`` is that of the arm's own joints in sigmas."""
    true = {}
    for name, value in read.items():
        if name in ARM_NOISE:
            true[name] = value + noise[name] * ARM_NOISE[name]
        else:
            true[name] = value + start.true[name] - start.read[name] - stretch * (value - start.read[name])
    return true


def grasp_point(gripper: Gripper, jaws: Float64) -> Float64:
    """Return the point (3,), m in the camera, at which jaws with a pose (4, 4) should hold a needle."""
    return np.asarray(jaws[:3, 3] + GRASP_SHARE * gripper.reach * jaws[:3, 1])


def picks_needle(gripper: Gripper, jaws: Float64, opening: float, goal: Float64) -> bool:
    """Check whether a needle placed for jaws at ``goal`` passes between jaws at ``jaws``, open by an angle, rad."""
    angle = np.linspace(-np.pi / 2, np.pi / 2, 361)
    circle = NEEDLE_RADIUS * np.stack([np.cos(angle) - 1, np.zeros_like(angle), np.sin(angle)], axis=1)
    needle = grasp_point(gripper, goal) + circle @ goal[:3, :3].T
    seen = (needle - jaws[:3, 3]) @ jaws[:3, :3]
    crossing = np.flatnonzero(np.diff(np.sign(seen[:, 2])) != 0)
    for k in crossing:
        share = seen[k, 2] / (seen[k, 2] - seen[k + 1, 2])
        x, y = (seen[k] + share * (seen[k + 1] - seen[k]))[:2]
        if INNER_REACH < np.hypot(x, y) < gripper.reach and abs(np.arctan2(x, y)) < opening / 2:
            return True
    return False


def gauze_goal(gripper: Gripper, goal: Float64) -> Float64:
    """Return the pose (4, 4) of a gauze placed for jaws at ``goal``: its centre, x and z along its sides, y into it."""
    gauze = goal.copy()
    tips = gripper.reach * np.cos(OPENING / 2)
    gauze[:3, 3] = goal[:3, 3] + (tips - GAUZE_DEPTH) * goal[:3, 1]
    return gauze


def picks_gauze(gripper: Gripper, jaws: Float64, opening: float, goal: Float64) -> bool:
    """Check whether both tips of jaws at ``jaws``, open by an angle, are in a gauze placed for jaws at ``goal``."""
    half = opening / 2
    tips = gripper.reach * np.array([[side * np.sin(half), np.cos(half), 0.0] for side in (-1, 1)])
    gauze = gauze_goal(gripper, goal)
    seen = (tips @ jaws[:3, :3].T + jaws[:3, 3] - gauze[:3, 3]) @ gauze[:3, :3]
    yaw_axis = (jaws[:3, 3] - gauze[:3, 3]) @ gauze[:3, 1]
    within = np.abs(seen[:, [0, 2]]).max() < GAUZE_SIDE / 2
    return bool(within and (seen[:, 1] > 0).all() and yaw_axis < 0)
