"""Joint readings that are wrong the way a robot's are: mostly by a bias of the session, and by noise of each frame.

The cable-driven joints (wrist, jaw, roll) are off by degrees, the arm's own by tenths. In every frame the readings are
nearer to the truth than to its mirror twin, which nothing else tells apart on a rough mask.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from dvrk_cmaes.errors import DvrkCmaesError
from dvrk_cmaes.joints.reading import WRIST_JOINTS
from dvrk_cmaes.synth.levels import Level
from dvrk_cmaes.synth.truth import Truth

STEADY_ERRORS: Final = {  # rms; rad, insertion in m
    "yaw": np.deg2rad(0.1),
    "pitch": np.deg2rad(0.1),
    "insertion": 0.0004,
    "roll": np.deg2rad(5.0),
    "wrist_pitch": np.deg2rad(5.0),
    "wrist_yaw": np.deg2rad(5.0),
    "jaw": np.deg2rad(7.5),
}
BIAS_SHARE: Final = 0.8
"""Of a cable-driven joint's error, the same in all frames of a session; what is left of its square is noise."""

_NOISE_SHARE: Final = float(np.sqrt(1.0 - BIAS_SHARE**2))
_ATTEMPTS: Final = 200


@dataclass(frozen=True)
class JointError:
    """Standard deviations of a joint's reading: of a session's bias, and of a frame's noise; rad, m for insertion."""

    bias: float
    noise: float


def level_errors(level: Level) -> dict[str, JointError]:
    """Errors of the readings at a level, by joint; one that is not named is read as the wrist's are."""
    wrist = JointError(*(np.deg2rad(level.wrist_deg) * share for share in (BIAS_SHARE, _NOISE_SHARE)))
    arm = JointError(0.0, np.deg2rad(level.arm_deg))
    return {
        "yaw": arm,
        "pitch": arm,
        "insertion": JointError(0.0, 1e-3 * level.insertion_mm),
        "roll": JointError(np.deg2rad(level.roll_deg), np.deg2rad(level.arm_deg)),
        "wrist_pitch": wrist,
        "wrist_yaw": wrist,
        "jaw": JointError(level.jaw_ratio * wrist.bias, level.jaw_ratio * wrist.noise),
    }


def drawn_readings(
    truths: Sequence[Truth], rng: np.random.Generator, level: Level, *, one_session: bool
) -> list[dict[str, float]]:
    """Draw readings of all joints of some frames, rad and m, cut to the instrument's limits as a robot's are.

    Over many sessions the errors have the level's root mean square; one session's bias can be twice that. Frames that
    are not of one session have a bias each. What would be nearer to the mirror twin is drawn again, the frame's noise
    first, then the bias.

    Raises
    ------
    DvrkCmaesError
        No readings are found that tell a frame from its mirror twin.
    """
    errors = level_errors(level)
    if not one_session:
        return [reading for truth in truths for reading in drawn_readings([truth], rng, level, one_session=True)]
    for _ in range(_ATTEMPTS):
        bias = {name: error.bias * rng.standard_normal() for name, error in errors.items()}
        readings = [_reading(truth, bias, errors, rng) for truth in truths]
        told = [reading for reading in readings if reading is not None]
        if len(told) == len(truths):
            return told
    raise DvrkCmaesError(f"level {level.name}: no readings were found that tell all frames from their mirror twins")


def _reading(
    truth: Truth, bias: Mapping[str, float], errors: Mapping[str, JointError], rng: np.random.Generator
) -> dict[str, float] | None:
    """Draw one frame's readings with a bias; None where no noise brings them nearer to the truth than to its twin."""
    limits = dict(zip(truth.instrument.joint_names, truth.instrument.limits, strict=True))
    for _ in range(10):
        reading = {}
        for name, value in {**truth.outer, **truth.joints}.items():
            like = name if name in errors else WRIST_JOINTS[0]
            read = value + bias[like] + errors[like].noise * rng.standard_normal()
            low, high = limits.get(name, (-np.inf, np.inf))
            reading[name] = float(np.clip(read, low, high))
        if tells_twin_apart(truth, reading, ratio=1.0):
            return reading
    return None


def steady_readings(truths: Sequence[Truth], rng: np.random.Generator) -> list[dict[str, float]]:
    """Make readings of all joints of a few frames, wrong by ``STEADY_ERRORS`` over these very frames.

    Drawn anew until the wrist's errors have about that root mean square, and the readings are clearly nearer to the
    truth than to its mirror twin in each of them.
    """
    while True:
        bias = {name: rng.choice([-1.0, 1.0]) * BIAS_SHARE * rms for name, rms in STEADY_ERRORS.items()}
        errors = [
            {name: bias[name] + _NOISE_SHARE * rms * rng.standard_normal() for name, rms in STEADY_ERRORS.items()}
            for _ in truths
        ]
        rms = {name: np.sqrt(np.mean([error[name] ** 2 for error in errors])) for name in WRIST_JOINTS}
        if any(abs(rms[name] / STEADY_ERRORS[name] - 1) > 0.2 for name in WRIST_JOINTS):
            continue
        readings = [
            {name: value + error[name] for name, value in {**truth.outer, **truth.joints}.items()}
            for truth, error in zip(truths, errors, strict=True)
        ]
        if all(tells_twin_apart(truth, reading) for truth, reading in zip(truths, readings, strict=True)):
            return readings


def tells_twin_apart(truth: Truth, reading: Mapping[str, float], ratio: float = 0.5) -> bool:
    """Whether the readings of pitch and yaw are less than ``ratio`` times as far from the truth as from its twin."""
    _, twin = truth.instrument.twin(truth.camera_from_root, truth.values)
    names = truth.instrument.joint_names
    read = np.array([reading[name] for name in names])
    bends = [k for k, name in enumerate(names) if name in ("wrist_pitch", "wrist_yaw")]
    to_truth = np.linalg.norm((read - truth.values)[bends])
    return bool(to_truth < ratio * np.linalg.norm((read - twin)[bends]))
