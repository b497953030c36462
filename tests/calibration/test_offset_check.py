"""Warnings about offsets far outside their priors."""

from __future__ import annotations

import numpy as np
import pytest
from helpers.session_worlds import EXPECTED_OFFSETS, OFFSETS, make_world

from dvrk_cmaes.calibration.model import Calibration
from dvrk_cmaes.calibration.offset_check import describe_far_offsets

WORLD = make_world(4)
OWN = np.array([0.1e-3, *np.deg2rad([0.5, 0.5, 0.5, 0.5])])
COVARIANCE = np.diag([*np.zeros(6), *OWN**2])


def described(offsets: np.ndarray, covariance: np.ndarray = COVARIANCE) -> list[str]:
    calibration = Calibration(WORLD.truth.camera_from_base, offsets)
    return describe_far_offsets(calibration, covariance, WORLD.model, EXPECTED_OFFSETS)


def test_usual_offsets_give_no_warning() -> None:
    assert described(OFFSETS) == []


@pytest.mark.parametrize(
    ("index", "value", "expected"),
    [
        (0, 6.8e-3, "offset of insertion: +6.8 mm (std 0.1), where 0.5 mm are usual; likely causes: another focal "),
        (1, -1.3, "offset of roll: -74.5 deg (std 0.5), where 20.0 deg are usual; likely causes: a tool that was "),
        (3, 1.2, "offset of wrist_yaw: +68.8 deg (std 0.5), where 20.0 deg are usual; likely causes: a tool that "),
    ],
)
def test_far_offset_is_named_with_likely_causes(index: int, value: float, expected: str) -> None:
    offsets = OFFSETS.copy()
    offsets[index] = value
    (text,) = described(offsets)
    assert text.startswith(expected)


def test_uncertain_offset_gives_no_warning() -> None:
    offsets = OFFSETS.copy()
    offsets[0] = 6.8e-3
    covariance = COVARIANCE.copy()
    covariance[6, 6] = 3e-3**2
    assert described(offsets, covariance) == []
