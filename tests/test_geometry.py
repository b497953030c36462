"""Rigid transforms: group properties, and exponential, changes and angles compared with SciPy's rotations."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.spatial.transform import Rotation

from dvrk_cmaes.geometry import (
    Posed,
    adjoint,
    change_between,
    exp_rotation,
    inverse,
    log_rotation,
    moved,
    transform,
)


def vectors(largest: float, shape: int | tuple[int, ...] = 3) -> st.SearchStrategy[np.ndarray]:
    return arrays(np.float64, shape, elements=st.floats(-largest, largest))


poses = st.builds(lambda turn, shift: transform(exp_rotation(turn), shift), vectors(3), vectors(1))


@given(vectors(7))
def test_exponential_agrees_with_scipy(rotvec: np.ndarray) -> None:
    np.testing.assert_allclose(exp_rotation(rotvec), Rotation.from_rotvec(rotvec).as_matrix(), atol=1e-12)


@pytest.mark.parametrize("angle", [0.0, 1e-300, 1e-12, 0.9e-6, 1.1e-6, 1e-3])
def test_exponential_is_accurate_for_small_angles(angle: float) -> None:
    axis = np.array([2.0, -1.0, 2.0]) / 3
    turned = exp_rotation(angle * axis)
    np.testing.assert_allclose(turned, Rotation.from_rotvec(angle * axis).as_matrix(), atol=1e-16)
    half_skew = (turned - turned.T) / 2
    recovered = np.array([half_skew[2, 1], half_skew[0, 2], half_skew[1, 0]])
    np.testing.assert_allclose(recovered, np.sin(angle) * axis, rtol=1e-9, atol=0)


@given(arrays(np.float64, 3, elements=st.floats(-1.8, 1.8)))
def test_logarithm_inverts_exponential(rotvec: np.ndarray) -> None:
    assert np.linalg.norm(rotvec) < np.pi
    np.testing.assert_allclose(log_rotation(exp_rotation(rotvec)), rotvec, atol=1e-9)


@pytest.mark.parametrize("axis", np.vstack([np.eye(3), -np.eye(3), np.full((1, 3), 1 / np.sqrt(3))]))
@pytest.mark.parametrize("angle", [0.0, 1e-12, 1e-6, 1.0, np.pi - 1e-9])
def test_logarithm_agrees_with_scipy_near_0_and_180_deg(axis: np.ndarray, angle: float) -> None:
    rotation = Rotation.from_rotvec(angle * axis).as_matrix()
    np.testing.assert_allclose(log_rotation(rotation), angle * axis, atol=1e-7)


def test_change_between_inverts_moved() -> None:
    rng = np.random.default_rng(0)
    first = transform(exp_rotation(rng.normal(size=(20, 3))), rng.normal(size=(20, 3)))
    change = rng.uniform(-1, 1, size=(20, 6))
    np.testing.assert_allclose(change_between(first, moved(first, change)), change, atol=1e-9)


def test_adjoint_transforms_change_between_frames() -> None:
    rng = np.random.default_rng(1)
    a_from_b = transform(exp_rotation(rng.normal(size=3)), rng.normal(size=3))
    change = 1e-5 * rng.normal(size=6)
    small = transform(exp_rotation(change[3:]), change[:3])
    carried = a_from_b @ small @ inverse(a_from_b)
    np.testing.assert_allclose(change_between(np.eye(4), carried), adjoint(a_from_b) @ change, atol=1e-9)


joint_values = arrays(np.float64, 3, elements=st.floats(-2, 2))
changes = arrays(np.float64, 9, elements=st.floats(-1, 1))


@given(poses, joint_values, changes, poses)
def test_small_changes_are_the_same_seen_from_any_camera(
    pose: np.ndarray, joints: np.ndarray, change: np.ndarray, view_from_camera: np.ndarray
) -> None:
    before = Posed(pose, joints)
    seen = before.seen_from(view_from_camera)
    np.testing.assert_allclose(
        seen.moved(change).pose, before.moved(change).seen_from(view_from_camera).pose, atol=1e-9
    )
