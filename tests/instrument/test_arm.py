"""Forward kinematics of the outer arm, from base to root link, by the dVRK's Denavit-Hartenberg tables."""

from __future__ import annotations

import json
import re
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from helpers.transforms import change_between
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform, Rotation

from dvrk_cmaes import load_instrument
from dvrk_cmaes.instrument.arm import (
    Arm,
    base_from_root,
    base_from_root_and_jacobian,
    dh_table,
    root_from_tip,
)
from dvrk_cmaes.instrument.dvrk_description import read_tool
from dvrk_cmaes.instrument.kinematics import Chain

OUTER = np.array([0.31, -0.22, 0.14, 0.87])
angles = st.floats(-1.5, 1.5)
outer_joints = st.tuples(angles, angles, st.floats(0.03, 0.24), angles)


@cache
def lnd_chain() -> Chain:
    return load_instrument("lnd").chain


def turn(axis: str, angle: float) -> RigidTransform:
    return RigidTransform.from_rotation(Rotation.from_euler(axis, angle))


def shift(x: float, y: float, z: float) -> RigidTransform:
    return RigidTransform.from_translation([x, y, z])


def chained(outer: NDArray[np.float64], insertion_offset: float, roll_offset: float) -> NDArray[np.float64]:
    """Give the pose as a product of elementary rotations and translations."""
    yaw, pitch, insertion, roll = (float(q) for q in outer)
    quarter = np.pi / 2
    first = turn("x", quarter) * turn("z", yaw + quarter)
    second = turn("x", -quarter) * turn("z", pitch - quarter)
    third = turn("x", quarter) * shift(0, 0, insertion + insertion_offset)
    fourth = turn("z", roll) * shift(0, 0, roll_offset)
    return (first * second * third * fourth).as_matrix()


@given(outer_joints)
def test_jacobian_is_that_of_small_changes_of_the_joints(outer: tuple[float, ...]) -> None:
    step = 1e-6
    pose, jacobian = base_from_root_and_jacobian(np.array(outer))
    np.testing.assert_allclose(pose, base_from_root(outer), atol=1e-12)
    before, after = (
        change_between(pose, base_from_root(np.array(outer) + sign * step * np.eye(4))) for sign in (-1, 1)
    )
    np.testing.assert_allclose(jacobian, (after - before).T / (2 * step), atol=1e-8)


@pytest.mark.parametrize(
    ("arm", "insertion_offset", "roll_offset"),
    [("classic", -0.4318, 0.4162), ("si", -0.4826, 0.4162), ("si", -0.4826, 0.467)],
)
def test_kinematics_equal_product_of_elementary_motions(arm: Arm, insertion_offset: float, roll_offset: float) -> None:
    expected = chained(OUTER, insertion_offset, roll_offset)
    np.testing.assert_allclose(base_from_root(OUTER, arm, roll_offset=roll_offset), expected, atol=1e-12)


@given(outer_joints)
def test_shaft_passes_through_rcm(outer: tuple[float, ...]) -> None:
    pose = base_from_root(outer)
    np.testing.assert_allclose(pose[:3, 3] - (outer[2] - 0.0156) * pose[:3, 2], 0, atol=1e-12)


@pytest.mark.parametrize(("arm", "file"), [("classic", "PSM.json"), ("si", "PSM_Si.json")])
def test_table_agrees_with_dvrk_description(shared: Path, arm: Arm, file: str) -> None:
    text = re.sub(r"/\*.*?\*/|//[^\n]*", "", (shared / "formats" / "kinematic" / file).read_text(), flags=re.DOTALL)
    table = dh_table(arm)[:3]
    for row, joint in zip(table, json.loads(text)["DH"]["joints"], strict=True):
        prismatic = joint["type"] == "prismatic"
        assert row.prismatic == prismatic
        assert row.alpha == pytest.approx(joint["alpha"], abs=1e-5)
        assert row.a == joint["A"]
        assert row.theta == pytest.approx(joint["theta"] if prismatic else joint["theta"] + joint["offset"], abs=1e-5)
        assert row.d == pytest.approx(joint["D"] + joint["offset"] if prismatic else joint["D"], abs=1e-12)


@given(angles, angles)
def test_tool_tip_is_frame_of_wrist_yaw_link_with_offset(pitch: float, yaw: float) -> None:
    chain = lnd_chain()
    index = next(k for k, joint in enumerate(chain.joints) if joint.name == "wrist_yaw")
    (link,) = chain.forward([pitch, yaw, 0.0], [index])
    offset = [[0, -1, 0, 0], [0, 0, 1, 0], [-1, 0, 0, 0], [0, 0, 0, 1]]
    np.testing.assert_allclose(root_from_tip(pitch, yaw), link @ offset, atol=1e-12)


def test_tool_tip_is_that_of_real_description(shared: Path) -> None:
    tool = read_tool(shared / "formats" / "tool" / "LARGE_NEEDLE_DRIVER_400006.json")
    described = root_from_tip(0.3, -0.4, wrist_length=tool.wrist_length, tooltip_offset=tool.tooltip_offset)
    np.testing.assert_allclose(root_from_tip(0.3, -0.4), described, atol=1e-12)
