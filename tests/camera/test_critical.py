"""Remarks on unusual values of camera files."""

from __future__ import annotations

from pathlib import Path

import pytest

from dvrk_cmaes import read_camera
from dvrk_cmaes.camera.fields import known_mistakes, remarks_on

CAMERA = """image_width: 640
image_height: 480
camera_matrix: {{data: [{fx}, 0, {cx}, 0, {fy}, {cy}, 0, 0, 1]}}
distortion_model: plumb_bob
distortion_coefficients: {{data: [0, 0, 0, 0, 0]}}
projection_matrix: {{data: [{fx}, 0, {cx}, 0, 0, {fy}, {cy}, 0, 0, 0, 1, 0]}}
{more}"""


def written(path: Path, fx: float, fy: float, cx: float, cy: float, more: str = "") -> Path:
    path.write_text(CAMERA.format(fx=fx, fy=fy, cx=cx, cy=cy, more=more))
    return path


@pytest.mark.parametrize(
    "values",
    [
        (640, 480, 800.0, 800.0, 320.0, 240.0),
        (640, 480, 800.0, 815.0, 350.0, 260.0),
        (720, 576, 937.5, 1000.0, 360.0, 288.0),
        (720, 480, 1125.0, 1000.0, 360.0, 240.0),
        (1280, 1024, 1600.0, 1600.0, 700.0, 540.0),
    ],
)
def test_usual_camera_has_no_remark(values: tuple[int, int, float, float, float, float]) -> None:
    assert remarks_on(*values) == ()


@pytest.mark.parametrize(
    ("values", "expected"),
    [
        ((640, 480, 800.0, 400.0, 320.0, 240.0), "fx 800 and fy 400 are 100 % apart"),
        ((640, 480, 937.5, 1000.0, 320.0, 240.0), "fx 937.5 and fy 1000 are 6 % apart"),
        ((640, 480, 1026.0, 1026.0, 168.0, 234.0), "principal point 168, 234 is nearer to 240, 320 than to the "),
        ((640, 480, 800.0, 800.0, 420.0, 240.0), "principal point 420, 240: 16 % of the width right and 0 % of the "),
        ((640, 480, 200.0, 200.0, 320.0, 240.0), "focal lengths 200 and 200 px are 0.31 image widths"),
        ((640, 480, 2700.0, 2700.0, 320.0, 240.0), "focal lengths 2700 and 2700 px are 4.2 image widths"),
    ],
)
def test_unusual_value_is_remarked(values: tuple[int, int, float, float, float, float], expected: str) -> None:
    (text,) = remarks_on(*values)
    assert text.startswith(f"camera file: {expected}")


@pytest.mark.parametrize(
    ("values", "expected"),
    [
        ((640, 480, 800.0, 920.0, 320.0, 240.0), "fx 800 and fy 920 are 13 % apart"),
        ((640, 480, 800.0, 800.0, 250.0, 310.0), "principal point 250, 310 is nearer to 240, 320 than to the "),
        (
            (1280, 1024, 800.0, 800.0, 325.0, 250.0),
            "principal point 325, 250 is a quarter of 1280 x 1024 px: the file ",
        ),
    ],
)
def test_known_mistake_is_most_likely_wrong(values: tuple[int, int, float, float, float, float], expected: str) -> None:
    (text,) = known_mistakes(remarks_on(*values))
    assert text.startswith(f"camera file: most likely wrong: {expected}")


def test_uneven_scale_that_the_file_states_is_not_remarked(tmp_path: Path) -> None:
    uneven = written(tmp_path / "camera.yaml", 800, 400, 320, 240)
    assert len(read_camera(uneven).remarks) == 1
    assert read_camera(written(tmp_path / "binned.yaml", 800, 400, 320, 240, "binning_y: 2")).remarks == ()


def test_remarks_stay_with_the_camera_at_another_size(tmp_path: Path) -> None:
    camera = read_camera(written(tmp_path / "camera.yaml", 800, 800, 240, 320))
    assert camera.scaled(320, 240).remarks == camera.changed(1.1, (2.0, 3.0)).remarks == camera.remarks
    assert camera == read_camera(written(tmp_path / "same.yaml", 800, 800, 240, 320))
