"""Errors between poses: known shifts, rotations and joint changes are measured exactly."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers.transforms import moved
from hypothesis import given
from hypothesis import strategies as st

from dvrk_cmaes import Body
from dvrk_cmaes.evaluate import Tolerance
from dvrk_cmaes.evaluate.pose_error import PoseError, compare_poses

TRUTH = moved(np.eye(4), [0.01, -0.02, 0.12, 0.4, 2.0, -0.3])
JOINTS = {"wrist_pitch": 0.5, "wrist_yaw": -0.2, "jaw": 0.7}
ANGLE = st.floats(-80.0, 80.0)


def error(body: Body, pose: np.ndarray, joints: dict[str, float] = JOINTS) -> PoseError:
    return compare_poses(body.instrument, (pose, joints), (TRUTH, JOINTS))


def test_translation_moves_root_and_tips_equally(bundled_body: Body) -> None:
    found = error(bundled_body, moved(TRUTH, [0.003, 0.0, 0.004, 0.0, 0.0, 0.0]))
    assert found.root_mm == pytest.approx(5.0)
    assert found.tip_mm == pytest.approx(5.0)


@given(turn=ANGLE, tilt=ANGLE)
def test_roll_and_tilt_of_shaft_are_separated(bundled_body: Body, turn: float, tilt: float) -> None:
    tilted = moved(TRUTH, [0, 0, 0, np.deg2rad(tilt), 0, 0])
    found = error(bundled_body, moved(tilted, [0, 0, 0, 0, 0, np.deg2rad(turn)]))
    assert found.shaft_deg == pytest.approx(abs(tilt), abs=1e-5)
    assert found.roll_deg == pytest.approx(abs(turn), abs=1e-5)
    assert max(abs(turn), abs(tilt)) - 1e-5 <= found.rotation_deg <= abs(turn) + abs(tilt) + 1e-5


def test_mirror_twin_differs_by_180_deg_roll(bundled_body: Body) -> None:
    pose, joints = bundled_body.instrument.twin(TRUTH, list(JOINTS.values()))
    found = error(bundled_body, pose, dict(zip(JOINTS, joints.tolist(), strict=True)))
    assert found.roll_deg == pytest.approx(180)
    assert found.rotation_deg == pytest.approx(180)
    assert found.joints_deg["wrist_pitch"] == pytest.approx(np.rad2deg(-1.0))


def test_end_of_tool_without_jaws_is_its_tip(bundled_body: Body) -> None:
    hook = replace(bundled_body.instrument, jaw_tips=())
    found = compare_poses(hook, (moved(TRUTH, [0.003, 0, 0.004, 0, 0, 0]), JOINTS), (TRUTH, JOINTS))
    assert found.tip_mm == pytest.approx(5.0)


@pytest.mark.parametrize(
    ("changed", "named"),
    [
        ({"root_mm": 0.6}, "root"),
        ({"tip_mm": 0.6}, "tip"),
        ({"shaft_deg": 2.0}, "shaft"),
        ({"roll_deg": 4.0}, "roll"),
        ({"joints_deg": {"wrist_pitch": 0.0, "wrist_yaw": -3.5}}, "wrist_yaw"),
        ({"joints_deg": {"jaw": -3.5}}, "jaw"),
        ({"joints_deg": {"wrist_roll": 3.5}}, "wrist_roll"),
        ({"root_mm": float("nan")}, "root"),
    ],
)
def test_exceeded_tolerance_is_named(changed: dict[str, float], named: str) -> None:
    zero = {"root_mm": 0.0, "tip_mm": 0.0, "rotation_deg": 0.0, "shaft_deg": 0.0, "roll_deg": 0.0, "joints_deg": {}}
    measured = PoseError(**{**zero, **changed}).measured(Tolerance())
    assert [each.quantity for each in measured if each.exceeds] == [named]
