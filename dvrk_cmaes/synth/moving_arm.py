"""Motion of an arm in a synthetic recording, and its readings: offsets, play and drift of cables, late images.

The errors of the cables are either drawn for each joint by itself, or those of the fits to recordings of a real arm
(`synth.cable_motion`).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np

from dvrk_cmaes.camera import Camera
from dvrk_cmaes.errors import DvrkCmaesError
from dvrk_cmaes.geometry import Float64, apply, inverse
from dvrk_cmaes.instrument.arm import OUTER_JOINTS, Arm, base_from_root, outer_joints_at
from dvrk_cmaes.joints.cable_prior import CableModel
from dvrk_cmaes.silhouette import Body
from dvrk_cmaes.synth.cable_motion import pulled
from dvrk_cmaes.synth.poses import ViewLimits, arm_session
from dvrk_cmaes.synth.truth import Truth

FRAMES_A_SECOND: Final = 30.0

_AMPLITUDES: Final[Mapping[str, float]] = {"yaw": 0.1, "pitch": 0.1, "insertion": 0.012, "roll": 0.7, "jaw": 0.4}
_OTHER_AMPLITUDE: Final = 0.6  # rad, of any other joint of the instrument
_PERIODS: Final = (3.5, 9.0)  # s, range of the periods at speed 1
_OUT_OF_VIEW: Final = (0.45, 0.03)  # rad of yaw and m of insertion by which an arm leaves the view
_LEAVES_AT: Final = 0.55  # share of the recording after which it leaves for a second
_LEAST_IN_VIEW: Final = 0.7  # of the frames, that have both tips in the image
_ATTEMPTS: Final = 60
_READING_NOISE: Final = 0.0012  # rad; for insertion 0.2 mm
_INSERTION_NOISE: Final = 2e-4
_SIZES: Final[Mapping[str, float]] = {"roll": 0.75, "jaw": 1.5}
"""Errors of joints relative to those of the wrist's."""
_PLAY_SECONDS: Final = 0.4  # over which the play goes from one side to the other


@dataclass(frozen=True)
class MotionLevel:
    """Difficulty of a recording.

    speed : relative to an arm that is moved slowly. lag : of the images, frames. offset_deg, play_deg, drift_deg : of
    the wrist's readings; those of roll are 0.75 times, those of the jaw 1.5 times these. shadow : share of the time in
    which a segmenter takes a shadow for the instrument. occluders : whether another shaft and tissue pass before the
    instrument. leaves : whether it leaves the view for a second.
    """

    speed: float
    lag: float
    offset_deg: float
    play_deg: float
    drift_deg: float
    shadow: float
    occluders: bool
    leaves: bool


MOTION_LEVELS: Final[Mapping[str, MotionLevel]] = {
    "clean": MotionLevel(1.0, 0.0, 4.0, 0.0, 0.0, 0.0, False, False),
    "easy": MotionLevel(1.0, 0.0, 4.0, 1.5, 1.0, 0.15, False, False),
    "medium": MotionLevel(1.5, 1.5, 5.0, 2.0, 1.5, 0.3, True, False),
    "hard": MotionLevel(2.5, 2.6, 8.0, 3.0, 2.0, 0.6, True, True),
}


def moving_arm(
    body: Body,
    camera: Camera,
    rng: np.random.Generator,
    frames: int,
    level: MotionLevel,
    cables: CableModel | None = None,
    *,
    arm: Arm = "classic",
    steered: Float64 | None = None,
) -> tuple[Float64, list[Truth], dict[str, Float64]]:
    """Draw the smooth motion of an arm whose readings move smoothly, and whose joints follow by its cables.

    Without ``cables`` the joints are where their readings are. ``steered`` (frames, 4, 4) are the poses of the first
    frame's camera in those of all frames, m: the arm then follows the camera, so that the instrument's root is where it
    would be in the images of a camera that stands still.

    Returns
    -------
    ((4, 4), list of Truth, dict)
        ``camera_from_base``, the truth of each frame, and the readings (frames,) by joint, without offsets and noise.

    Raises
    ------
    DvrkCmaesError
        No motion was found that keeps the instrument in view.
    """
    names = (*OUTER_JOINTS, *body.instrument.joint_names)
    limits = {name: tuple(pair) for name, pair in zip(body.instrument.joint_names, body.instrument.limits, strict=True)}
    for _ in range(_ATTEMPTS):
        base, (middle,) = arm_session(body, camera, rng, 1, ViewLimits(), arm=arm)
        centre = {**middle.outer, **middle.joints}
        paths = {}
        for name in names:
            path = centre[name] + _waves(rng, frames, _AMPLITUDES.get(name, _OTHER_AMPLITUDE), level.speed)
            paths[name] = np.clip(path, *limits[name]) if name in limits else path
        if level.leaves:
            out = _bump(frames)
            paths["yaw"] += rng.choice([-1.0, 1.0]) * _OUT_OF_VIEW[0] * out
            paths["insertion"] -= _OUT_OF_VIEW[1] * out
        readings = dict(paths)
        if cables is not None:
            for name, path in pulled(paths, cables, 1 / FRAMES_A_SECOND, rng).items():
                paths[name] = np.clip(path, *limits[name]) if name in limits else path
        outer = np.stack([paths[name] for name in OUTER_JOINTS], axis=1)
        poses = base @ base_from_root(outer, arm, roll_offset=body.instrument.roll_offset)
        if steered is not None:
            bases = steered @ base
            places = apply(inverse(bases), poses[:, :3, 3][:, None])[:, 0]
            followed = outer_joints_at(places, arm, roll_offset=body.instrument.roll_offset)
            for k, name in enumerate(OUTER_JOINTS[:3]):
                readings[name] = readings[name] + followed[:, k] - paths[name]
                paths[name] = followed[:, k]
            outer = np.stack([paths[name] for name in OUTER_JOINTS], axis=1)
            poses = bases @ base_from_root(outer, arm, roll_offset=body.instrument.roll_offset)
        truths = [
            Truth(
                body.instrument,
                pose,
                {name: float(paths[name][k]) for name in body.instrument.joint_names},
                {name: float(paths[name][k]) for name in OUTER_JOINTS},
            )
            for k, pose in enumerate(poses)
        ]
        seen = np.mean([_in_view(camera, truth) for truth in truths])
        if seen == 1.0 or (level.leaves and _LEAST_IN_VIEW < seen < 1.0):
            return base, truths, readings
    raise DvrkCmaesError(f"no motion was found that keeps {body.instrument.name} in view")


def cable_joints(body: Body) -> tuple[str, ...]:
    """Return the names of the joints that cables move: roll and those of the instrument."""
    return "roll", *body.instrument.joint_names


def level_offsets(names: tuple[str, ...], level: MotionLevel) -> Float64:
    """Return the standard deviations (C,), rad, of the offsets of cable-driven joints at a level."""
    return np.deg2rad([level.offset_deg * _SIZES.get(name, 1.0) for name in names])


def read_moving(
    truths: list[Truth],
    rng: np.random.Generator,
    level: MotionLevel,
    cables: CableModel | None = None,
    paths: Mapping[str, Float64] | None = None,
) -> dict[str, Float64]:
    """Draw the readings of all joints at the times of the frames, (frames,) by name, rad and m.

    With ``cables`` they are the ``paths`` of `moving_arm`, with the cables' offsets and noise.
    """
    frames = len(truths)
    offsets = {} if cables is None else dict(zip(cables.names, cables.offset.tolist(), strict=True))
    readings = {}
    for name in (*truths[0].outer, *truths[0].joints):
        path = np.array([{**truth.outer, **truth.joints}[name] for truth in truths]) if paths is None else paths[name]
        path = np.interp(np.arange(frames) + level.lag, np.arange(frames), path)
        noise = _INSERTION_NOISE if name == "insertion" else _READING_NOISE
        read = path + noise * rng.standard_normal(frames)
        if cables is not None:
            read -= offsets.get(name, 0.0)
        elif name not in ("yaw", "pitch", "insertion"):
            size = np.deg2rad(_SIZES.get(name, 1.0))
            drift = np.cumsum(rng.standard_normal(frames)) / FRAMES_A_SECOND
            read += size * (level.offset_deg * rng.standard_normal() + level.play_deg * _side(path))
            read += size * level.drift_deg * drift
        readings[name] = read
    return readings


def _waves(rng: np.random.Generator, frames: int, amplitude: float, speed: float) -> Float64:
    """Draw a smooth path about 0, the sum of three waves whose amplitudes sum up to ``amplitude``, (frames,)."""
    time = np.arange(frames) / FRAMES_A_SECOND
    periods, phases = rng.uniform(*_PERIODS, 3) / speed, rng.uniform(0, 2 * np.pi, 3)
    shares = amplitude * rng.dirichlet(np.ones(3))
    waves = shares[:, None] * np.sin(2 * np.pi * time / periods[:, None] + phases[:, None])
    return np.asarray(waves.sum(axis=0))


def _bump(frames: int) -> Float64:
    """Return a smooth path from 0 to 1 and back, over a second, (frames,)."""
    away = np.arange(frames) - _LEAVES_AT * frames - FRAMES_A_SECOND / 2
    return np.asarray(np.exp(-3 * (away / FRAMES_A_SECOND) ** 4))


def _side(path: Float64) -> Float64:
    """Return the side on which a joint's play is, -1 to 1, which follows the direction of its motion, (frames,)."""
    window = max(int(_PLAY_SECONDS * FRAMES_A_SECOND), 1)
    direction = np.sign(np.gradient(path)) if len(path) > 1 else np.zeros(1)
    padded = np.pad(direction, (window, 0), mode="edge")
    return np.asarray(np.convolve(padded, np.ones(window + 1) / (window + 1), "valid"))


def _in_view(camera: Camera, truth: Truth) -> bool:
    """Whether wrist and tips are in the image."""
    points = np.concatenate([truth.wrist, truth.tips])
    if points[:, 2].min() <= 0.04:
        return False
    pixels = camera.project(points)
    return bool(((pixels > 10) & (pixels < [camera.width - 11, camera.height - 11])).all())
