"""Camera files of OpenCV, kalibr and plain YAML: the format is recognised by content, and assumptions are noted."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from dvrk_cmaes import InputError, read_camera
from dvrk_cmaes.camera.files import Side, read_camera_file, read_intrinsics

LEFT = np.array([[800.5, 0, 320.25], [0, 810, 240], [0, 0, 1]])
RIGHT = np.array([[801.5, 0, 168.25], [0, 811, 241], [0, 0, 1]])
BENT = np.array([-0.25, 0.27, 0.001, -0.003, 0.0])
P2 = np.array([[700, 0, 330, -4000], [0, 701, 250, 0], [0, 0, 1, 0.0]])
CAMCHAIN = """\
cam0:
  camera_model: pinhole
  intrinsics: [800.5, 810, 320.25, 240]
  distortion_model: radtan
  distortion_coeffs: [-0.25, 0.27, 0.001, -0.003]
  resolution: [640, 480]
  rostopic: /endoscope/a/image_raw
cam1:
  T_cn_cnm1: [[1, 0, 0, -0.005], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]
  camera_model: pinhole
  intrinsics: [801.5, 811, 168.25, 241]
  distortion_model: equidistant
  distortion_coeffs: [-0.02, 0.003, -0.001, 0.0001]
  resolution: [640, 480]
  rostopic: /endoscope/b/image_raw
"""
PLAIN = "intrinsic: [[828, 0., 399.5], [0., 902, 244.1], [0., 0., 1.]]\ndistortion: [-0.35, 0.7, 0.0044, -8.0e-04, 0]\n"


def storage(path: Path, **fields: object) -> Path:
    """Write fields with OpenCV's FileStorage."""
    file = cv2.FileStorage(str(path), cv2.FileStorage_WRITE)
    for name, value in fields.items():
        file.write(name, value)
    file.release()
    return path


def written(folder: Path, text: str, name: str = "camera.yaml") -> Path:
    path = folder / name
    path.write_text(text, encoding="utf-8")
    return path


def message(path: Path, *, rectified: bool = False, side: Side = "left", size: tuple[int, int] | None = None) -> str:
    with pytest.raises(InputError) as caught:
        read_camera_file(path, rectified=rectified, side=side, size=size)
    text = str(caught.value)
    assert "\n" not in text
    assert text.startswith(f"{path}: ")
    return text.removeprefix(f"{path}: ")


def focal(path: Path, *, rectified: bool = False, side: Side = "left") -> tuple[float, ...]:
    found = read_intrinsics(path, rectified=rectified, side=side)
    return found.fx, found.fy, found.cx, found.cy


# OpenCV


@pytest.mark.parametrize(
    ("coefficients", "model", "count"),
    [
        ([], "plumb_bob", 0),
        ([-0.2, 0.1, 0, 0, 0.1], "plumb_bob", 5),
        ([0.5, 0.2, 0.001, 0.001, 0.05, 0.7, 0.3, 0.05], "rational_polynomial", 8),
        ([0.5, 0.2, 0.001, 0.001, 0.05, 0.7, 0.3, 0.05, 0, 0, 0, 0], "rational_polynomial", 8),
        ([0.5, 0.2, 0.001, 0.001, 0.05, 0.7, 0.3, 0.05, 0, 0, 0, 0, 0, 0], "rational_polynomial", 8),
    ],
)
def test_number_of_coefficients_determines_model(
    tmp_path: Path, coefficients: list[float], model: str, count: int
) -> None:
    found = read_intrinsics(written(tmp_path, PLAIN.split("distortion")[0] + f"distortion: {coefficients}\n"))
    assert (found.model, len(found.distortion), found.notes) == (model, count, ())


def test_four_coefficients_are_plumb_bob_unless_fisheye_is_stated(tmp_path: Path) -> None:
    fields = {"image_width": 640, "image_height": 480, "camera_matrix": LEFT}
    four = np.array([-0.02, 0.003, -0.001, 0.0001])
    usual = read_camera_file(storage(tmp_path / "usual.yml", **fields, distortion_coefficients=four))
    assert usual.camera.model == "plumb_bob"
    assert usual.notes == ("distortion_coefficients has four coefficients: taken as k1 k2 p1 p2, not as a fisheye's",)
    fisheye = storage(tmp_path / "fisheye.yml", **fields, distortion_coefficients=four, fisheye_model=1)
    assert (read_camera(fisheye).model, read_camera_file(fisheye).notes) == ("equidistant", ())


def test_rectified_stereo_requires_projection_matrices(tmp_path: Path) -> None:
    path = storage(tmp_path / "stereo.yml", K1=LEFT, D1=BENT, K2=RIGHT, D2=BENT, P2=P2)
    right = read_intrinsics(path, rectified=True, side="right")
    assert (right.fx, right.cx, right.distortion) == (700, 330, ())
    assert right.kind == "OpenCV, stereo, right camera, rectified images (P2)"
    assert message(path, rectified=True) == (
        "--rectified: expected a projection matrix (ROS camera_info, or OpenCV with P1 and P2), got none"
    )
    straight = storage(tmp_path / "straight.yml", K1=LEFT, D1=BENT * 0)
    assert focal(straight, rectified=True) == (800.5, 810, 320.25, 240)


@pytest.mark.parametrize(
    ("fields", "expected"),
    [
        ({"K1": LEFT}, "distortion_coefficients: missing (expected distortion_coefficients or D or d)"),
        ({"K2": LEFT, "D2": BENT}, "K1 (or M1, camera_matrix_left): missing"),
        ({"K1": LEFT.T, "D1": BENT}, "K1: expected rows fx 0 cx, 0 fy cy, 0 0 1 (no skew), got "),
        ({"K1": P2[:2], "D1": BENT}, "K1: expected 9 numbers, got 8"),
        ({"K1": LEFT, "D1": BENT[:3]}, "D1: expected 0, 4, 5, 8, 12 or 14 coefficients, got 3"),
        (
            {"K1": LEFT, "D1": np.full(12, 0.01)},
            "D1: expected no thin prism or tilt (coefficients 9 on), got [0.01, 0.01, 0.01, 0.01]",
        ),
        ({"K1": LEFT * np.nan, "D1": BENT}, "K1.data: expected finite numbers, got"),
        ({"K1": LEFT, "D1": BENT, "image_size": np.array([640.5, 480])}, "image_size: expected a positive whole "),
    ],
)
@pytest.mark.parametrize("kind", ["yml", "xml"])
def test_unusable_opencv_field_is_named(tmp_path: Path, fields: dict[str, object], expected: str, kind: str) -> None:
    found = message(storage(tmp_path / f"camera.{kind}", **fields))
    assert found.replace("'", "").lower().startswith(expected.lower())


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("<robot/>", "expected OpenCV's XML, whose root element is <opencv_storage>, got <robot>"),
        ("<opencv_storage>", "not well-formed XML: no element found: line 1, column 16"),
        (
            '<!DOCTYPE a [<!ENTITY b "cc">]><a>&b;</a>',
            "a document type (<!DOCTYPE ...>) is refused; expected plain XML",
        ),
        ("<opencv_storage/>", "expected a camera file: camera_matrix "),
        ("<opencv_storage><K1 type_id='opencv-matrix'/></opencv_storage>", "K1: expected 9 numbers, got 0"),
        ("<opencv_storage><K1>1</K1></opencv_storage>", "expected a camera file: camera_matrix "),
        (
            "<opencv_storage>" + "<a>" * 50_000 + "</a>" * 50_000 + "</opencv_storage>",
            "expected XML of a robot, mesh or camera, ",
        ),
        (
            "%YAML:1.0\n---\nK1: !!opencv-sparse-matrix\n   a: 3\n",
            "expected a camera file (YAML or XML), got no valid ",
        ),
        (
            "%YAML:1.0\n---\nK1: !!opencv-matrix [1]\n",
            "expected a camera file (YAML or XML), got no valid YAML (line 3",
        ),
        ("%YAML:1.0\n---\nK1: &a !!opencv-matrix\n   data: *a\n", "expected plain values, got a YAML alias ('a')"),
        ("%YAML:1.0\n", "expected a camera file (YAML or XML), got no mapping of names to values"),
    ],
)
def test_hostile_or_broken_file_is_refused(tmp_path: Path, text: str, expected: str) -> None:
    assert message(written(tmp_path, text)).startswith(expected)


# kalibr


def test_kalibr_models_map_to_opencv_models(tmp_path: Path) -> None:
    path = written(tmp_path, CAMCHAIN)
    left, right = read_camera_file(path), read_camera_file(path, side="right")
    assert (left.camera.model, left.camera.distortion) == ("plumb_bob", (-0.25, 0.27, 0.001, -0.003))
    assert (right.camera.model, right.camera.distortion) == ("equidistant", (-0.02, 0.003, -0.001, 0.0001))
    assert (right.camera.width, right.camera.height, right.camera.fx, right.camera.cx) == (640, 480, 801.5, 168.25)
    assert left.kind == "kalibr camchain, cam0 of 2, raw images (fx, fy, cx, cy and distortion)"
    none = CAMCHAIN.replace("radtan", "none").replace("[-0.25, 0.27, 0.001, -0.003]", "[]")
    assert read_camera(written(tmp_path, none), rectified=True).is_pinhole


def test_kalibr_topics_determine_side_and_default_is_noted(tmp_path: Path) -> None:
    note = "the topics do not say which camera is the left one: cam0 is, so {} is taken"
    path = written(tmp_path, CAMCHAIN)
    assert read_camera_file(path).notes == (note.format("cam0"),)
    assert read_camera_file(path, side="right").notes == (note.format("cam1"),)
    path = written(tmp_path, CAMCHAIN.replace("/a/", "/right/").replace("/b/", "/left/"))
    assert read_camera_file(path).notes == ()
    assert focal(path)[0] == 801.5


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        (
            "pinhole",
            "omni",
            "cam0: camera_model: expected one of ",
        ),
        (
            "radtan",
            "fov",
            "cam0: distortion_model: expected one of ",
        ),
        ("[800.5, 810, 320.25, 240]", "[0.8, 800.5, 810, 320.25, 240]", "cam0: intrinsics: expected 4 numbers, got 5"),
        ("[800.5,", "[-800.5,", "cam0: fx, fy: expected positive focal lengths in pixels, got fx -800.5, fy 810"),
        (", -0.003]", "]", "distortion: expected 0 or 4 or 5 coefficients for plumb_bob, got 3"),
        ("cam1:", "cam7:", "--side left: expected cam0 and cam1, or topics that say left and right, got {'cam0': "),
    ],
)
def test_unusable_kalibr_field_is_named(tmp_path: Path, old: str, new: str, expected: str) -> None:
    assert message(written(tmp_path, CAMCHAIN.replace(old, new, 1))).startswith(expected)


# the side of a file of one camera


def test_single_camera_is_right_unless_stated_left(tmp_path: Path) -> None:
    note = ("the file holds one camera: it is taken for the right one",)
    assert read_intrinsics(written(tmp_path, PLAIN), side="right").notes == note
    single = CAMCHAIN.split("cam1")[0]
    assert read_intrinsics(written(tmp_path, single), side="right").notes == note
    path = written(tmp_path, single.replace("/a/", "/left/"))
    assert message(path, side="right") == "--side right: expected the right camera, got '/endoscope/left/image_raw'"


def test_real_left_camera_is_refused_as_right(shared: Path) -> None:
    folder = shared / "formats" / "camera"
    assert read_camera(folder / "ros_camera_info_right.yaml", side="right").cx == pytest.approx(728.018, abs=1e-3)
    assert message(folder / "ros_camera_info_left.yaml", side="right") == (
        "--side right: expected the right camera, got 'left'"
    )


ROWS = [[1042.6, 0, 326.3], [0, 1042.6, 235.1], [0, 0, 1]]
FLAT = {"fx": 1042.6, "fy": 1042.6, "cx": 326.3, "cy": 235.1, "width": 640, "height": 480}
COEFFICIENTS = [-0.32, 0.11, 0.001, -0.002, 0.0]
BY_NAME = {"k1": -0.32, "k2": 0.11, "p1": 0.001, "p2": -0.002}
MATRIX = {"camera_matrix": ROWS, "image_size": [640, 480]}


@pytest.mark.parametrize(
    "document",
    [
        *(
            {**MATRIX, name: COEFFICIENTS}
            for name in ["dist_coeff", "distCoeff", "distortion_coeffs", "dist_coefs", "D", "dist"]
        ),
        *(
            {**MATRIX, name: [COEFFICIENTS]}
            for name in ["distortionCoefficients", "distortion_params", "lens_distortion"]
        ),
        {**FLAT, "distortion": COEFFICIENTS},
        {**FLAT, "distortion": BY_NAME},
        {**FLAT, **BY_NAME, "model": "Brown Conrady"},
        {**FLAT, "coeffs": COEFFICIENTS, "model": "distortion.brown_conrady"},
        {"intrinsics": FLAT, "distortion": BY_NAME, "date": "2024-05-01", "rms": 0.31, "n_images": 20},
        {"camera_matrix": ROWS, "dist_coeffs": COEFFICIENTS, "width": 640, "height": 480},
        {"K": ROWS, "dist": COEFFICIENTS, "width": 640, "height": 480, "distortion_model": "radtan"},
        {**MATRIX, "dist": COEFFICIENTS, "rvecs": [[0.1, 0.2, 0.3]], "new_camera_matrix": ROWS, "ret": 0.4},
        {**MATRIX, "dist": COEFFICIENTS, "std_intrinsics": [1.2] * 5, "skew": 0, "comment": "distorted at the edge"},
        {"left": {**MATRIX, "dist": COEFFICIENTS}, "right": {**MATRIX, "dist": COEFFICIENTS}, "R": np.eye(3).tolist()},
    ],
)
def test_lens_is_read_under_each_of_its_names(tmp_path: Path, document: dict[str, Any]) -> None:
    camera = read_camera(written(tmp_path, json.dumps(document)))
    assert (camera.width, camera.height, camera.fx, camera.cx) == (640, 480, 1042.6, 326.3)
    assert [*camera.distortion, 0.0][:5] == COEFFICIENTS


@pytest.mark.parametrize(
    ("document", "expected"),
    [
        ({**FLAT, "lens_k": [0.1]}, "lens_k: unknown field of a camera file"),
        ({**MATRIX, "distorsion": COEFFICIENTS}, "distorsion: unknown field of a camera file (nearest known: distor"),
        ({**MATRIX, "radial": [-0.3, 0.1], "dist": []}, "radial: unknown field"),
        ({**FLAT, "distortion": {"k1": -0.3, "q": 0.1}}, "distortion.q: unknown field"),
        ({**FLAT, "skew": 2.0}, "skew: unknown field"),
        ({"camera": FLAT, "lens": COEFFICIENTS}, "lens: unknown field"),
        ({**MATRIX, "dist": COEFFICIENTS, "dist_coeffs": [0.0] * 5}, "dist_coeffs: expected one lens, got dist that"),
        ({**FLAT, **BY_NAME, "distortion": COEFFICIENTS}, "distortion: expected the distortion once, got k1, k2, p1"),
        ({**FLAT, **BY_NAME, "camera_model": "fov"}, "camera_model: expected one of "),
        ({**FLAT, **BY_NAME, "model": "distortion.inverse_brown_conrady"}, "model: expected one of "),
        ({**FLAT, **BY_NAME, "fisheye": True}, "p1: expected only k1, k2, k3, k4 for the model equidistant"),
        (
            {"w": 640, "h": 480, "fl_x": 1042.6, "fl_y": 1042.6, "cx": 326.3, "cy": 235.1, "k1": 0},
            "expected a camera file",
        ),
        ({"focal_length": 1042.6, "cx": 326.3, "cy": 235.1, "k1": 0.01}, "expected a camera file"),
        (
            {"K1": ROWS, "D1": COEFFICIENTS, "dist_coeff": COEFFICIENTS},
            "dist_coeff: expected a name that says which eye",
        ),
    ],
)
def test_field_that_may_state_the_lens_is_refused(tmp_path: Path, document: dict[str, Any], expected: str) -> None:
    assert expected in message(written(tmp_path, json.dumps(document)))


@pytest.mark.parametrize(
    ("text", "tool"), [("1 OPENCV 640 480 800 800 320 240 0 0 0 0\n", "COLMAP"), ("MATLAB 5.0 MAT-file", "MATLAB")]
)
def test_formats_that_are_no_longer_read_name_what_to_write(tmp_path: Path, text: str, tool: str) -> None:
    assert f"{tool}'s" in message(written(tmp_path, text))
