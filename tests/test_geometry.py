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
    apply,
    change_between,
    cross,
    exp_rotation,
    frame_along,
    inverse,
    log_rotation,
    moved,
    rotation_about_z,
    rotation_angle,
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


@given(poses, st.floats(0, np.pi), vectors(1).filter(lambda v: np.linalg.norm(v) > 0.1), vectors(1))
def test_rotation_angle_between_poses(pose: np.ndarray, angle: float, axis: np.ndarray, shift: np.ndarray) -> None:
    other = moved(pose, np.r_[shift, angle * axis / np.linalg.norm(axis)])
    assert rotation_angle(pose, other) == pytest.approx(angle, abs=1e-7)
    assert rotation_angle(other[:3, :3], pose[:3, :3]) == pytest.approx(angle, abs=1e-7)


@given(vectors(1).filter(lambda v: np.linalg.norm(v) > 0.1))
def test_frame_along_has_direction_as_z(direction: np.ndarray) -> None:
    z = direction / np.linalg.norm(direction)
    frame = frame_along(z)
    np.testing.assert_allclose(frame[:, 2], z, atol=1e-15)
    np.testing.assert_allclose(frame.T @ frame, np.eye(3), atol=1e-12)
    assert np.linalg.det(frame) == pytest.approx(1, abs=1e-12)


@given(st.floats(-7, 7))
def test_rotation_about_z_agrees_with_scipy(angle: float) -> None:
    np.testing.assert_allclose(rotation_about_z(angle), Rotation.from_rotvec([0, 0, angle]).as_matrix(), atol=1e-12)


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


def test_apply_maps_single_points_lists_and_batches() -> None:
    rng = np.random.default_rng(0)
    poses = moved(np.eye(4), 0.3 * rng.standard_normal((5, 6)))
    points = rng.standard_normal((5, 7, 3))
    expected = np.einsum("nij,nkj->nki", poses[:, :3, :3], points) + poses[:, None, :3, 3]
    np.testing.assert_allclose(apply(poses, points), expected, atol=1e-14)
    np.testing.assert_allclose(apply(poses[0], points[0]), expected[0], atol=1e-14)
    np.testing.assert_allclose(apply(poses[0], points[0, 0]), expected[0, 0], atol=1e-14)


joint_values = arrays(np.float64, 3, elements=st.floats(-2, 2))
changes = arrays(np.float64, 9, elements=st.floats(-1, 1))


@given(poses, joint_values, changes)
def test_a_posed_instrument_is_moved_by_its_difference(
    pose: np.ndarray, joints: np.ndarray, change: np.ndarray
) -> None:
    before = Posed(pose, joints)
    after = before.moved(change)
    np.testing.assert_allclose(after.minus(before), change, atol=1e-9)
    np.testing.assert_allclose(before.moved(after.minus(before)).pose, after.pose, atol=1e-9)


@given(poses, joint_values, changes, poses)
def test_small_changes_are_the_same_seen_from_any_camera(
    pose: np.ndarray, joints: np.ndarray, change: np.ndarray, view_from_camera: np.ndarray
) -> None:
    before = Posed(pose, joints)
    seen = before.seen_from(view_from_camera)
    np.testing.assert_allclose(
        seen.moved(change).pose, before.moved(change).seen_from(view_from_camera).pose, atol=1e-9
    )


def test_candidates_are_stacked_and_taken_out_again() -> None:
    first, second = (Posed(np.eye(4) * k, np.full(3, k)) for k in (1.0, 2.0))
    both = Posed.stacked([first, second])
    assert len(both) == 2
    np.testing.assert_array_equal(both[1].pose, second.pose)
    np.testing.assert_array_equal(both[[1, 0]].joints, [second.joints, first.joints])


def test_cross_product_is_that_of_numpy() -> None:
    a, b = np.random.default_rng(5).normal(size=(2, 50, 3))
    for first, second in zip(a, b, strict=True):
        np.testing.assert_array_equal(cross(first, second), np.cross(first, second))


def test_a_single_pose_or_change_goes_with_many() -> None:
    rng = np.random.default_rng(1)
    changes = rng.uniform(-1, 1, (4, 8))
    pose = moved(np.eye(4), changes[0])
    of_one, of_many = moved(pose, changes), moved(moved(np.eye(4), changes), changes[1])
    for k, change in enumerate(changes):
        np.testing.assert_array_equal(of_one[k], moved(pose, change))
        np.testing.assert_array_equal(of_many[k], moved(moved(np.eye(4), change), changes[1]))
        np.testing.assert_allclose(change_between(pose, of_one)[k], change[:6], atol=1e-12)
        np.testing.assert_allclose(change_between(of_one, pose)[k], change_between(of_one[k], pose), atol=1e-12)


@pytest.mark.parametrize("angle", [1e-12, 1e-7, 1.0, np.pi - 1e-7, np.pi])
def test_rotation_vectors_of_any_angle_are_exact(angle: float) -> None:
    axes = np.random.default_rng(2).standard_normal((50, 3))
    vectors = angle * axes / np.linalg.norm(axes, axis=1, keepdims=True)
    found = log_rotation(Rotation.from_rotvec(vectors).as_matrix())
    apart = np.minimum(np.linalg.norm(found - vectors, axis=1), np.linalg.norm(found + vectors, axis=1))
    assert apart.max() < 2e-15 + 1e-15 * angle
