"""Evidence from a mask: shaft edges, jaw tips, contour and distance field, and the messages for missing evidence."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from helpers.transforms import lookat_pose

from dvrk_cmaes import Body, Camera, Renderer
from dvrk_cmaes.evidence.distance_field import FIELDS, distance_field
from dvrk_cmaes.evidence.gather import gather_evidence
from dvrk_cmaes.evidence.jaw_tips import distal_direction
from dvrk_cmaes.evidence.shaft_edges import ShaftEdges, axis_tilt_error, find_contour, shaft_axis
from dvrk_cmaes.geometry import project_cylinder

CAMERAS = {
    "pinhole": Camera(640, 480, 880, 880, 330, 250),
    "lens": Camera(640, 480, 860, 930, 330, 250, (-0.25, 0.2, 0.004, -0.003, 0.0)),
}
POSE = lookat_pose(0.5, 1.0, 0.7, 0.11)
JOINTS = np.array([0.4, -0.3, 0.8])


def drawn(body: Body, camera: Camera) -> np.ndarray:
    return Renderer(body, camera).masks(POSE[None], JOINTS[None])[0]


@pytest.mark.parametrize("camera", CAMERAS.values(), ids=CAMERAS.keys())
def test_shaft_edges_agree_with_projected_cylinder(bundled_body: Body, camera: Camera) -> None:
    shaft = bundled_body.instrument.shaft
    assert shaft is not None
    mask = drawn(bundled_body, camera)
    evidence = gather_evidence(mask, camera, bundled_body.instrument)
    planes = evidence.shaft_edges[0].planes
    expected = project_cylinder(POSE[:3, 3], POSE[:3, 2], shaft.radius)
    expected /= np.linalg.norm(expected, axis=1, keepdims=True)
    likeness = np.abs(planes @ expected.T).max(axis=1)
    assert (np.degrees(np.arccos(np.minimum(likeness, 1))) < 0.25).all()
    direction, _ = shaft_axis(planes, shaft.radius)
    off = np.arccos(min(1.0, abs(float(direction @ POSE[:3, 2]))))
    assert off < 4 * axis_tilt_error(evidence.shaft_edges[0], camera, shaft.radius)


@pytest.mark.parametrize("width", [1280, 2560])
def test_rough_edges_of_a_large_image_are_found(bundled_body: Body, width: int) -> None:
    camera = CAMERAS["pinhole"].scaled(width, width * 3 // 4)
    rough = cv2.GaussianBlur(np.random.default_rng(0).standard_normal((480, 640)), (0, 0), 3.0)
    rough = cv2.resize(rough * (1.6 / rough.std()), (camera.width, camera.height)) * (width / 640)
    mask = drawn(bundled_body, camera)
    inside, outside = (cv2.distanceTransform(part.astype(np.uint8), cv2.DIST_L2, 5) for part in (mask, ~mask))
    evidence = gather_evidence(inside - outside + rough > 0, camera, bundled_body.instrument)
    assert bundled_body.instrument.shaft is not None
    expected = project_cylinder(POSE[:3, 3], POSE[:3, 2], bundled_body.instrument.shaft.radius)
    expected /= np.linalg.norm(expected, axis=1, keepdims=True)
    likeness = np.abs(evidence.shaft_edges[0].planes @ expected.T).max(axis=1)
    assert (np.degrees(np.arccos(np.minimum(likeness, 1))) < 1.5).all()
    # the ends are on the edges in the whole image
    lines = expected @ np.linalg.inv(camera.matrix)
    lines /= np.linalg.norm(lines[:, :2], axis=1, keepdims=True)
    away = np.abs(evidence.shaft_edges[0].ends @ lines[:, :2].T + lines[:, 2])
    assert away.min(axis=2).max() < 5 * width / 640


def towards_jaws(mask: np.ndarray, camera: Camera, ends: list[list[list[float]]]) -> tuple[float, bool]:
    """Give the horizontal part of the direction to the jaws along edges whose ends, ideal pixels, are given."""
    edges = ShaftEdges(np.zeros((2, 3)), np.array(ends), np.ones(2), np.full(2, 50))
    direction, sure = distal_direction(mask, edges, find_contour(mask, camera), camera)
    return float(direction[0]), sure


def test_instrument_points_away_from_where_it_comes_in() -> None:
    v, u = np.mgrid[:480, :640]
    beam = np.abs(v - 240) < 20
    ends = [[[300.0, 220.0], [420.0, 220.0]], [[420.0, 260.0], [300.0, 260.0]]]
    camera = CAMERAS["pinhole"]
    assert towards_jaws(beam & (u < 450), camera, ends) == (1, True)
    assert towards_jaws(beam & (u > 100), camera, ends) == (-1, True)
    # where it ends before the border, the side on which it reaches farther is only likely
    assert towards_jaws(beam & (u > 100) & (u < 500), camera, ends) == (-1, False)
    assert towards_jaws(beam & (u > 290) & (u < 500), camera, ends) == (1, False)


def test_jaw_tips_agree_with_projected_tips(bundled_body: Body) -> None:
    camera = CAMERAS["pinhole"]
    tips = gather_evidence(drawn(bundled_body, camera), camera, bundled_body.instrument).tips
    assert tips is not None
    points = bundled_body.instrument.tips(JOINTS) @ POSE[:3, :3].T + POSE[:3, 3]
    expected = camera.project(points)
    gap = np.linalg.norm(tips[:, None] - expected[None], axis=2)
    assert min(gap[0, 0] + gap[1, 1], gap[0, 1] + gap[1, 0]) < 16


def test_round_mask_has_no_shaft_edges(bundled_body: Body) -> None:
    v, u = np.mgrid[:480, :640]
    evidence = gather_evidence(np.hypot(u - 300, v - 200) < 60, CAMERAS["pinhole"], bundled_body.instrument)
    assert evidence.shaft_edges == ()
    assert any(line.startswith("shaft edges: ") for line in evidence.unused)


@pytest.mark.parametrize("method", FIELDS)
def test_distance_field_is_zero_inside_mask(method: str) -> None:
    v, u = np.mgrid[:90, :120]
    mask = np.hypot(u - 60, v - 40) < 20
    field = distance_field(mask, method)
    assert (field[mask] == 0).all()
    np.testing.assert_allclose(field, np.maximum(np.hypot(u - 60, v - 40) - 20, 0), rtol=0.03, atol=0.8)
