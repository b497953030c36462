"""What errors of the camera file do to a pose: the outline that is seen stays, and so the pose moves."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers.session_worlds import SMALL, make_frames_in_memory

from dvrk_cmaes import Body, Camera, InputError, estimate
from dvrk_cmaes.calibration.blocks import ViewAsSeen
from dvrk_cmaes.calibration.session_camera import Lens
from dvrk_cmaes.config import CameraConfig, EstimateConfig
from dvrk_cmaes.geometry import Posed, apply
from dvrk_cmaes.io.toml_file import read_config
from dvrk_cmaes.pose.camera_errors import (
    PARAMETERS,
    covariance_by_camera,
    displacements,
    file_covariance,
    moves_by_camera,
)


def with_error(number: int, size: float) -> Camera:
    """Give the camera with an error of one parameter."""
    focal, aspect, right, down, radial = size * np.eye(5)[number]
    return replace(
        SMALL,
        fx=SMALL.fx * np.exp(focal - aspect / 2),
        fy=SMALL.fy * np.exp(focal + aspect / 2),
        cx=SMALL.cx + right * SMALL.fx,
        cy=SMALL.cy + down * SMALL.fx,
        distortion=(radial, 0.0, 0.0, 0.0),
    )


@pytest.mark.parametrize(("number", "size"), [(0, 0.02), (2, 0.02), (3, 0.02), (4, 0.2)])
def test_pose_moves_with_the_camera_as_an_estimate_of_the_same_mask_does(
    bundled_body: Body, number: int, size: float
) -> None:
    _, truths, frames = make_frames_in_memory(bundled_body, 4, level="clean", seed=11)
    moved, expected = [], []
    for truth, frame in zip(truths, frames, strict=True):
        data, at = frame.data, Posed(truth.camera_from_root, truth.values)
        found = [
            estimate(data.mask, with_error(number, sign * size), frame.result.readings, instrument=bundled_body)
            for sign in (1, -1)
        ]
        ends = [apply(one.camera_from_root, bundled_body.instrument.ends([*one.joints.values()])) for one in found]
        step = size * moves_by_camera(bundled_body.instrument, SMALL, at)[:, number]
        there = [at.moved(sign * step) for sign in (1, -1)]
        of_step = [apply(one.pose, bundled_body.instrument.ends(one.joints)) for one in there]
        moved.append(1e3 * (ends[0] - ends[1]).mean(axis=0))
        expected.append(1e3 * (of_step[0] - of_step[1]).mean(axis=0))
    off = np.linalg.norm(np.median(np.array(moved) - np.array(expected), axis=0))
    assert off < 0.35 * np.linalg.norm(np.median(moved, axis=0)) + 0.1


LENSES = {
    "no distortion": ("plumb_bob", ()),
    "plumb_bob": ("plumb_bob", (-0.2, 0.05, 1e-3, -2e-3, 0.01)),
    "rational_polynomial without coefficients": ("rational_polynomial", ()),
    "rational_polynomial": ("rational_polynomial", (-0.2, 0.05, 1e-3, -2e-3, 0.01, 0.1, 0.05, 0.01)),
    "equidistant": ("equidistant", (0.02, -0.01, 0.005, 0.0)),
}


@pytest.mark.parametrize("lens", LENSES)
def test_points_move_with_aspect_and_radial_coefficient_of_every_lens_as_they_are_projected(lens: str) -> None:
    model, distortion = LENSES[lens]
    camera = replace(SMALL, model=model, distortion=distortion)
    points = np.random.default_rng(0).uniform([-0.25, -0.2, 0.9], [0.25, 0.2, 1.1], (40, 3))
    block = Lens(EstimateConfig(), camera)
    moves = displacements(camera, camera.project(points), points[:, :2] / points[:, 2:])
    for k, number in enumerate(map(PARAMETERS.index, block.axes)):
        ends = [
            block.seen("", ViewAsSeen(camera, np.zeros(3), 0.0, 1.0), sign * 1e-4 * np.eye(2)[k]).camera.project(points)
            for sign in (1, -1)
        ]
        np.testing.assert_allclose(moves[:, :, number], (ends[0] - ends[1]) / 2e-4, rtol=1e-6, atol=1e-4)


def test_errors_of_the_file_are_in_metres_and_not_in_this_camera(bundled_body: Body) -> None:
    _, truths, frames = make_frames_in_memory(bundled_body, 1, level="clean", seed=11)
    given = frames[0].data.mask, SMALL, frames[0].result.readings
    exact = EstimateConfig(camera=CameraConfig(0.0, 0.0, 0.0, 0.0, 0.0))
    usual, right = (estimate(*given, instrument=bundled_body, config=config) for config in (EstimateConfig(), exact))
    np.testing.assert_allclose(usual.covariance, right.covariance)
    assert usual.expected_error.tip_90_given_camera_mm == pytest.approx(right.expected_error.tip_90_mm)
    assert usual.expected_error.tip_90_mm > right.expected_error.tip_90_mm + 0.3
    assert usual.tip_probability < right.tip_probability
    at = Posed(truths[0].camera_from_root, truths[0].values)
    spread = covariance_by_camera(bundled_body.instrument, SMALL, at, np.diag([0.01**2, 0, 0, 0, 0, 0]))
    assert np.sqrt(np.trace(spread[:3, :3])) == pytest.approx(0.01 * at.pose[2, 3], rel=0.15)
    spread = covariance_by_camera(bundled_body.instrument, SMALL, at, np.diag([0, 0, 0, 0, 0, 0.01**2]))
    tips = apply(at.pose, bundled_body.instrument.ends(at.joints)).mean(axis=0)
    assert np.sqrt(np.trace(spread)) == pytest.approx(0.01 * np.linalg.norm(tips))


def test_covariance_that_a_file_states_takes_the_place_of_the_settings() -> None:
    stated = tuple(map(tuple, (1e-4 * np.eye(5)).tolist()))
    given = file_covariance(replace(SMALL, covariance=stated), CameraConfig())
    np.testing.assert_allclose(given, np.diag([1e-4] * 5 + [0.001**2]))
    std = np.sqrt(np.diag(file_covariance(SMALL, CameraConfig())))
    assert dict(zip(PARAMETERS, std.round(6).tolist(), strict=True)) == {
        "focal_length": 0.005,
        "aspect": 0.002,
        "centre_right": 0.003,
        "centre_down": 0.003,
        "radial": 0.02,
        "instrument_size": 0.001,
    }


@pytest.mark.parametrize("name", ["focal_length_percent", "principal_point_px"])
def test_settings_of_the_camera_that_moved_are_refused_by_name(tmp_path: Path, name: str) -> None:
    path = tmp_path / "settings.toml"
    path.write_text(f"[session]\n{name} = 1.0\n")
    with pytest.raises(InputError, match=rf"session.{name} is no longer a setting: see camera\."):
        read_config(path, EstimateConfig())
