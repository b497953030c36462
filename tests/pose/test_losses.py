"""Every loss compared with its definition, and the closed-form shaft edges compared with a traced cylinder."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
import trimesh
from helpers.silhouette_bodies import rigid_instrument
from helpers.transforms import exp_rotation, transform
from hypothesis import assume, given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from dvrk_cmaes import Body, Camera, Renderer
from dvrk_cmaes.geometry import project_cylinder
from dvrk_cmaes.pose.search.losses import (
    cylinder_loss,
    keypoint_loss,
    line_distance,
    mse_loss,
    polar_lines,
    scale_loss,
)
from dvrk_cmaes.silhouette import PixelSums

OFF_CENTRE = Camera(640, 480, 858.9, 934.9, 168.0, 284.2)
OFFSET_WEIGHT = 0.005

angles = st.floats(-10, 10)
offsets = st.floats(-2000, 2000)


# Silhouette terms


@pytest.mark.parametrize("to_pixel", [True, False])
def test_rendered_terms_agree_with_images(bundled_body: Body, to_pixel: bool) -> None:
    camera = Camera(160, 120, 220, 220, 90, 60)
    renderer = Renderer(bundled_body, camera, threads=1)
    pose = transform(exp_rotation([[0.5, 0.4, 0.1], [0.52, 0.4, 0.1], [0.2, 0.9, 0.5]]), [0.0, 0.005, 0.1])
    joints = np.array([[0.2, -0.3, 0.6], [0.2, -0.3, 0.6], [0.5, 0.1, 0.2]])
    mask = renderer.trace(pose[:1], joints[:1])[0]
    away = cv2.distanceTransform((~mask).astype(np.uint8), cv2.DIST_L2, 5)
    table = PixelSums.of(np.stack([np.ones_like(away), mask, away]))
    area, overlap, dist = renderer.sums(pose, joints, table, to_pixel=to_pixel).T
    square = float(mask.sum())
    mse, scale = mse_loss(area, overlap, square), scale_loss(area, square)
    traced = renderer.trace(pose, joints)
    brute_mse = (traced != mask).sum(axis=(1, 2))
    brute_dist = (traced * away).sum(axis=(1, 2))
    if to_pixel:
        np.testing.assert_array_equal(mse, brute_mse)
        np.testing.assert_allclose(dist, brute_dist, rtol=1e-5, atol=1e-4)
        assert (mse[0], dist[0], scale[0]) == (0, 0, 0)
    else:  # the outline runs through the pixels at the border, each of which counts in part
        rim = np.logical_xor(mask, cv2.erode(mask.astype(np.uint8), np.ones((3, 3)))).sum()
        assert mse[0] < 0.4 * rim
        assert dist[0] < 0.2 * rim
        assert scale[0] < 0.1 * rim
        np.testing.assert_allclose(mse[1:], brute_mse[1:], atol=0.4 * rim)
    for term in (mse, dist, scale):
        assert term[0] < term[1:].min()


# Shaft edges


def coverage_edges(camera: Camera, pose: np.ndarray, radius: float) -> np.ndarray:
    """Measure points (N, 2) on the outline of a long thin cylinder along z in a traced, supersampled image."""
    cylinder = trimesh.creation.cylinder(radius, height=0.6, sections=1024)
    body = Body.prepare(rigid_instrument(cylinder))
    fine = camera.scaled(camera.width * 2, camera.height * 2)
    mask = Renderer(body, fine, threads=1).trace(pose[None], np.zeros((1, 0)))[0]
    rows, columns = np.nonzero(mask[:, 1:] != mask[:, :-1])
    u = columns + 0.5  # the outline is halfway between two pixels, on average
    return (np.stack([u, rows], axis=1) + 0.5) / 2 - 0.5


@pytest.mark.parametrize("camera", [Camera(320, 240, 441, 441, 160, 120), OFF_CENTRE.scaled(320, 240)])
@pytest.mark.parametrize("turn", [[-0.9, 0.2, 0.0], [1.2, 0.7, 0.0], [0.5, -0.4, 0.0]])
def test_projected_edges_agree_with_traced_cylinder(camera: Camera, turn: list[float]) -> None:
    radius = 0.0041
    pose = transform(exp_rotation(turn), [*camera.normalise([150.0, 110.0]), 1.0])
    pose[:3, 3] *= 0.11
    points = coverage_edges(camera, pose, radius)
    normals = project_cylinder(pose[:3, 3], pose[:3, 2], radius)
    theta, rho = polar_lines(normals, camera)
    away = points[:, :1] * np.cos(theta) + points[:, 1:] * np.sin(theta) - rho
    nearer = np.abs(away).argmin(axis=1)
    near_end = np.abs(away).min(axis=1) > 2  # the cylinder's own end may be in view
    assert near_end.mean() < 0.2
    for edge in range(2):
        residual = away[~near_end & (nearer == edge), edge]
        assert len(residual) > 100
        assert abs(np.median(residual)) < 0.05
        assert np.abs(residual).max() < 0.3  # slightly more than half a pixel of the supersampled image


def test_edge_planes_touch_cylinder() -> None:
    rng = np.random.default_rng(7)
    point = rng.uniform([-0.05, -0.05, 0.05], [0.05, 0.05, 0.2], (50, 3))
    direction = rng.standard_normal((50, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    planes = project_cylinder(point, direction, 0.004)
    planes /= np.linalg.norm(planes, axis=-1, keepdims=True)
    np.testing.assert_allclose((planes @ direction[:, :, None])[..., 0], 0, atol=1e-12)
    np.testing.assert_allclose(np.abs((planes @ point[:, :, None])[..., 0]), 0.004, atol=1e-12)


def test_camera_inside_cylinder_has_no_edges_and_large_loss() -> None:
    lines = project_cylinder(np.array([0.001, 0.0, 0.0]), np.array([0.0, 0.0, 1.0]), 0.004)
    assert np.isnan(lines).all()
    reference = project_cylinder(np.array([0.0, 0.0, 0.1]), np.array([1.0, 0.0, 0.0]), 0.004)
    loss = cylinder_loss(lines, reference, OFF_CENTRE, OFFSET_WEIGHT)
    assert np.isfinite(loss)
    assert loss >= np.pi


@given(arrays(np.float64, 3, elements=st.floats(-2, 2)).filter(lambda a: np.hypot(a[0], a[1]) > 0.1))
def test_polar_form_describes_same_line_in_pixels(line: np.ndarray) -> None:
    theta, rho = polar_lines(line, OFF_CENTRE)
    foot = rho * np.array([np.cos(theta), np.sin(theta)])
    for along in (-300.0, 0.0, 500.0):
        u, v = foot + along * np.array([-np.sin(theta), np.cos(theta)])
        x, y = (u - OFF_CENTRE.cx) / OFF_CENTRE.fx, (v - OFF_CENTRE.cy) / OFF_CENTRE.fy
        assert line @ [x, y, 1] == pytest.approx(0, abs=1e-9)


# Distance of lines


@given(angles, offsets, angles, offsets, st.integers(-3, 3))
def test_line_distance_ignores_direction_of_normal(
    theta_a: float, rho_a: float, theta_b: float, rho_b: float, half_turns: int
) -> None:
    a = (np.float64(theta_a), np.float64(rho_a))
    same = (np.float64(theta_a + half_turns * np.pi), np.float64(rho_a * (-1) ** half_turns))
    assert line_distance(a, same, OFFSET_WEIGHT) == pytest.approx(0, abs=1e-9)
    if abs(np.cos(theta_a - theta_b)) > 1e-9:
        b = (np.float64(theta_b), np.float64(rho_b))
        assert line_distance(same, b, OFFSET_WEIGHT) == pytest.approx(line_distance(a, b, OFFSET_WEIGHT), abs=1e-9)


@given(st.floats(0, np.pi), offsets, st.floats(0, np.pi), offsets)
def test_line_distance_is_angle_and_weighted_offset(theta_a: float, rho_a: float, theta_b: float, rho_b: float) -> None:
    gap = abs(theta_a - theta_b)
    shift = abs(rho_a + rho_b) if gap > np.pi / 2 else abs(rho_a - rho_b)
    assume(abs(gap - np.pi / 2) > 1e-9)  # at right angles the sign of rho is undetermined
    found = line_distance(
        (np.float64(theta_a), np.float64(rho_a)), (np.float64(theta_b), np.float64(rho_b)), OFFSET_WEIGHT
    )
    assert found == pytest.approx(min(gap, np.pi - gap) + OFFSET_WEIGHT * shift, abs=1e-9)


# L_cylinder

REFERENCE = project_cylinder(np.array([0.01, -0.005, 0.11]), np.array([0.6, -0.48, 0.64]), 0.0041)


@pytest.mark.parametrize("order", [[0, 1], [1, 0]])
@pytest.mark.parametrize("signs", [[1, 1], [-1, 1], [-1, -1]])
@pytest.mark.parametrize("scale", [1.0, 0.01])
def test_cylinder_loss_is_zero_for_equivalent_edges(order: list[int], signs: list[int], scale: float) -> None:
    written = REFERENCE[order] * np.array(signs)[:, None] * scale
    assert cylinder_loss(written, REFERENCE, OFF_CENTRE, OFFSET_WEIGHT) == pytest.approx(0, abs=1e-9)


def test_cylinder_loss_grows_with_pose_error() -> None:
    shift = np.linspace(0, 0.01, 11)
    point = np.array([0.01, -0.005, 0.11]) + shift[:, None] * [0.64, 0.0, -0.6]
    projected = project_cylinder(point, np.broadcast_to([0.6, -0.48, 0.64], point.shape), 0.0041)
    loss = cylinder_loss(projected, REFERENCE, OFF_CENTRE, OFFSET_WEIGHT)
    assert loss.shape == (11,)
    assert loss[0] == pytest.approx(0, abs=1e-9)
    assert (np.diff(loss) > 0).all()


# L_kpt

pixels = arrays(np.float64, (2, 2), elements=st.floats(-100, 800))


@given(pixels)
def test_keypoint_loss_is_zero_at_truth_in_either_order(tips: np.ndarray) -> None:
    assert keypoint_loss(tips, tips) == 0
    assert keypoint_loss(tips[::-1], tips) == pytest.approx(0, abs=1e-9)


# Readings and total
