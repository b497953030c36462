"""Open-loop picking, simulated: an arm that is calibrated once, moves by its readings alone, and closes its jaws.

The model
---------
Reading and truth. A reading r of a joint differs from the true value q. The arm's own joints (yaw, pitch, insertion)
are off by independent noise in each pose, 0.1 deg and 0.4 mm. The cable-driven ones (roll, wrist pitch, wrist yaw, jaw)
are off by what they are off at the start, and by a stretch that grows with how far the joint has turned since:

    q - r = (q0 - r0) - c (r - r0)

A cable that must overcome friction and load stretches in proportion to how far it pulls: the error is linear in the
joint's own motion, which is what linear compensation of measured dVRK errors assumes (Hwang et al., "Efficiently
Calibrating Cable-Driven Surgical Robots with RGBD Fiducial Sensing, Temporal Windowing, and Linear and Recurrent Neural
Network Compensation", 2020, arXiv 2003.08520). Hysteresis and coupling of the joints are left out.

The one constant c is set by published errors of a dVRK arm against fiducials: 12 deg rms of wrist pitch and 16 deg
rms of wrist yaw, over 5,531 poses all over the joints' range. Of joints spread evenly over +-80 deg, whose rms is
80 / sqrt(3), the stretch of this model is c times that: c = sqrt((12^2 + 16^2) / 2) / (80 / sqrt(3)) = 0.31. All of the
published error is counted as stretch, none as bias, so c is rather too large.

Control. The calibration is what one frame gives: a pose of the root in the camera and joint values. The base follows
from the outer readings, so the roll's bias goes into it, as on a robot. The controller knows exactly where the object
is, solves the inverse kinematics of what it believes, and the motors reach the readings asked for exactly.

Grasping. The jaws open by 50 deg and close. A needle, half a circle of radius 11.46 mm lying across the jaws, is picked
if it passes between them: between 3 mm from the yaw axis and the tips' distance, within the opening. A gauze, 76 mm
square and square to the jaws, is picked if both tips are within its sides and below its surface, the yaw axis above it;
the tips are aimed 4 mm below.
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
"""c: the share of a cable-driven joint's motion that is lost."""

OPENING: Final = float(np.deg2rad(50.0))
NEEDLE_RADIUS: Final = 0.01146
GAUZE_SIDE: Final = 0.076
INNER_REACH: Final = 0.003  # m from the yaw axis: where jaws begin to hold
GRASP_SHARE: Final = 0.7  # of the tips' distance from the yaw axis: where the needle is aimed at
GAUZE_DEPTH: Final = 0.004  # m that the tips are aimed at below its surface
INSERTIONS: Final = (0.06, 0.22)  # m
_JAW_LINK: Final = "wrist_yaw_link"  # its z is the jaws' axis, its y where closed jaws point


@dataclass(frozen=True, eq=False)
class Gripper:
    """Jaws of an instrument in their link's frame; ``reach`` m from the yaw axis to the tips, joints by name."""

    instrument: Instrument
    reach: float = field(init=False)

    def __post_init__(self) -> None:
        distances = [np.linalg.norm(tip.position) for tip in self.instrument.jaw_tips]
        object.__setattr__(self, "reach", float(np.mean(distances)))

    def root_from_jaws(self, wrist: Mapping[str, float]) -> Float64:
        """Pose (4, 4) of the link that carries the jaws, in the root link."""
        joints = np.array([wrist[name] for name in self.instrument.joint_names])
        index = [joint.child for joint in self.instrument.chain.joints].index(_JAW_LINK)
        return np.asarray(self.instrument.chain.forward(joints, [index])[0])


@dataclass(frozen=True, eq=False)
class Start:
    """The arm where it is calibrated: ``camera_from_base`` (4, 4), true joints and readings, all seven, by name."""

    camera_from_base: Float64
    true: Mapping[str, float]
    read: Mapping[str, float]


@dataclass(frozen=True, eq=False)
class Calibration:
    """What is believed from one frame: ``camera_from_base`` (4, 4), and what to add to the wrist's readings, rad."""

    camera_from_base: Float64
    offsets: Mapping[str, float]

    @staticmethod
    def of(camera_from_root: Float64, joints: Mapping[str, float], start: Start) -> Calibration:
        """Take a frame's pose and joints for true, and the outer readings with them."""
        base = np.asarray(camera_from_root @ inverse(base_from_root(start.read)))
        return Calibration(base, {name: joints[name] - start.read[name] for name in joints if name in start.read})


def camera_from_jaws(gripper: Gripper, camera_from_base: Float64, joints: Mapping[str, float]) -> Float64:
    """Pose (4, 4) of the jaws' link in the camera."""
    return np.asarray(camera_from_base @ base_from_root(joints) @ gripper.root_from_jaws(joints))


def believed(gripper: Gripper, calibration: Calibration, read: Mapping[str, float]) -> Float64:
    """Pose of the jaws' link in the camera that the calibration puts it in."""
    joints = {name: value + calibration.offsets.get(name, 0.0) for name, value in read.items()}
    return camera_from_jaws(gripper, calibration.camera_from_base, joints)


def command(gripper: Gripper, calibration: Calibration, start: Start, goal: Float64) -> dict[str, float] | None:
    """Find the readings that bring the jaws to a goal (4, 4) in the camera, as believed; None if it is out of reach."""
    names = [*OUTER_JOINTS, *(name for name in gripper.instrument.joint_names if name != "jaw")]
    scale = np.array([1e-3] * 3 + [np.deg2rad(0.5)] * 3)

    def readings(values: Float64) -> dict[str, float]:
        jaw = OPENING - calibration.offsets.get("jaw", 0.0)
        return {**dict(zip(names, values.tolist(), strict=True)), "jaw": jaw}

    def residuals(values: Float64) -> Float64:
        return np.asarray(change_between(goal, believed(gripper, calibration, readings(values))) / scale)

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
    """Give the true joints at readings that were reached; ``noise`` in standard deviations of the arm's own joints."""
    true = {}
    for name, value in read.items():
        if name in ARM_NOISE:
            true[name] = value + noise[name] * ARM_NOISE[name]
        else:
            true[name] = value + start.true[name] - start.read[name] - stretch * (value - start.read[name])
    return true


def grasp_point(gripper: Gripper, jaws: Float64) -> Float64:
    """Where in the camera a needle is held best, (3,) m, of jaws at a pose (4, 4)."""
    return np.asarray(jaws[:3, 3] + GRASP_SHARE * gripper.reach * jaws[:3, 1])


def picks_needle(gripper: Gripper, jaws: Float64, opening: float, goal: Float64) -> bool:
    """Whether a needle laid for jaws at ``goal`` passes between jaws at ``jaws``, open by an angle; poses (4, 4)."""
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
    """Pose (4, 4) of a gauze laid for jaws at ``goal``: its middle, x and z along its sides, y into it."""
    gauze = goal.copy()
    tips = gripper.reach * np.cos(OPENING / 2)
    gauze[:3, 3] = goal[:3, 3] + (tips - GAUZE_DEPTH) * goal[:3, 1]
    return gauze


def picks_gauze(gripper: Gripper, jaws: Float64, opening: float, goal: Float64) -> bool:
    """Whether both tips of jaws at ``jaws``, open by an angle, are in a gauze laid for jaws at ``goal``."""
    half = opening / 2
    tips = gripper.reach * np.array([[side * np.sin(half), np.cos(half), 0.0] for side in (-1, 1)])
    gauze = gauze_goal(gripper, goal)
    seen = (tips @ jaws[:3, :3].T + jaws[:3, 3] - gauze[:3, 3]) @ gauze[:3, :3]
    yaw_axis = (jaws[:3, 3] - gauze[:3, 3]) @ gauze[:3, 1]
    within = np.abs(seen[:, [0, 2]]).max() < GAUZE_SIDE / 2
    return bool(within and (seen[:, 1] > 0).all() and yaw_axis < 0)
