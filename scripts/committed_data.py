"""Committed data with which tests compare: readings of errors with a fixed rms, and protection against rewriting."""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from typing import Final

import numpy as np

from dvrk_cmaes.joints.names import WRIST_JOINTS
from dvrk_cmaes.synth.readings import BIAS_SHARE, distinguishes_twin
from dvrk_cmaes.synth.truth import Truth

FIXED_RMS_ERRORS: Final = {  # rms; rad, insertion in m
    "yaw": np.deg2rad(0.1),
    "pitch": np.deg2rad(0.1),
    "insertion": 0.0004,
    "roll": np.deg2rad(5.0),
    "wrist_pitch": np.deg2rad(5.0),
    "wrist_yaw": np.deg2rad(5.0),
    "jaw": np.deg2rad(7.5),
}
_NOISE_SHARE: Final = float(np.sqrt(1.0 - BIAS_SHARE**2))


def fixed_rms_readings(truths: Sequence[Truth], rng: np.random.Generator) -> list[dict[str, float]]:
    """Draw readings of all joints of a few frames whose errors have the rms ``FIXED_RMS_ERRORS`` over these frames.

    Drawn again until the rms of the errors of wrist and jaw over these frames is within 20 % of its value, and the
    distance of the readings from the truth is less than half that from the mirror twin in every frame.
    """
    while True:
        bias = {name: rng.choice([-1.0, 1.0]) * BIAS_SHARE * rms for name, rms in FIXED_RMS_ERRORS.items()}
        errors = [
            {name: bias[name] + _NOISE_SHARE * rms * rng.standard_normal() for name, rms in FIXED_RMS_ERRORS.items()}
            for _ in truths
        ]
        rms = {name: np.sqrt(np.mean([error[name] ** 2 for error in errors])) for name in WRIST_JOINTS}
        if any(abs(rms[name] / FIXED_RMS_ERRORS[name] - 1) > 0.2 for name in WRIST_JOINTS):
            continue
        readings = [
            {name: value + error[name] for name, value in {**truth.outer, **truth.joints}.items()}
            for truth, error in zip(truths, errors, strict=True)
        ]
        if all(distinguishes_twin(truth, reading) for truth, reading in zip(truths, readings, strict=True)):
            return readings


def refuse_in_ci(script: str) -> None:
    """Exit with code 2 if CI is set: a test run must not rewrite the data that it compares with."""
    if os.environ.get("CI", "").lower() not in ("", "0", "false"):
        print(
            f"{script}: not run in CI: committed data must not change there (unset CI to make it anew)", file=sys.stderr
        )
        sys.exit(2)
