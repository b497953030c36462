"""Kinematics of the arm that holds the endoscope."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from helpers.transforms import change_between

from dvrk_cmaes.instrument.arm import Arm
from dvrk_cmaes.instrument.endoscope import ECM_LIMITS, ecm_from_tip_and_jacobian, joints_of_ecm_tip

JOINTS = np.array([[0.2, -0.3, 0.12, 0.4], [-0.5, 0.6, 0.05, -1.2], [0.0, 0.0, 0.2, 0.0]])


def chain(rows: list[dict[str, float | str]], values: np.ndarray) -> np.ndarray:
    """Multiply the rows of modified Denavit-Hartenberg parameters of a dVRK description."""
    pose = np.eye(4)
    for row, value in zip(rows, values, strict=True):
        prismatic = row["type"] == "prismatic"
        theta = float(row["theta"]) + (0.0 if prismatic else float(row["offset"]) + value)
        d = float(row["D"]) + (float(row["offset"]) + value if prismatic else 0.0)
        c, s, ca, sa = np.cos(theta), np.sin(theta), np.cos(float(row["alpha"])), np.sin(float(row["alpha"]))
        a = float(row["A"])
        pose = pose @ [[c, -s, 0, a], [s * ca, c * ca, -sa, -sa * d], [s * sa, c * sa, ca, ca * d], [0, 0, 0, 1]]
    return pose


@pytest.mark.parametrize(("arm", "name"), [("classic", "ECM.json"), ("si", "ECM_Si.json")])
def test_tip_and_limits_are_those_of_the_descriptions(shared: Path, arm: Arm, name: str) -> None:
    document = json.loads((shared / "formats" / "kinematic" / name).read_text(encoding="utf-8"))
    rows = document["DH"]["joints"]
    found, _ = ecm_from_tip_and_jacobian(JOINTS)
    for pose, values in zip(found, JOINTS, strict=True):
        assert np.allclose(pose, chain(rows, values), atol=2e-5)  # right angles are rounded in the file
    assert ECM_LIMITS[arm] == tuple((row["qmin"], row["qmax"]) for row in rows)


def test_jacobian_is_the_derivative() -> None:
    pose, jacobian = ecm_from_tip_and_jacobian(JOINTS)
    for k in range(4):
        step = 1e-6 * np.eye(4)[k]
        later, earlier = (ecm_from_tip_and_jacobian(JOINTS + sign * step)[0] for sign in (1, -1))
        numeric = (change_between(pose, later) - change_between(pose, earlier)) / 2e-6
        assert np.allclose(jacobian[..., k], numeric, atol=1e-6)


def test_joints_of_a_pose_are_those_that_made_it() -> None:
    assert np.allclose(joints_of_ecm_tip(ecm_from_tip_and_jacobian(JOINTS)[0]), JOINTS, atol=1e-9)
