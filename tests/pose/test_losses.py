"""Every loss compared with its definition, and the closed-form shaft edges compared with a traced cylinder."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
import trimesh
from helpers.silhouette_bodies import rigid_instrument
from helpers.transforms import exp_rotation, transform
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from dvrk_cmaes import Body, Camera, Renderer
from dvrk_cmaes.geometry import project_cylinder
from dvrk_cmaes.pose.search.losses import (
    Terms,
    cylinder_loss,
    keypoint_loss,
    polar_lines,
)
from dvrk_cmaes.silhouette import PixelSums

OFF_CENTRE = Camera(640, 480, 858.9, 934.9, 168.0, 284.2)
OFFSET_WEIGHT = 0.005


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
    none, area = np.zeros(len(joints)), float(mask.sum())
    terms = Terms.of(renderer.sums(pose, joints, table, to_pixel=to_pixel), area, area, (none, none, none))
    mse, dist, scale = area * terms.mse, area * terms.dist, area * terms.scale
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


# Distance of lines


# L_cylinder

REFERENCE = project_cylinder(np.array([0.01, -0.005, 0.11]), np.array([0.6, -0.48, 0.64]), 0.0041)


@pytest.mark.parametrize("order", [[0, 1], [1, 0]])
@pytest.mark.parametrize("signs", [[1, 1], [-1, 1], [-1, -1]])
@pytest.mark.parametrize("scale", [1.0, 0.01])
def test_cylinder_loss_is_zero_for_equivalent_edges(order: list[int], signs: list[int], scale: float) -> None:
    written = REFERENCE[order] * np.array(signs)[:, None] * scale
    assert cylinder_loss(written, REFERENCE, OFF_CENTRE, OFFSET_WEIGHT) == pytest.approx(0, abs=1e-9)


# L_kpt

pixels = arrays(np.float64, (2, 2), elements=st.floats(-100, 800))


@given(pixels)
def test_keypoint_loss_is_zero_at_truth_in_either_order(tips: np.ndarray) -> None:
    assert keypoint_loss(tips, tips) == 0
    assert keypoint_loss(tips[::-1], tips) == pytest.approx(0, abs=1e-9)


# Readings and total
