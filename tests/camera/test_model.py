"""Projection, its inverse and scaling of the camera, compared with OpenCV; the distortion is one-to-one everywhere."""

from __future__ import annotations

import dataclasses
import math
import pickle

import cv2
import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from dvrk_cmaes import Camera, InputError

REAL_LENSES = [
    Camera(1300, 1024, 1609.5, 1610.2, 608.9, 548.1, (-0.3931, 0.8277, -0.00156, -0.00293, 0.0)),
    Camera(640, 480, 827.9, 901.9, 399.5, 244.1, (-0.3517, 0.7089, 0.0044, -0.0008, -0.9176)),
    Camera(720, 576, 858.9, 934.9, 422.9, 284.2, (-0.2484, 0.2681, 0.0048, -0.0033)),
]


@st.composite
def cameras(draw: st.DrawFn, models: tuple[str, ...] = ("plumb_bob", "rational_polynomial", "equidistant")) -> Camera:
    width, height = draw(st.integers(64, 2000)), draw(st.integers(64, 1500))
    fx = draw(st.floats(0.8, 3)) * max(width, height)
    fy = fx * draw(st.floats(0.9, 1.1))
    cx, cy = draw(st.floats(0.25, 0.75)) * width, draw(st.floats(0.25, 0.75)) * height
    model = draw(st.sampled_from(models))

    def some(largest: float) -> float:
        return draw(st.floats(-largest, largest))

    if model == "equidistant":
        k = (some(0.1), some(0.1), some(0.1), some(0.1))
    elif model == "plumb_bob":
        k = (some(0.4), some(0.4), some(0.01), some(0.01), *draw(st.sampled_from([(), (0.2,), (-0.5,)])))
    else:
        k = (some(0.4), some(0.4), some(0.01), some(0.01), some(0.2), some(0.4), some(0.2), some(0.1))
    try:
        return Camera(width, height, fx, fy, cx, cy, k, model)
    except InputError:  # the distortion folds inside the image and is refused
        assume(False)
        raise


def grid(camera: Camera, count: int = 21) -> np.ndarray:
    """Give a grid (N, 2) of pixels over the whole image, including its outer corners."""
    u = np.linspace(-0.5, camera.width - 0.5, count)
    v = np.linspace(-0.5, camera.height - 0.5, count)
    return np.stack(np.meshgrid(u, v), axis=-1)


def reach(camera: Camera) -> float:
    """Give the largest undistorted radius in the image, in the plane z = 1."""
    return float(np.linalg.norm(camera.normalise(grid(camera)), axis=-1).max())


def on_plane(xy: np.ndarray, z: float = 1.0) -> np.ndarray:
    return np.concatenate([xy * z, np.full((*xy.shape[:-1], 1), z, xy.dtype)], axis=-1)


def opencv_projects(camera: Camera, points: np.ndarray) -> np.ndarray:
    zero = np.zeros(3)
    project = cv2.fisheye.projectPoints if camera.model == "equidistant" else cv2.projectPoints
    flat = points.reshape(-1, 1, 3)
    return project(flat, zero, zero, camera.matrix, np.array(camera.distortion))[0].reshape(*points.shape[:-1], 2)


@given(cameras(), st.floats(0.01, 0.5))
def test_projection_inverts_normalisation(camera: Camera, z: float) -> None:
    pixels = grid(camera)
    assert np.abs(camera.project(on_plane(camera.normalise(pixels), z)) - pixels).max() < 1e-6


@given(cameras())
def test_normalisation_inverts_projection(camera: Camera) -> None:
    xy = camera.normalise(grid(camera))
    assert np.abs(camera.normalise(camera.project(on_plane(xy))) - xy).max() < 1e-9


@given(cameras())
def test_projection_in_image_agrees_with_opencv(camera: Camera) -> None:
    points = on_plane(camera.normalise(grid(camera)), 0.1)
    assert np.abs(camera.project(points) - opencv_projects(camera, points)).max() < 1e-9


@pytest.mark.parametrize("camera", REAL_LENSES)
def test_real_lenses_agree_with_opencv_on_every_pixel(camera: Camera) -> None:
    pixels = np.stack(np.meshgrid(np.arange(camera.width), np.arange(camera.height)), axis=-1).astype(float)
    directions = camera.normalise(pixels)
    points = on_plane(directions)
    assert np.abs(camera.project(points) - pixels).max() < 1e-9
    assert np.abs(opencv_projects(camera, points) - pixels).max() < 1e-9


@given(cameras())
def test_distortion_just_outside_image_agrees_with_opencv(camera: Camera) -> None:
    corner = np.array([[-0.5, -0.5], [camera.width - 0.5, -0.5], [-0.5, camera.height - 0.5]])
    points = on_plane(camera.normalise(corner) * 1.0004)
    assert np.abs(camera.project(points) - opencv_projects(camera, points)).max() < 1e-9


@given(cameras(), st.integers(0, 2**32 - 1))
def test_distortion_is_invertible_at_all_radii(camera: Camera, seed: int) -> None:
    rng = np.random.default_rng(seed)
    radius = reach(camera) * 10.0 ** rng.uniform(-3, 3, 500)
    angle = rng.uniform(0, 2 * math.pi, 500)
    xy = radius[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    pixels = camera.project(on_plane(xy))
    assert (np.abs(camera.normalise(pixels) - xy) / (1 + radius[:, None])).max() < 1e-9


@given(cameras(), st.integers(0, 2**32 - 1))
def test_distortion_preserves_orientation(camera: Camera, seed: int) -> None:
    rng = np.random.default_rng(seed)
    xy = rng.uniform(-3, 3, (500, 2)) * reach(camera)
    h = 1e-6 * reach(camera)
    dx = camera.distort(xy + np.array([h, 0])) - camera.distort(xy - np.array([h, 0]))
    dy = camera.distort(xy + np.array([0, h])) - camera.distort(xy - np.array([0, h]))
    assert (dx[:, 0] * dy[:, 1] - dx[:, 1] * dy[:, 0] > 0).all()


@given(cameras(), st.integers(0, 2**32 - 1))
def test_motion_along_directions_is_derivative_of_projection(camera: Camera, seed: int) -> None:
    rng = np.random.default_rng(seed)
    xy = rng.uniform(-2, 2, (100, 2)) * reach(camera)
    xy = xy[np.abs(np.linalg.norm(xy, axis=1) / min(camera.lens_radius, 1e9) - 1) > 1e-3]  # not differentiable there
    points, directions = on_plane(xy) * rng.uniform(0.05, 0.2, (len(xy), 1)), rng.standard_normal((len(xy), 2))
    pixels, gradient = camera.project_along(points, directions)
    assert np.allclose(pixels, camera.project(points), rtol=0, atol=1e-9 * max(camera.width, np.abs(pixels).max()))
    for axis, step in enumerate(1e-6 * np.eye(3)):
        change = (camera.project(points + step) - camera.project(points - step)) / 2e-6
        assert np.allclose((change * directions).sum(axis=1), gradient[:, axis], atol=1e-5 * np.abs(gradient).max())


def test_far_points_do_not_fold_back_into_image() -> None:
    camera = REAL_LENSES[1]
    far = np.array([[2.0, 1.0]])
    assert opencv_projects(camera, on_plane(far))[0, 0] < 0  # a point right of the axis is projected left of the image
    assert camera.project(on_plane(far))[0, 0] > camera.width


@given(cameras(), st.sampled_from([(1, 2), (1, 4), (2, 1), (3, 1)]))
def test_scaling_preserves_image_corners(camera: Camera, ratio: tuple[int, int]) -> None:
    up, down = ratio
    width, height = camera.width // down * down, camera.height // down * down
    camera = dataclasses.replace(camera, width=width, height=height)
    scaled = camera.scaled(width * up // down, height * up // down)
    corners = np.array([[-0.5, -0.5], [width - 0.5, -0.5], [-0.5, height - 0.5], [width - 0.5, height - 0.5]])
    points = on_plane(camera.normalise(corners))
    expected = (corners + 0.5) * up / down - 0.5
    assert np.abs(scaled.project(points) - expected).max() < 1e-8


def test_pixel_of_halved_image_covers_four_pixels() -> None:
    camera = Camera(640, 480, 1025.88, 1025.88, 320.0, 240.0)
    half = camera.scaled(320, 240)
    centre_of_four = camera.normalise([0.5, 0.5])
    assert np.allclose(half.normalise([0.0, 0.0]), centre_of_four, atol=1e-15)
    assert half.matrix.tolist() == [[512.94, 0, 159.75], [0, 512.94, 119.75], [0, 0, 1]]


@pytest.mark.parametrize("size", [(142, 113), (81, 60), (1, 1), (2600, 1024)])
def test_scaling_to_any_size_maps_corners_to_corners(size: tuple[int, int]) -> None:
    camera = Camera(1280, 1024, 1600.0, 1610.0, 650.0, 512.0, (-0.2, 0.1, 0.0, 0.0))
    corners = np.array([[-0.5, -0.5], [1279.5, -0.5], [-0.5, 1023.5], [1279.5, 1023.5]])
    scaled = camera.scaled(*size)
    assert (scaled.width, scaled.height) == size
    expected = (corners + 0.5) * size / np.array([1280, 1024]) - 0.5
    np.testing.assert_allclose(scaled.project(on_plane(camera.normalise(corners))), expected, atol=1e-6)


def test_points_not_in_front_are_refused() -> None:
    camera = Camera(640, 480, 800.0, 800.0, 320.0, 240.0)
    for z in (0.0, -0.1):
        with pytest.raises(ValueError, match="z must be positive"):
            camera.project([[0.0, 0.0, 0.1], [0.0, 0.0, z]])


def test_zero_coefficients_are_pinhole_except_fisheye() -> None:
    pinhole = Camera(640, 480, 800.0, 800.0, 320.0, 240.0, (0.0,) * 5)
    assert pinhole.is_pinhole
    assert pinhole.lens_radius == math.inf
    fisheye = Camera(640, 480, 800.0, 800.0, 320.0, 240.0, (0.0,) * 4, "equidistant")
    assert not fisheye.is_pinhole
    assert fisheye.distort([0.3, 0.0])[0] == pytest.approx(math.atan(0.3), abs=1e-15)


def test_optical_axis_projects_to_principal_point() -> None:
    for model, coefficients in [("plumb_bob", (0.1,) * 4), ("equidistant", (0.1,) * 4)]:
        camera = Camera(640, 480, 800.0, 800.0, 320.0, 240.0, coefficients, model)
        assert camera.project([0.0, 0.0, 0.2]).tolist() == [320.0, 240.0]
        assert camera.normalise([320.0, 240.0]).tolist() == [0.0, 0.0]


def test_equality_hash_and_pickling() -> None:
    camera = REAL_LENSES[0]
    twin = pickle.loads(pickle.dumps(camera))
    assert twin == camera
    assert hash(twin) == hash(camera)
    assert "lens" not in dataclasses.asdict(camera)
    assert dataclasses.replace(camera, distortion=()).is_pinhole


GOOD = {"width": 640, "height": 480, "fx": 800.0, "fy": 800.0, "cx": 320.0, "cy": 240.0}


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"width": 0}, "width: expected a positive whole number of pixels, got 0"),
        ({"height": 480.5}, "height: expected a positive whole number of pixels, got 480.5"),
        ({"fx": 0.0}, "fx: expected a positive focal length in pixels, got 0"),
        ({"fy": -800.0}, "fy: expected a positive focal length in pixels, got -800"),
        ({"fx": math.nan}, "fx: expected a finite number of pixels, got nan"),
        ({"cy": math.inf}, "cy: expected a finite number of pixels, got inf"),
        ({"distortion": (0.1,)}, "distortion: expected 0 or 4 or 5 coefficients for plumb_bob, got 1"),
        ({"distortion": (0.1, math.nan, 0, 0)}, "distortion: expected finite coefficients, got [0.1, nan, 0.0, 0.0]"),
        ({"model": "equidistant"}, "distortion: expected 4 coefficients for equidistant, got 0"),
        (
            {"model": "plum_bob"},
            "distortion model: expected one of plumb_bob, rational_polynomial, equidistant, got 'plum_bob'",
        ),
        (
            {"distortion": (-2.0, 0.0, 0.0, 0.0)},
            "distortion: expected the plumb_bob map to be one-to-one over the image, got one that folds back on itself",
        ),
        (
            {"distortion": (0.0, 0.0, 0.9, 0.0)},
            "distortion: expected the plumb_bob map to be one-to-one over the image, got one that folds back on itself",
        ),
        (
            {"fx": 100.0, "fy": 100.0, "model": "equidistant", "distortion": (0.0, 0.0, 0.0, 0.0)},
            "distortion: expected the equidistant map to be one-to-one over the image, "
            "got one that folds back on itself or reaches 90 deg",
        ),
        (
            {"model": "rational_polynomial", "distortion": (0, 0, 0, 0, 0, 20.0, 0, 0)},
            "distortion: expected the rational_polynomial map to be one-to-one over the image, "
            "got one that folds back on itself",
        ),
    ],
)
def test_invalid_camera_is_refused_with_field_name(change: dict[str, object], message: str) -> None:
    with pytest.raises(InputError) as caught:
        Camera(**(GOOD | change))  # type: ignore[arg-type]
    assert str(caught.value) == message
