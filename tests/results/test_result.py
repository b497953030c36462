"""Reading of results: round trip, required fields, and the message for each unusable document."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.transforms import moved

from dvrk_cmaes import InputError, Result, read_result, read_results
from dvrk_cmaes.results.result import Alternative, ExpectedError, Quality

POSE = moved(np.eye(4), [0.01, -0.02, 0.1, 0.3, -0.2, 0.9])
JOINTS = {"wrist_pitch": -0.2, "wrist_yaw": 0.5, "jaw": 0.8}
LEAST: dict[str, Any] = {"camera_from_root": POSE.tolist(), "joints": JOINTS, "seconds": 0.7}


def full() -> Result:
    """Make a result with every field set."""
    return Result(
        frame="0007",
        time=1755000000.25,
        status="doubtful",
        reasons=("the twin explains the frame as well",),
        instrument="lnd",
        root_link="roll_link",
        shaft_radius=0.004075,
        camera_from_root=POSE,
        joints=JOINTS,
        readings={"wrist_pitch": -0.25, "insertion": 0.12},
        warnings=("intrinsics rescaled",),
        unused=("tips: none given",),
        camera_from_base=moved(POSE, [0.1, 0, 0, 0, 0, 1]),
        source="session",
        change={"translation_mm": 0.3, "rotation_deg": 1.0, "joints_deg": {"jaw": 0.2}},
        quality=Quality(0.97, 0.1, {"mse": 0.02, "dist": 0.01}, 0.6, 2.1, 1.4, 0.08, 1.9),
        tips=(np.array([0.01, -0.02, 0.11]), np.array([0.02, -0.02, 0.11])),
        tips_px=(np.array([400.5, 90.25]), np.array([490.0, 95.0])),
        expected_error=ExpectedError(
            tip_mm={"jaw_1": 0.6, "jaw_2": 0.7, "mean": 0.5},
            tip_axes_mm={name: np.array([0.1, 0.2, 0.4]) for name in ("jaw_1", "jaw_2", "mean")},
            tip_90_mm=1.02,
            shaft_deg=0.8,
        ),
        mode_probability=0.97,
        covariance=np.diag([1e-8, 2e-8, 3e-8, 1e-4, 2e-4, 3e-4, 1e-3, 2e-3, 4e-3]),
        alternatives=(Alternative(POSE, JOINTS, 0.12, 0.96, "mirror twin", 41.0),),
        seconds=0.7,
        evaluations=1300,
        rays=9000,
        seed=3,
        version="1.0.0",
        config={"seed": 3, "search": {"method": "cmaes"}},
    )


def write(path: Path, document: Any) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(document if isinstance(document, str) else json.dumps(document))
    return path


def message(path: Path) -> str:
    with pytest.raises(InputError) as caught:
        read_result(path)
    text = str(caught.value)
    assert text.startswith(f"{path}: ")
    assert "\n" not in text
    return text.removeprefix(f"{path}: ")


def test_written_result_is_read_back(tmp_path: Path) -> None:
    document = full().to_dict()
    again = read_result(write(tmp_path / "0007.json", document))
    assert again.to_dict() == document


def test_wrong_expected_error_is_named(tmp_path: Path) -> None:
    document = full().to_dict()
    document["std"]["tip_90_mm"] = "wide"
    assert (
        message(write(tmp_path / "a.json", document))
        == "expected_error.tip_90_mm: expected a finite number, got 'wide'"
    )


def test_failed_frame_has_no_pose(tmp_path: Path) -> None:
    document = {"status": "failed", "camera_from_root": None, "joints": {}, "seconds": 0}
    assert read_result(write(tmp_path / "a.json", document)).camera_from_root is None


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        ({"camera_from_root": None}, "camera_from_root: expected 4 rows of 4 finite numbers, got nothing"),
        (
            {"camera_from_root": [[1, 2], [3]]},
            "camera_from_root: expected 4 rows of 4 finite numbers, got [[1, 2], [3]]",
        ),
        ({"time": "noon"}, "time: expected a finite number, got 'noon'"),
        ({"seconds": "0.7"}, "seconds: expected a finite number, got '0.7'"),
        ({"joints": {"jaw": True}}, "joints.jaw: expected a finite number, got True"),
        ({"joints": None}, "joints: expected an object, got nothing"),
        ({"status": "okay"}, "status: expected one of ok, failed, doubtful, got 'okay'"),
        ({"schema": 2}, "schema: expected 1, the only one known to this version, got 2"),
        ({"reasons": "x"}, "reasons: expected a list of texts, got 'x'"),
        ({"rays": -1}, "rays: expected a whole number of at least 0, got -1"),
        ({"quality": {"iou": 0.9}}, "quality.loss: expected a finite number, got nothing"),
        ({"alternatives": [{}]}, "alternatives[0].camera_from_root: expected 4 rows of 4 finite numbers, got nothing"),
        ({"frame": 26}, "frame: expected a text, got 26"),
    ],
)
def test_wrong_field_is_named(change: dict[str, Any], expected: str, tmp_path: Path) -> None:
    assert message(write(tmp_path / "0026.json", {**LEAST, **change})) == expected


def test_pose_must_be_rigid(tmp_path: Path) -> None:
    mirrored = np.diag([1.0, 1, -1, 1]).tolist()
    assert message(write(tmp_path / "a.json", {**LEAST, "camera_from_root": mirrored})).startswith(
        "camera_from_root: expected a rotation and a translation over 0 0 0 1, got [["
    )


def test_covariance_axes_must_be_in_documented_order(tmp_path: Path) -> None:
    document = full().to_dict()
    document["covariance"]["axes"].reverse()
    assert message(write(tmp_path / "a.json", document)).startswith(
        "covariance.axes: expected tx, ty, tz, rx, ry, rz, wrist_pitch, wrist_yaw, jaw, got ['jaw', "
    )


def test_other_than_json_object_is_refused(tmp_path: Path) -> None:
    assert message(write(tmp_path / "a.json", "[1, 2]")) == "expected a frame's result (JSON), got [1, 2]"
    assert message(write(tmp_path / "b.json", '{"seconds": ')).startswith(
        "expected a frame's result (JSON), got no valid JSON (Expecting value"
    )
    assert message(write(tmp_path / "c.json", '{"seconds": NaN}')).endswith(
        "got no valid JSON (NaN is no number in JSON)"
    )
    assert message(write(tmp_path / "d.json", "[" * 100_000)).startswith("expected a frame's result (JSON), got no")
    huge = json.dumps(LEAST).replace('"seconds": 0.7', '"seconds": 1' + "0" * 400)
    assert message(write(tmp_path / "e.json", huge)).endswith("(a whole number of 401 digits is too large)")


def test_two_files_of_one_frame_are_refused(tmp_path: Path) -> None:
    for name in ("x", "y"):
        write(tmp_path / f"{name}.json", {**LEAST, "frame": "x"})
    with pytest.raises(InputError, match=r"y.json: frame: expected a name of its own, got 'x', as another file$"):
        read_results(tmp_path)


def test_folder_without_results_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"expected results, frames/FRAME.json or FRAME.json, got none$"):
        read_results(tmp_path)
    with pytest.raises(InputError, match=r"no such folder; expected results, with frames/FRAME.json$"):
        read_results(tmp_path / "nowhere")
