"""Simulated joint readings with the errors of a real robot: a constant bias of the session, and noise of each frame.

The cable-driven joints (wrist, jaw, roll) have errors of several degrees, the joints of the arm of tenths of a degree.
In every frame the readings are nearer to the true joints than to those of the mirror twin, since on a rough mask only
the readings distinguish the two.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from dvrk_cmaes.errors import DvrkCmaesError
from dvrk_cmaes.joints.names import WRIST_JOINTS
from dvrk_cmaes.synth.levels import Level
from dvrk_cmaes.synth.truth import Truth

BIAS_SHARE: Final = 0.8
"""Ratio of a session's constant bias to the rms error of a cable-driven joint; the remaining variance is noise."""

_NOISE_SHARE: Final = float(np.sqrt(1.0 - BIAS_SHARE**2))
_ATTEMPTS: Final = 200


@dataclass(frozen=True)
class JointError:
    """Standard deviations of a joint reading's error: session bias and frame noise; rad, m for the insertion."""

    bias: float
    noise: float


def level_errors(level: Level) -> dict[str, JointError]:
    """Return the errors of the readings at a level by joint; those of any other joint are as for the wrist."""
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


def sample_readings(
    truths: Sequence[Truth], rng: np.random.Generator, level: Level, *, one_session: bool
) -> list[dict[str, float]]:
    """Draw readings of all joints of some frames, rad and m, clipped to the instrument's limits.

    Over many sessions, the errors have the level's root mean square. With ``one_session`` all frames have the same
    bias, otherwise each its own. Readings that are nearer to the mirror twin are drawn again: the frame's noise up to
    ten times, then the bias.

    Raises
    ------
    DvrkCmaesError
        No readings were found that are nearer to the truth than to the mirror twin in every frame.
    """
    errors = level_errors(level)
    if not one_session:
        return [reading for truth in truths for reading in sample_readings([truth], rng, level, one_session=True)]
    for _ in range(_ATTEMPTS):
        bias = {name: error.bias * rng.standard_normal() for name, error in errors.items()}
        readings = [_reading(truth, bias, errors, rng) for truth in truths]
        accepted = [reading for reading in readings if reading is not None]
        if len(accepted) == len(truths):
            return accepted
    raise DvrkCmaesError(
        f"level {level.name}: no readings were found that distinguish all frames from their mirror twins"
    )


def _reading(
    truth: Truth, bias: Mapping[str, float], errors: Mapping[str, JointError], rng: np.random.Generator
) -> dict[str, float] | None:
    """Draw one frame's readings with a bias; None if ten draws of noise were all nearer to the mirror twin."""
    limits = dict(zip(truth.instrument.joint_names, truth.instrument.limits, strict=True))
    for _ in range(10):
        reading = {}
        for name, value in {**truth.outer, **truth.joints}.items():
            like = name if name in errors else WRIST_JOINTS[0]
            read = value + bias[like] + errors[like].noise * rng.standard_normal()
            low, high = limits.get(name, (-np.inf, np.inf))
            reading[name] = float(np.clip(read, low, high))
        if distinguishes_twin(truth, reading, ratio=1.0):
            return reading
    return None


def distinguishes_twin(truth: Truth, reading: Mapping[str, float], ratio: float = 0.5) -> bool:
    """Whether the wrist's readings are less far from the truth than ``ratio`` times their distance from the twin.

    Distances are norms over wrist pitch and wrist yaw.
    """
    _, twin = truth.instrument.twin(truth.camera_from_root, truth.values)
    names = truth.instrument.joint_names
    read = np.array([reading[name] for name in names])
    bends = [k for k, name in enumerate(names) if name in ("wrist_pitch", "wrist_yaw")]
    to_truth = np.linalg.norm((read - truth.values)[bends])
    return bool(to_truth < ratio * np.linalg.norm((read - twin)[bends]))
