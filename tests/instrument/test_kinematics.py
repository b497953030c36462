"""Independent joints of an instrument, their limits, and forward kinematics compared with yourdfpy."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
import pytest
import yourdfpy
from helpers.instrument_files import ALL_SHARED, box_link, joint, loaded, write_urdf
from helpers.places import bundled_path
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from dvrk_cmaes import InputError, Instrument, load_instrument

BUNDLED = bundled_path("instruments", "lnd", "lnd.urdf")


@cache
def reference(path: Path) -> yourdfpy.URDF:
    return yourdfpy.URDF.load(str(path), load_meshes=False)


def by_yourdfpy(path: Path, instrument: Instrument, joints: np.ndarray) -> np.ndarray:
    model = reference(path)
    values = {name: float(value) for name, value in zip(instrument.joint_names, joints, strict=True)}
    model.update_cfg(values)
    model.update_cfg(values)  # called twice: a mimic listed before its joint uses the value of the previous call
    return np.stack([model.get_transform(link.name, instrument.root_link) for link in instrument.links])


def check_against_yourdfpy(path: Path, fractions: np.ndarray) -> None:
    instrument = loaded(path)
    joints = instrument.limits[:, 0] + fractions[:, : len(instrument.limits)] * np.ptp(instrument.limits, axis=1)
    batch = instrument.forward(joints)
    # trimesh, which yourdfpy uses, replaces a transform within 1e-8 of the identity by the identity
    for row, poses in zip(joints, batch, strict=True):
        np.testing.assert_allclose(poses, by_yourdfpy(path, instrument, row), rtol=0, atol=5e-8)


BATCHES = arrays(np.float64, (3, 4), elements=st.floats(-0.5, 1.5))


@pytest.mark.shared
@pytest.mark.parametrize("path", ALL_SHARED, ids=lambda path: path.stem)
@settings(max_examples=8, deadline=None)
@given(fractions=BATCHES)
def test_real_instruments_agree_with_yourdfpy(path: Path, fractions: np.ndarray) -> None:
    check_against_yourdfpy(path, fractions)


MIXED = (
    box_link("roll_link")
    + joint("follower", "prismatic", "roll_link", "a", '<origin xyz="0.1 0 0.2" rpy="0.3 -1 2"/><axis xyz="0 0 -1"/>'
            '<mimic joint="turn" multiplier="-0.02" offset="0.05"/>')
    + box_link("a")
    + joint("turn", "continuous", "a", "b", '<origin xyz="0 0.3 0"/><axis xyz="1 2 -2"/>')
    + box_link("b")
    + joint("mount", "fixed", "b", "c", '<origin xyz="0 0 0.4" rpy="0 0.7 0"/>')
    + '<link name="c"/>'
    + joint("slide", "prismatic", "c", "d", '<axis xyz="0 1 0"/><limit lower="0" upper="0.2" effort="1" velocity="1"/>')
    + box_link("d")
)  # fmt: skip


@pytest.fixture(scope="module")
def mixed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_urdf(tmp_path_factory.mktemp("mixed"), MIXED)


@settings(max_examples=25, deadline=None)
@given(fractions=BATCHES)
def test_all_joint_types_agree_with_yourdfpy(mixed: Path, fractions: np.ndarray) -> None:
    check_against_yourdfpy(mixed, fractions)


def test_chained_mimic_joints_follow_first_joint(tmp_path: Path) -> None:
    body = box_link("roll_link") + box_link("a") + box_link("b") + box_link("c")
    body += joint("first", "prismatic", "roll_link", "a", '<axis xyz="1 0 0"/>')
    body += joint(
        "second", "prismatic", "roll_link", "b", '<axis xyz="1 0 0"/><mimic joint="first" multiplier="2" offset="0.1"/>'
    )
    body += joint(
        "third",
        "prismatic",
        "roll_link",
        "c",
        '<axis xyz="1 0 0"/><mimic joint="second" multiplier="-3" offset="0.5"/>',
    )
    instrument = load_instrument(write_urdf(tmp_path, body))
    assert instrument.joint_names == ("first",)
    np.testing.assert_allclose(instrument.forward([0.2])[:, 0, 3], [0, 0.2, 0.5, -3 * 0.5 + 0.5])


def test_unknown_joint_is_refused_with_nearest_name() -> None:
    assert loaded(BUNDLED).joint_index("jaw") == 2
    with pytest.raises(InputError, match=r"unknown joint 'wrist_yow'; expected one of: wrist_yaw, wrist_pitch"):
        loaded(BUNDLED).joint_index("wrist_yow")


@pytest.mark.parametrize(
    ("inside", "message"),
    [
        ('<axis xyz="0 0 0"/>', "joint 'j': axis: expected three finite numbers, not all zero"),
        ('<limit lower="1" upper="-1"/>', "joint 'j': limit: expected finite lower <= upper, got 1 and -1"),
        ('<limit lower="nan" upper="1"/>', "joint 'j': limit: expected finite"),
        ("<limit/>", "joint 'j': limit: expected lower and upper"),
        ('<mimic joint="ghost"/>', "joint 'j': mimic: joint 'ghost' does not exist"),
        ('<mimic joint="j"/>', "joint 'j': mimic: expected an end, got a loop"),
        ('<mimic joint="j" multiplier="inf"/>', "mimic: expected a finite multiplier"),
        ('<origin xyz="0 nan 0"/>', "joint 'j': origin: expected finite numbers"),
        ('<origin xyz="0 0"/>', "not a valid URDF"),
    ],
)
def test_invalid_joint_is_refused(tmp_path: Path, inside: str, message: str) -> None:
    path = write_urdf(
        tmp_path, box_link("roll_link") + box_link("a") + joint("j", "revolute", "roll_link", "a", inside)
    )
    with pytest.raises(InputError) as caught:
        load_instrument(path)
    assert message in str(caught.value)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("body", "message"),
    [
        (joint("j", "floating", "roll_link", "a"), "joint 'j': type 'floating' is not supported"),
        (joint("j", "revolute", "roll_link", "ghost"), "joint 'j': child link 'ghost' does not exist"),
        (joint("j", "fixed", "roll_link", "a") * 2, "joint 'j': expected a name used once"),
        (joint("j", "fixed", "roll_link", "a") + joint("k", "fixed", "roll_link", "a"), "expected one joint above it"),
        (joint("j", "fixed", "roll_link", "a") + joint("k", "fixed", "a", "roll_link"), "got a loop through it"),
        (box_link("a"), "link 'a': expected a name used once"),
    ],
)  # fmt: skip
def test_links_without_tree_structure_are_refused(tmp_path: Path, body: str, message: str) -> None:
    path = write_urdf(tmp_path, box_link("roll_link") + box_link("a") + body)
    with pytest.raises(InputError) as caught:
        load_instrument(path)
    assert message in str(caught.value)
