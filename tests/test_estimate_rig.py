"""``estimate`` with a rig of two views: one answer for both, missing and empty views, and views that disagree."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from helpers.transforms import exp_rotation, lookat_pose, rotation_angle, transform

from dvrk_cmaes import Body, Camera, EstimateConfig, Renderer, Result, Rig, estimate

LEFT = Camera(640, 480, 1025.0, 1025.0, 320.0, 240.0)
RIGHT = Camera(720, 540, 1150.0, 1140.0, 400.0, 260.0)
RIG = Rig.stereo(LEFT, RIGHT, transform(exp_rotation([0.01, 0.02, -0.01]), [-0.0053, 0.0003, 0.0002]))
TRUTH = lookat_pose(0.5, 1.0, 0.7, 0.11)
JOINTS = np.array([0.4, -0.3, 0.5])
READINGS = {"wrist_pitch": 0.45, "wrist_yaw": -0.2, "jaw": 0.4}
QUICK = EstimateConfig()
QUICK = replace(QUICK, threads=1, search=replace(QUICK.search, samples=128, starts=3, evaluations=200))

Masks = dict[str, np.ndarray]


@pytest.fixture(scope="module")
def masks(bundled_body: Body) -> Masks:
    """Give the exact masks of the true pose in both views."""
    found = {}
    for view in RIG.views:
        pose = view.view_from_camera @ TRUTH
        found[view.name] = Renderer(bundled_body, view.camera).masks(pose[None], JOINTS[None])[0]
    return found


@pytest.fixture(scope="module")
def solve(bundled_body: Body) -> Any:
    """Give a function that estimates with few evaluations."""

    def run(masks: Any, rig: Any = RIG, **more: Any) -> Result:
        return estimate(masks, rig, READINGS, bundled_body, config=QUICK, **more)

    return run


@pytest.fixture(scope="module")
def both(solve: Any, masks: Masks) -> Result:
    return solve(masks)


@pytest.fixture(scope="module")
def right_only(solve: Any, masks: Masks) -> Result:
    return solve({"left": None, "right": masks["right"]})


def errors(result: Result) -> tuple[float, float]:
    """Give the errors of a result's position, mm, and rotation, deg."""
    assert result.camera_from_root is not None
    off = result.camera_from_root[:3, 3] - TRUTH[:3, 3]
    return 1e3 * float(np.linalg.norm(off)), float(np.degrees(rotation_angle(result.camera_from_root, TRUTH)))


def test_single_view_beside_the_first_camera_gives_a_pose_in_the_first_camera(right_only: Result) -> None:
    distance, angle = errors(right_only)
    assert distance < 0.4
    assert angle < 1.5
    assert right_only.views == ("right",)
    assert "view left: no mask" in right_only.unused


def test_tips_are_pixels_of_the_first_camera(right_only: Result) -> None:
    np.testing.assert_allclose(LEFT.project(np.stack(right_only.tips)), np.stack(right_only.tips_px), atol=1e-9)


def test_view_with_an_empty_mask_is_left_out(solve: Any, masks: Masks, right_only: Result) -> None:
    result = solve({"left": np.zeros_like(masks["left"]), "right": masks["right"]})
    assert "view left: its mask is empty" in result.unused
    np.testing.assert_array_equal(result.camera_from_root, right_only.camera_from_root)


def test_occlusion_in_one_view_is_a_remark_about_that_view(solve: Any, masks: Masks, bundled_body: Body) -> None:
    tips = LEFT.project(np.einsum("ij,kj->ki", TRUTH[:3, :3], bundled_body.instrument.tips(JOINTS)) + TRUTH[:3, 3])
    v, u = np.indices(masks["left"].shape)
    hidden = masks["left"] & (np.hypot(*(np.stack([u, v]) - tips.mean(axis=0)[:, None, None])) > 60)
    result = solve({"left": hidden, "right": masks["right"]})
    assert errors(result)[0] < 1.0
    assert not [reason for reason in result.reasons if reason.startswith("wrist or jaws off")]
    assert [text for text in result.warnings if text.startswith("view left: wrist or jaws off")]


def test_rig_that_is_turned_is_named(solve: Any, masks: Masks) -> None:
    wrong = transform(exp_rotation([np.deg2rad(0.3), 0, 0]), np.zeros(3)) @ RIG.view("right").view_from_camera
    result = solve(masks, Rig.stereo(LEFT, RIGHT, wrong))
    assert result.status == "doubtful"
    assert [reason for reason in result.reasons if reason.startswith("views disagree: right fits left only if turned")]
    assert np.degrees(np.linalg.norm(result.view_fits[1].rotation_deg)) == pytest.approx(np.degrees(0.3), rel=0.3)
