"""Reading of camera files (ROS camera_info), and the message for each unusable one."""

from __future__ import annotations

from pathlib import Path

import pytest

from dvrk_cmaes import InputError, read_camera

CALIBRATION = """\
image_width: 640
image_height: 480
camera_name: left
camera_matrix:
  rows: 3
  cols: 3
  data: [800.5, 0, 320.25, 0, 810, 240, 0, 0, 1]
distortion_model: plumb_bob
distortion_coefficients:
  rows: 1
  cols: 5
  data: [-0.25, 0.27, 1e-03, -3.0e-3, 0]
rectification_matrix: {rows: 3, cols: 3, data: [1, 0, 0, 0, 1, 0, 0, 0, 1]}
projection_matrix:
  rows: 3
  cols: 4
  data: [700, 0, 330, -5.5, 0, 701, 250, 0, 0, 0, 1, 0]
"""

ROS_1 = """\
header: {seq: 1, stamp: {secs: 5, nsecs: 0}, frame_id: ''}
height: 480
width: 640
distortion_model: "rational_polynomial"
D: [0.5, 0.2, 0.001, 0.001, 0.05, 0.7, 0.3, 0.05]
K: [800.0, 0.0, 320.0, 0.0, 810.0, 240.0, 0.0, 0.0, 1.0]
R: [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]
P: [700.0, 0.0, 330.0, 0.0, 0.0, 701.0, 250.0, 0.0, 0.0, 0.0, 1.0, 0.0]
binning_x: 0
binning_y: 0
roi: {x_offset: 0, y_offset: 0, height: 0, width: 0, do_rectify: False}
---
"""

ROS_2 = """\
height: 480
width: 640
distortion_model: fisheye
d:
- -0.02
- 0.003
- -0.001
- 0.0001
k:
- 800.0
- 0.0
- 320.0
- 0.0
- 810.0
- 240.0
- 0.0
- 0.0
- 1.0
p: [700, 0, 330, 0, 0, 701, 250, 0, 0, 0, 1, 0]
---
height: 480
"""


def written(folder: Path, text: str | bytes) -> Path:
    path = folder / "camera.yaml"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


def message(path: Path, *, rectified: bool = False) -> str:
    with pytest.raises(InputError) as caught:
        read_camera(path, rectified=rectified)
    text = str(caught.value)
    assert "\n" not in text
    assert text.startswith(f"{path}: ")
    return text.removeprefix(f"{path}: ")


def test_rectified_camera_uses_p_without_distortion(tmp_path: Path) -> None:
    for text in (CALIBRATION, ROS_1, ROS_2):
        camera = read_camera(written(tmp_path, text), rectified=True)
        assert (camera.fx, camera.fy, camera.cx, camera.cy) == (700, 701, 330, 250)
        assert camera.is_pinhole


def test_model_name_is_optional_without_distortion(tmp_path: Path) -> None:
    for coefficients in ("[]", "[0, 0, 0, 0, 0]"):
        text = ROS_1.replace("[0.5, 0.2, 0.001, 0.001, 0.05, 0.7, 0.3, 0.05]", coefficients)
        assert read_camera(written(tmp_path, text.replace("rational_polynomial", ""))).is_pinhole


K = "[800.5, 0, 320.25, 0, 810, 240, 0, 0, 1]"


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ("image_width: 640\n", "", "image_width: missing (expected image_width or width)"),
        (
            "image_height: 480",
            "image_height: tall",
            "image_height: expected a positive whole number of pixels, got 'tall'",
        ),
        ("image_width: 640", "image_width: 0", "image_width: expected a positive whole number of pixels, got 0"),
        ("image_width: 640", "image_width: true", "image_width: expected a positive whole number of pixels, got True"),
        ("image_width: 640", "image_width: .inf", "image_width: expected a positive whole number of pixels, got inf"),
        (
            "camera_matrix:",
            "other:",
            "other: unknown field of a camera file (nearest known: distortion_model), "
            "which may state the lens: rename it, or leave it out",
        ),
        (K, "[800.5, 0, 320.25, 0]", "camera_matrix: expected 9 numbers, got 4"),
        (K, "none", "camera_matrix.data: expected a list of numbers, got 'none'"),
        (f"data: {K}", "size: 9", "camera_matrix.data: expected a list of numbers, got nothing"),
        (K, K.replace("800.5", ".nan"), "camera_matrix.data: expected finite numbers, got nan"),
        (K, K.replace("800.5", "eight"), "camera_matrix.data: expected finite numbers, got 'eight'"),
        (K, K.replace("800.5", "[1]"), "camera_matrix.data: expected finite numbers, got [1]"),
        (
            K,
            K.replace("800.5", "1" + "0" * 400),
            "camera_matrix.data: expected finite numbers, got 1" + "0" * 56 + "...",
        ),
        (K, K.replace("800.5", "0"), "camera_matrix: expected positive focal lengths in pixels, got fx 0, fy 810"),
        (
            K,
            K.replace("810", "-810"),
            "camera_matrix: expected positive focal lengths in pixels, got fx 800.5, fy -810",
        ),
        (
            K,
            "[800.5, 0, 0, 0, 810, 0, 320, 240, 1]",
            "camera_matrix: expected rows fx 0 cx, 0 fy cy, 0 0 1 (no skew), "
            "got [800.5, 0.0, 0.0, 0.0, 810.0, 0.0, 320.0, 240.0, 1.0]",
        ),
        (
            "distortion_coefficients:",
            "other:",
            "other: unknown field of a camera file (nearest known: distortion_model), "
            "which may state the lens: rename it, or leave it out",
        ),
        (", -3.0e-3, 0]", "]", "distortion: expected 0 or 4 or 5 coefficients for plumb_bob, got 3"),
        ("-0.25", ".nan", "distortion_coefficients.data: expected finite numbers, got nan"),
        (
            "-0.25",
            "-5.25",
            "distortion: expected the plumb_bob map to be one-to-one over the image, got one that folds back on itself",
        ),
        (
            "plumb_bob",
            "plum",
            "distortion_model: expected one of plumb_bob, rational_polynomial, equidistant, none, got 'plum'",
        ),
    ],
)
def test_error_names_field_and_expected_value(tmp_path: Path, old: str, new: str, expected: str) -> None:
    assert old in CALIBRATION
    assert message(written(tmp_path, CALIBRATION.replace(old, new))) == expected


def test_rectified_camera_requires_projection_matrix(tmp_path: Path) -> None:
    text = CALIBRATION.replace("[700, 0, 330, -5.5, 0, 701, 250, 0, 0, 0, 1, 0]", str([0] * 12))
    assert message(written(tmp_path, text), rectified=True) == (
        "projection_matrix: expected positive focal lengths in pixels, got fx 0, fy 0"
    )
    text = CALIBRATION.split("projection_matrix")[0]
    assert message(written(tmp_path, text), rectified=True).startswith("--rectified: expected a projection matrix")


def test_region_of_interest_is_refused(tmp_path: Path) -> None:
    text = ROS_1.replace("x_offset: 0", "x_offset: 16")
    assert message(written(tmp_path, text)).startswith(
        "roi.x_offset: expected images of the whole sensor, got 16: for "
    )


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("", "expected a camera file (YAML or XML), got an empty file"),
        ("# nothing\n", "expected a camera file (YAML or XML), got no mapping of names to values"),
        ("- 1\n- 2\n", "expected a camera file (YAML or XML), got no mapping of names to values"),
        (b"\xff\xfe", "expected a camera file (YAML or XML) in UTF-8, got other bytes at 0"),
        (
            "width: [1, 2\nheight: 2]: 3\n",
            "expected a camera file (YAML or XML), got no valid YAML (line 2: did not find expected ',' or ']')",
        ),
        (
            "when: 2020-99-99\n",
            "expected a camera file (YAML or XML), got no valid YAML (month must be in 1..12)",
        ),
        ("a: &x [1]\nb: *x\n", "expected plain values, got a YAML alias ('x')"),
        ("a: " + "[" * 30 + "]" * 30, "expected a small file, got YAML of more than 20 levels"),
        ("a: [" + "1," * 30_000 + "]", "expected a small file, got YAML of more than 20000 items"),
        ("a: " + "7" * 5000, "expected a small file, got a YAML value of 5000 characters"),
        (
            "a: " + "x " * 600_000,
            "expected a camera file (YAML or XML) of at most 1 MB, got 1.2 MB",
        ),
    ],
)
def test_file_without_small_yaml_mapping_is_refused(tmp_path: Path, text: str | bytes, expected: str) -> None:
    assert message(written(tmp_path, text)) == expected


def test_missing_file_directory_and_link_loop_are_refused(tmp_path: Path) -> None:
    assert message(tmp_path / "none.yaml") == "no such file; expected a camera file (YAML or XML)"
    assert message(tmp_path) == "expected a camera file (YAML or XML), got a directory"
    loop = tmp_path / "loop.yaml"
    loop.symlink_to(loop)
    assert message(loop).startswith("not readable (")
    with pytest.raises(InputError, match="got something that is not a regular file"):
        read_camera("/dev/null")
