"""Rigs of several cameras: their checks, and the files of stereo pairs."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from helpers.places import SHARED
from helpers.transforms import apply, exp_rotation, inverse, transform

from dvrk_cmaes import Camera, InputError, Rig
from dvrk_cmaes.camera.rig_files import read_rig

LEFT = Camera(640, 480, 1000.0, 1010.0, 300.0, 250.0)
RIGHT = Camera(720, 576, 900.0, 900.0, 380.0, 290.0)
POSE = transform(exp_rotation([0.02, -0.03, 0.01]), [-0.0053, 0.0002, 0.0004])
POINTS = np.array([[0.01, 0.02, 0.1], [-0.03, 0.0, 0.15], [0.0, -0.02, 0.07]])


def ros(camera: Camera, *, baseline: float = 0.0, rectification: Any = None) -> dict[str, Any]:
    """Give a camera_info document of a camera; ``baseline`` is that of the right eye, m."""
    turn = np.eye(3) if rectification is None else rectification
    k = camera.matrix
    p = np.hstack([k, [[-camera.fx * baseline], [0.0], [0.0]]])
    return {
        "image_width": camera.width,
        "image_height": camera.height,
        "camera_matrix": {"rows": 3, "cols": 3, "data": k.ravel().tolist()},
        "distortion_model": "plumb_bob",
        "distortion_coefficients": {"rows": 1, "cols": 5, "data": [0.0] * 5},
        "rectification_matrix": {"rows": 3, "cols": 3, "data": np.ravel(turn).tolist()},
        "projection_matrix": {"rows": 3, "cols": 4, "data": p.ravel().tolist()},
    }


def matrix(values: Any) -> dict[str, Any]:
    """Give a matrix as OpenCV's FileStorage has it."""
    array = np.atleast_2d(np.asarray(values, dtype=np.float64))
    return {"rows": array.shape[0], "cols": array.shape[1], "dt": "d", "data": array.ravel().tolist()}


def write(path: Path, document: Any) -> Path:
    """Write a YAML file; return its path."""
    path.write_text(yaml.safe_dump(document), encoding="utf-8")
    return path


def storage(pose: Any = POSE, *, names: tuple[str, ...] = ("K1", "D1", "K2", "D2", "R", "T"), unit: float = 1e3) -> Any:
    """Give OpenCV's document of a pair; ``unit`` is the length of a metre in it."""
    values = (LEFT.matrix, [[0.0] * 5], RIGHT.matrix, [[0.0] * 5], pose[:3, :3], pose[:3, 3:] * unit)
    return {name: matrix(value) for name, value in zip(names, values, strict=True)} | {"image_size": [640, 480]}


@pytest.mark.parametrize(
    ("pose", "text"),
    [
        (transform(np.eye(3), [-5.3, 0, 0]), r"5300 mm \(millimetres where metres are expected\?\)"),
        (transform(np.eye(3), [0, 0, 0]), "expected 0.5 to 500 mm between the eyes, got 0 mm"),
        (transform(exp_rotation([0, 1.0, 0]), [-0.005, 0, 0]), "at most 45 deg between the eyes, got 57.3 deg"),
        (2 * np.eye(4), "expected a rotation and a translation"),
        (np.full((4, 4), np.nan), "finite numbers"),
        (np.eye(3), r"array of shape \(3, 3\)"),
    ],
)
def test_impossible_rig_is_refused(pose: Any, text: str) -> None:
    with pytest.raises(InputError, match=f"^rig: view right: .*{text}"):
        Rig.stereo(LEFT, RIGHT, pose)


def test_unknown_view_is_refused_with_the_known_names() -> None:
    with pytest.raises(InputError, match="expected one of right, left, got 'rihgt'"):
        Rig.stereo(LEFT, RIGHT, POSE).view("rihgt")


def test_rectified_camera_infos_have_the_baseline_of_the_projection_matrix(tmp_path: Path) -> None:
    left = write(tmp_path / "left.yaml", ros(LEFT))
    right = write(tmp_path / "right.yaml", ros(RIGHT, baseline=0.0053))
    found = read_rig(left, right, rectified=True)
    np.testing.assert_allclose(found.rig.view("right").view_from_camera, transform(np.eye(3), [-0.0053, 0, 0]))
    assert (found.rig.camera, found.rig.view("right").camera) == (LEFT, RIGHT)
    assert found.notes == ()


def test_raw_camera_infos_are_joined_through_the_rectified_cameras(tmp_path: Path) -> None:
    turns = exp_rotation([0.01, -0.09, 0.02]), exp_rotation([-0.02, -0.11, 0.03])
    left = write(tmp_path / "left.yaml", ros(LEFT, rectification=turns[0]))
    right = write(tmp_path / "right.yaml", ros(RIGHT, baseline=0.005, rectification=turns[1]))
    pose = read_rig(left, right).rig.view("right").view_from_camera
    rectified = POINTS @ turns[0].T - [0.005, 0.0, 0.0]
    np.testing.assert_allclose(apply(pose, POINTS), rectified @ turns[1], atol=1e-12)


@pytest.mark.parametrize(
    "names",
    [
        ("K1", "D1", "K2", "D2", "R", "T"),
        ("CameraMatrix1", "DistCoeffs1", "CameraMatrix2", "DistCoeffs2", "R", "T"),
        ("cameraMatrixL", "distCoeffsL", "cameraMatrixR", "distCoeffsR", "R", "T"),
        ("camera_matrix_left", "distortion_coefficients_left", "camera_matrix_right", "dist_coeffs_right", "R", "T"),
        (
            "Left_Camera_Matrix",
            "Left_Distortion_Coefficients",
            "Right_Camera_Matrix",
            "Right_Distortion_Coefficients",
            "Extrinsic_Camera_Rotation",
            "Extrinsic_Camera_Translation",
        ),
    ],
)
@pytest.mark.parametrize("unit", [1.0, 1e3])
def test_opencv_pairs_are_read_in_metres_and_millimetres(tmp_path: Path, names: tuple[str, ...], unit: float) -> None:
    found = read_rig(write(tmp_path / "stereo.yaml", storage(names=names, unit=unit)))
    np.testing.assert_allclose(found.rig.view("right").view_from_camera, POSE, atol=1e-12)
    assert bool(found.notes) == (unit > 1)


@pytest.mark.parametrize("order", [("left", "right"), ("right", "left")])
def test_kalibr_chain_is_read_in_either_order_of_the_eyes(tmp_path: Path, order: tuple[str, str]) -> None:
    cameras = {"left": LEFT, "right": RIGHT}
    second_from_first = POSE if order[0] == "left" else inverse(POSE)
    document: dict[str, Any] = {}
    for number, side in enumerate(order):
        camera = cameras[side]
        document[f"cam{number}"] = {
            "camera_model": "pinhole",
            "intrinsics": [camera.fx, camera.fy, camera.cx, camera.cy],
            "distortion_model": "none",
            "distortion_coeffs": [],
            "resolution": [camera.width, camera.height],
            "rostopic": f"/endoscope/{side}/image_raw",
        }
    document["cam1"]["T_cn_cnm1"] = second_from_first.tolist()
    found = read_rig(write(tmp_path / "camchain.yaml", document))
    np.testing.assert_allclose(found.rig.view("right").view_from_camera, POSE, atol=1e-12)
    assert found.rig.view("right").camera == RIGHT


@pytest.mark.parametrize(
    "fields", [{"right_from_left": POSE.tolist()}, {"R": POSE[:3, :3].tolist(), "T": POSE[:3, 3].tolist()}]
)
def test_plain_pair_states_the_pose_in_the_file_of_the_right_eye(tmp_path: Path, fields: dict[str, Any]) -> None:
    plain = [{"intrinsic": camera.matrix.tolist(), "distortion": [0.0] * 5} for camera in (LEFT, RIGHT)]
    left = write(tmp_path / "left.yaml", plain[0])
    right = write(tmp_path / "right.yaml", plain[1] | fields)
    rig = read_rig(left, right, size=(800, 600)).rig
    np.testing.assert_allclose(rig.view("right").view_from_camera, POSE, atol=1e-12)


def test_baseline_in_millimetres_is_refused_where_metres_are_meant(tmp_path: Path) -> None:
    left, right = write(tmp_path / "l.yaml", ros(LEFT)), write(tmp_path / "r.yaml", ros(RIGHT, baseline=5.3))
    with pytest.raises(InputError, match=r"r.yaml: projection_matrix: baseline: .* got 5.3 m \(is it in millimetres"):
        read_rig(left, right, rectified=True)


def test_exchanged_files_are_refused(tmp_path: Path) -> None:
    left, right = write(tmp_path / "l.yaml", ros(LEFT)), write(tmp_path / "r.yaml", ros(RIGHT, baseline=0.005))
    with pytest.raises(InputError, match=r"r.yaml: projection_matrix: .*left and right are exchanged\?"):
        read_rig(right, left)
    other_way = write(tmp_path / "other.yaml", ros(RIGHT, baseline=-0.005))
    with pytest.raises(InputError, match=r"other.yaml: .* got \+5 mm: left and right are exchanged\?"):
        read_rig(left, other_way)


def test_right_eye_on_the_left_is_named(tmp_path: Path) -> None:
    away = transform(np.eye(3), [0.004, 0, 0])
    (note,) = read_rig(write(tmp_path / "stereo.yaml", storage(away, unit=1.0))).notes
    assert "4 mm to the left of the left one" in note


@pytest.mark.parametrize(
    ("document", "text"),
    [
        (storage(names=("K1", "D1", "K2", "D2", "note", "date")), "R, T: expected rotation and translation"),
        (storage(2 * POSE), "R and T: expected a rotation matrix"),
        (storage(unit=1e-6), "expected 0.0005 to 0.5 m between the cameras"),
        (ros(LEFT), "expected both eyes"),
    ],
)
def test_incomplete_pair_is_refused_with_its_field(tmp_path: Path, document: Any, text: str) -> None:
    with pytest.raises(InputError, match=f"stereo.yaml: .*{text}"):
        read_rig(write(tmp_path / "stereo.yaml", document))


@pytest.mark.shared
def test_published_stereo_files_are_read() -> None:
    camera = SHARED / "formats" / "camera"
    pair = read_rig(camera / "ros_camera_info_left.yaml", camera / "ros_camera_info_right.yaml").rig
    distance = 1e3 * np.linalg.norm(pair.view("right").view_from_camera[:3, 3])
    assert distance == pytest.approx(10.66907451307448 / 1849.140723741208 * 1e3)
    found = read_rig(camera / "opencv_stereo.xml", size=(768, 576))
    assert 1e3 * found.rig.view("right").view_from_camera[0, 3] == pytest.approx(5.6977)
    assert len(found.notes) == 2
