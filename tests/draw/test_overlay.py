"""The overlay of a result: which parts are drawn, where, and on images and masks of which sizes."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from helpers.transforms import moved

from dvrk_cmaes import Body, Camera, Renderer, Result
from dvrk_cmaes.draw.canvas import DARK, GREEN, ORANGE, PURPLE, SKY_BLUE, VERMILLION, WHITE, YELLOW, without_strips
from dvrk_cmaes.draw.overlay import draw_overlay
from dvrk_cmaes.draw.panels import header
from dvrk_cmaes.draw.track_overlay import project_visible, projected_edges, skeleton_lines
from dvrk_cmaes.results.result import Quality

PINHOLE = Camera(640, 480, 1030.0, 1030.0, 318.2, 243.7)
LENS = Camera(640, 480, 600.0, 600.0, 318.2, 243.7, (-0.28, 0.09, 0.0, 0.0))
POSE = np.array(
    [
        [-0.63976787, -0.40559978, -0.65282914, -0.00839115],
        [0.06232529, -0.87399117, 0.48192841, -0.01286997],
        [-0.76603696, 0.26763454, 0.58443060, 0.12449826],
        [0.0, 0.0, 0.0, 1.0],
    ]
)
JOINTS = {"wrist_pitch": 0.81, "wrist_yaw": -0.47, "jaw": 0.8}


def result(pose: np.ndarray | None = POSE, **changes: object) -> Result:
    one = Result(
        frame="0026",
        status="ok",
        reasons=(),
        instrument="lnd",
        root_link="roll_link",
        camera_from_root=pose,
        joints=JOINTS,
        readings={"wrist_pitch": 0.9, "wrist_yaw": -0.4},
        quality=Quality(0.96, 0.3, {}, 0.6, 2.1),
        covariance=np.eye(9) * 1e-6,
    )
    return replace(one, **changes)  # type: ignore[arg-type]


def test_legend_leaves_out_what_is_not_drawn(bundled_body: Body) -> None:
    """In a mask without a shaft no edges of it are found."""
    mask, round_ = true_mask(bundled_body, PINHOLE), np.hypot(*np.mgrid[-240:240, -320:320]) < 30
    shown = [draw_overlay(result(), each, PINHOLE, bundled_body) for each in (mask, round_)]
    legends = [overlay[-round(52 * overlay.shape[1] / 1280) :] for overlay in shown]
    assert [count(legend, ORANGE) > 0 for legend in legends] == [True, False]


def true_mask(body: Body, camera: Camera, pose: np.ndarray = POSE) -> np.ndarray:
    return Renderer(body, camera, threads=1).masks(pose[None], np.array([list(JOINTS.values())]))[0]


def count(image: np.ndarray, colour: tuple[int, int, int]) -> int:
    """Count the pixels close to a colour."""
    return int((np.abs(image.astype(int) - colour).max(axis=2) < 12).sum())


def picture_of(overlay: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    """Crop the frame between the strips of text, for a result without reasons."""
    unit = overlay.shape[1] / 1280
    top = header(result(), overlay.shape[1], unit).shape[0]
    return overlay[top : top + round(overlay.shape[1] * shape[0] / shape[1])]


@pytest.mark.parametrize(
    ("camera", "width"),
    [
        (PINHOLE, 1280),
        (LENS, 1280),
        (PINHOLE.scaled(320, 240), 1280),
        (PINHOLE.scaled(1300, 975), 1300),
        (PINHOLE.scaled(2560, 1920), 2000),
    ],
)
def test_all_parts_are_drawn(bundled_body: Body, camera: Camera, width: int) -> None:
    mask = true_mask(bundled_body, camera)
    drawn = draw_overlay(result(), mask, camera, bundled_body)
    assert drawn.dtype == np.uint8
    assert drawn.shape[1:] == (width, 3)
    frame = picture_of(drawn, mask.shape)
    stored = cv2.imdecode(cv2.imencode(".jpg", drawn)[1], cv2.IMREAD_COLOR)
    assert abs(len(without_strips(stored)) - len(frame)) < 8
    for colour in (SKY_BLUE, ORANGE, PURPLE, WHITE, VERMILLION, GREEN):
        assert count(frame, colour) > 30, colour


def test_tips_are_enlarged_in_the_corner_with_the_least_of_the_mask(bundled_body: Body) -> None:
    mask, absent = true_mask(bundled_body, PINHOLE), np.eye(4)
    absent[:3] = POSE[:3]
    absent[0, 3] += 0.2  # beside the image
    drawn, without = (
        picture_of(draw_overlay(result(at), mask, PINHOLE, bundled_body), mask.shape) for at in (POSE, absent)
    )
    upper_right = np.s_[2 : round(0.3 * len(drawn)) - 2, 1282 - round(0.3 * len(drawn)) : 1278]
    assert mask[:144, :144].any()
    assert not mask[:144, -144:].any()
    assert count(drawn[upper_right], PURPLE) > 30
    assert count(drawn[upper_right], SKY_BLUE) > 100
    assert count(without[upper_right], PURPLE) + count(without[upper_right], SKY_BLUE) == 0


def test_instrument_through_camera_plane_is_clipped(bundled_body: Body) -> None:
    through = POSE.copy()
    through[:3, 3] = [0.0, 0.0, 0.02]  # most of the shaft lies behind the camera
    mask = true_mask(bundled_body, PINHOLE, through)
    assert draw_overlay(result(through), mask, PINHOLE, bundled_body).shape[1] == 1280
    assert np.isnan(project_visible(PINHOLE, np.array([[0.0, 0.0, -0.1], [0.0, 0.0, 0.004]]))).all()


@pytest.mark.parametrize("camera", [PINHOLE, LENS])
def test_projected_edges_lie_on_outline(bundled_body: Body, camera: Camera) -> None:
    mask = true_mask(bundled_body, camera)
    for edge in projected_edges(bundled_body.instrument, POSE, camera):
        inside = edge[((edge > 3) & (edge < [636, 476])).all(axis=1)]
        assert len(inside) > 8
        for u, v in inside.round().astype(int):
            around = mask[v - 2 : v + 3, u - 2 : u + 3]
            assert around.any()
            assert not around.all()


def test_skeleton_ends_at_projected_tips(bundled_body: Body) -> None:
    joints = np.array(list(JOINTS.values()))
    line, tips = skeleton_lines(bundled_body.instrument, POSE, joints, PINHOLE)
    expected = PINHOLE.project(bundled_body.instrument.tips(joints) @ POSE[:3, :3].T + POSE[:3, 3])
    np.testing.assert_allclose(tips, expected)
    np.testing.assert_allclose(line[-2], PINHOLE.project(POSE[:3, 3]), atol=0.5)  # the wrist's pitch axis


def test_tints_show_mask_and_silhouette_differences(bundled_body: Body) -> None:
    mask = true_mask(bundled_body, PINHOLE)
    off = moved(POSE, [0.002, 0.002, 0.0, 0.0, 0.0, 0.1])

    def areas(pose: np.ndarray) -> tuple[float, float]:
        """Give the share of the mask that each tint covers."""
        frame = picture_of(draw_overlay(result(pose), mask, PINHOLE, bundled_body), mask.shape).astype(int)
        ground, inside = np.array(DARK), np.array([56, 56, 56])
        half = [(inside + YELLOW) // 2, (ground + SKY_BLUE) // 2]
        mask_only, silhouette_only = ((np.abs(frame - tint).max(axis=2) < 4).sum() for tint in half)
        return mask_only / (4 * mask.sum()), silhouette_only / (4 * mask.sum())

    assert max(areas(POSE)) < 0.002
    assert min(areas(off)) > 0.02
