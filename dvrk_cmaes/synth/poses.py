"""Random true poses of frames: of an arm that moves about its remote centre of motion (RCM), or independent poses.

Poses are drawn at random and rejected unless the instrument is well visible (`is_sensible`). All random numbers come
from the given generator, so that a seed determines the frames.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from dvrk_cmaes.camera import Camera
from dvrk_cmaes.errors import DvrkCmaesError
from dvrk_cmaes.geometry import Float64, frame_along, rotation_about_z, transform
from dvrk_cmaes.instrument import Instrument
from dvrk_cmaes.instrument.arm import INSERTION_OFFSET, OUTER_JOINTS, ROLL_OFFSET, Arm, base_from_root
from dvrk_cmaes.joints.names import WRIST_JOINTS
from dvrk_cmaes.silhouette import Body
from dvrk_cmaes.synth.scene import links_seen
from dvrk_cmaes.synth.truth import Truth, pose_from_view

_SWING: Final = 0.25  # rad, largest yaw and pitch of the arm, of either sign
_ROLL: Final = 2.0  # rad, largest roll, of either sign
_INSERTIONS: Final = (0.10, 0.17)  # m, range of the insertion of the Classic with a tool 400xxx
_MIDDLE_INSERTION: Final = (0.12, 0.15)  # m, insertion at which the root is in the middle of the view
_LARGEST_BEND: Final = 1.0  # rad, largest wrist pitch and wrist yaw, of either sign
_OPENINGS: Final = (0.15, 1.1)  # rad, range of the jaw's opening


@dataclass(frozen=True)
class ViewLimits:
    """Limits of the accepted poses. Angles in degrees, lengths in m; pixels are those of an image of 640 x 480.

    Parameters
    ----------
    least_tilt
        Least angle between the shaft and the optical axis.
    arm_tilt
        Smallest and largest angle between the shaft and the optical axis in the middle of the arm's range.
    least_bend
        Least norm of wrist pitch and wrist yaw; with a straight wrist, pose and mirror twin look alike.
    least_jaw
        Least number of visible pixels of each jaw.
    least_shaft
        Least visible length of the shaft's straight part.
    margin
        Least distance of the wrist and the tips from the image's border, px.
    depths
        Smallest and largest depth of the wrist and the tips.
    """

    least_tilt: float = 28.0
    arm_tilt: tuple[float, float] = (48.0, 68.0)
    least_bend: float = 26.0
    least_jaw: int = 350
    least_shaft: float = 0.010
    margin: float = 45.0
    depths: tuple[float, float] = (0.07, 0.16)


DEFAULT_VIEW_LIMITS: Final = ViewLimits()


def arm_session(
    body: Body,
    camera: Camera,
    rng: np.random.Generator,
    frames: int,
    view: ViewLimits = DEFAULT_VIEW_LIMITS,
    *,
    arm: Arm = "classic",
    attempts: int = 20_000,
) -> tuple[Float64, list[Truth]]:
    """Draw a pose of an arm's base, and configurations of the arm until enough of them are accepted.

    If too few of 60 configurations a frame are accepted, another pose of the base is drawn.

    Returns
    -------
    camera_from_base : (4, 4)
    truths
        The true pose of each frame.

    Raises
    ------
    DvrkCmaesError
        Too few configurations were accepted in ``attempts``.
    """
    while attempts > 0:
        camera_from_base = _random_base(body.instrument, arm, rng, view)
        truths: list[Truth] = []
        for _ in range(60 * frames):
            attempts -= 1
            truth = _arm_truth(body.instrument, arm, camera_from_base, rng)
            if is_sensible(camera, truth, view):
                truths.append(truth)
            if len(truths) == frames:
                return camera_from_base, truths
    raise DvrkCmaesError(f"no arm was found whose frames of {body.instrument.name} are sensible pictures")


def free_poses(
    body: Body,
    camera: Camera,
    rng: np.random.Generator,
    frames: int,
    view: ViewLimits = DEFAULT_VIEW_LIMITS,
    *,
    attempts: int = 20_000,
) -> list[Truth]:
    """Draw independent poses of an instrument; DvrkCmaesError if too few were accepted in ``attempts``."""
    truths: list[Truth] = []
    for _ in range(attempts):
        if len(truths) == frames:
            return truths
        pose = pose_from_view(
            camera,
            wrist=(rng.uniform(0.2, 0.8) * camera.width, rng.uniform(0.2, 0.8) * camera.height),
            depth=rng.uniform(*view.depths),
            tilt=np.deg2rad(rng.uniform(view.least_tilt, 75.0)),
            heading=rng.uniform(-np.pi, np.pi),
            roll=rng.uniform(-np.pi, np.pi),
        )
        truth = Truth(body.instrument, pose, _wrist(body.instrument, rng))
        if is_sensible(camera, truth, view):
            truths.append(truth)
    raise DvrkCmaesError(f"no poses of {body.instrument.name} were found that are sensible pictures")


def _random_base(instrument: Instrument, arm: Arm, rng: np.random.Generator, view: ViewLimits) -> Float64:
    """Draw a pose ``camera_from_base`` (4, 4) of an arm that reaches the middle of the view."""
    middle = np.array([rng.uniform(-0.006, 0.006), rng.uniform(-0.006, 0.006), rng.uniform(0.10, 0.12)])
    tilt, heading = np.deg2rad(rng.uniform(*view.arm_tilt)), rng.uniform(-np.pi, np.pi)
    direction = np.array([np.sin(tilt) * np.cos(heading), np.sin(tilt) * np.sin(heading), np.cos(tilt)])
    insertion = rng.uniform(*_MIDDLE_INSERTION) + _shift(instrument, arm)
    reached = base_from_root([0.0, 0.0, insertion, 0.0], arm, roll_offset=instrument.roll_offset)
    rcm_to_root = np.linalg.norm(reached[:3, 3])
    # with all joints at zero the shaft points along the base's negative z axis
    rotation = frame_along(-direction) @ rotation_about_z(rng.uniform(-np.pi, np.pi))
    return transform(rotation, middle - rcm_to_root * direction)


def _shift(instrument: Instrument, arm: Arm) -> float:
    """Return the insertion to add so that an arm and a tool reach as far as the Classic with a tool 400xxx, m."""
    return (INSERTION_OFFSET["classic"] + ROLL_OFFSET) - (INSERTION_OFFSET[arm] + instrument.roll_offset)


def _arm_truth(instrument: Instrument, arm: Arm, camera_from_base: Float64, rng: np.random.Generator) -> Truth:
    swing = rng.uniform(-_SWING, _SWING, 2)
    insertion = rng.uniform(*_INSERTIONS) + _shift(instrument, arm)
    outer = dict(zip(OUTER_JOINTS, (*swing, insertion, rng.uniform(-_ROLL, _ROLL)), strict=True))
    joints = _wrist(instrument, rng)
    reached = base_from_root(outer, arm, roll_offset=instrument.roll_offset)
    return Truth(instrument, camera_from_base @ reached, joints, outer)


def _wrist(instrument: Instrument, rng: np.random.Generator) -> dict[str, float]:
    """Draw an instrument's joint values: wrist pitch and yaw within 1 rad, jaws open, any other within its limits."""
    pitch, yaw = rng.uniform(-_LARGEST_BEND, _LARGEST_BEND, 2)
    drawn = dict(zip(WRIST_JOINTS, (pitch, yaw, rng.uniform(*_OPENINGS)), strict=True))
    joints = {}
    for name, (low, high) in zip(instrument.joint_names, instrument.limits, strict=True):
        value = drawn[name] if name in drawn else rng.uniform(low, high)
        joints[name] = float(np.clip(value, low, high))
    return joints


def is_sensible(camera: Camera, truth: Truth, view: ViewLimits = DEFAULT_VIEW_LIMITS) -> bool:
    """Whether wrist and jaws are well visible, within the limits, and only the root link meets the image's border."""
    points = np.concatenate([truth.wrist, truth.tips])
    size = np.array([camera.width, camera.height])
    scale = camera.width * camera.height / (640 * 480)
    margin = view.margin * np.sqrt(scale)
    if points[:, 2].min() < view.depths[0] or points[:, 2].max() > view.depths[1]:
        return False
    pixels = camera.project(points)
    if np.any(pixels < margin) or np.any(pixels > size - 1 - margin):
        return False
    on_shaft = truth.point_on_shaft(view.least_shaft)
    if truth.camera_from_root[2, 2] > np.cos(np.deg2rad(view.least_tilt)) or on_shaft[2] < view.depths[0] / 2:
        return False
    if np.any(camera.project(on_shaft) < 0) or np.any(camera.project(on_shaft) > size - 1):
        return False
    bend = np.hypot(truth.joints.get("wrist_pitch", 0.0), truth.joints.get("wrist_yaw", 0.0))
    if bend < np.deg2rad(view.least_bend):
        return False
    root, jaws = 0, [tip.link for tip in truth.instrument.jaw_tips]
    link = links_seen(camera, truth)
    border = np.concatenate([link[0], link[-1], link[:, 0], link[:, -1]])
    return bool(
        (border == root).sum() >= 20
        and not np.any(border > root)
        and all((link == jaw).sum() >= view.least_jaw * scale for jaw in jaws)
    )
