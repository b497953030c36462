"""Inverse kinematics of the whole arm, from the pose of the tool's tip to its six joints."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from dvrk_cmaes.instrument.arm import ROLL_OFFSET, ROLL_OFFSET_LONG, TOOLTIP_OFFSET, Arm, base_from_root, root_from_tip
from dvrk_cmaes.instrument.inverse_kinematics import find_joints

NEAR_SINGULAR = np.radians(2.0)
INSERTION_OF_RCM = {"classic": 0.4318, "si": 0.4826}  # insertion plus roll offset at which the wrist is at the RCM, m


def _offset(translation: float) -> NDArray[np.float64]:
    """Give the pose of a tip ``translation`` (m) beyond the wrist yaw axis."""
    out = TOOLTIP_OFFSET.copy()
    out[0, 3] = translation
    return out


@dataclass(frozen=True)
class MadeTool:
    """Constants of a tool's description."""

    roll_offset: float
    wrist_length: float
    tooltip_offset: NDArray[np.float64]


TOOLS = {
    "needle driver": MadeTool(ROLL_OFFSET, 0.0091, _offset(0.0)),
    "long needle driver": MadeTool(ROLL_OFFSET_LONG, 0.0091, _offset(0.0102)),
    "hook": MadeTool(ROLL_OFFSET, 0.005, _offset(0.0183)),
}


def _draw(count: int, arm: Arm, tool: MadeTool, seed: int = 4) -> NDArray[np.float64]:
    """Draw joints (count, 6) over the arm's range, roll within half a turn, the wrist at least 20 mm from the RCM."""
    low = INSERTION_OF_RCM[arm] - tool.roll_offset + 0.02
    bounds = np.array([[-1.5, 1.5], [-0.9, 0.9], [low, low + 0.2], [-3.1, 3.1], [-1.55, 1.55], [-1.4, 1.4]])
    return np.random.default_rng(seed).uniform(bounds[:, 0], bounds[:, 1], (count, 6))


def _tips(joints: NDArray[np.float64], arm: Arm, tool: MadeTool) -> NDArray[np.float64]:
    """Give the poses of the tip by forward kinematics."""
    wrist = [
        root_from_tip(pitch, yaw, wrist_length=tool.wrist_length, tooltip_offset=tool.tooltip_offset)
        for pitch, yaw in joints[:, 4:]
    ]
    return base_from_root(joints[:, :4], arm, roll_offset=tool.roll_offset) @ np.array(wrist)


def _solve(tips: NDArray[np.float64], arm: Arm, tool: MadeTool, **more: Any) -> Any:
    return find_joints(
        tips,
        arm,
        roll_offset=tool.roll_offset,
        wrist_length=tool.wrist_length,
        tooltip_offset=tool.tooltip_offset,
        **more,
    )


@pytest.mark.parametrize("arm", ["classic", "si"])
@pytest.mark.parametrize("name", TOOLS)
def test_joints_are_found_from_the_tip_they_give(arm: Arm, name: str) -> None:
    tool = TOOLS[name]
    joints = _draw(1000, arm, tool)
    found = _solve(_tips(joints, arm, tool), arm, tool)
    assert not any(found.reasons)
    error = found.joints - joints
    error[:, 3] = np.angle(np.exp(1j * error[:, 3]))  # modulo a turn, as poses in no order are continued at random
    near = np.abs(np.abs(joints[:, 4]) - np.pi / 2) < NEAR_SINGULAR
    assert near.any()
    assert np.abs(error[~near]).max() < 1e-6
    assert np.abs(error[near]).max() < 1e-4


def test_a_pose_beyond_a_limit_is_not_reached_and_says_so() -> None:
    tool = TOOLS["needle driver"]
    joints = _draw(2, "classic", tool)
    joints[:, 4] = [0.2, 1.5]
    found = _solve(_tips(joints, "classic", tool), "classic", tool, limits={"wrist_pitch": (-1.4, 1.4)})
    assert found.reasons == ("", "wrist_pitch 85.9 deg is outside -80.2 to 80.2 deg")
    assert np.isnan(found.joints[1]).all()
    assert found.joints[0] == pytest.approx(joints[0], abs=1e-9)


def test_a_wrist_yaw_axis_through_the_rcm_has_no_wrist_yaw() -> None:
    tool = TOOLS["needle driver"]
    base_from_yaw = np.eye(4)
    base_from_yaw[2, 3] = 0.1
    found = _solve((base_from_yaw @ tool.tooltip_offset)[None], "classic", tool)
    assert "wrist yaw is not determined" in found.reasons[0]
    assert np.isnan(found.joints).all()
