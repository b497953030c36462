"""What a user does with a result in Python: a picture, a row of a table, the names of the covariance's axes."""

from __future__ import annotations

import sys
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest
from helpers.places import ROOT

from dvrk_cmaes import (
    DvrkCmaesError,
    InputError,
    Renderer,
    Result,
    Tracker,
    TrackResult,
    estimate,
    prepare,
    read_camera,
    read_result,
    read_results,
)

DEMO = ROOT / "data" / "demo"
READINGS = {"wrist_pitch": -0.223, "wrist_yaw": 0.557, "jaw": 0.835}
CAMERA = read_camera(DEMO / "camera.yaml")


@pytest.fixture(scope="module")
def mask() -> Any:
    picture = cv2.imread(str(DEMO / "masks" / "0001.png"), cv2.IMREAD_GRAYSCALE)
    return picture > 127


@pytest.fixture(scope="module")
def result(mask: Any) -> Result:
    return estimate(mask, CAMERA, READINGS, "lnd", frame="0001")


@pytest.fixture(scope="module")
def followed(mask: Any, result: Result) -> TrackResult:
    tracker = Tracker(CAMERA, "lnd")
    tracker.start(0.0, result)
    return tracker.step(0.03, mask)


def test_overlay_keeps_the_order_of_colours_and_shows_the_outline_alone(result: Result) -> None:
    image = cv2.imread(str(DEMO / "images" / "0001.jpg"))
    assert image is not None
    assert result.camera_from_root is not None
    drawn = result.overlay(image)
    changed = (drawn != image).any(axis=2)
    silhouette = Renderer(prepare("lnd"), CAMERA).masks(result.camera_from_root, result.joints)
    edge = cv2.morphologyEx(silhouette.astype(np.uint8), cv2.MORPH_GRADIENT, np.ones((3, 3)))
    near = cv2.dilate(edge, np.ones((11, 11))) > 0
    assert drawn.dtype == np.uint8
    assert drawn.shape == image.shape
    assert 500 < changed.sum() < 0.05 * changed.size
    assert not changed[~near].any()
    blue = (drawn == (233, 180, 86)).all(axis=2)
    assert blue.sum() > 300


@pytest.mark.parametrize("shape", [(10, 10), (480, 480, 3), (640, 480, 3)])
def test_an_image_of_another_aspect_is_refused(result: Result, followed: TrackResult, shape: tuple[int, ...]) -> None:
    for one in (result, followed):
        with pytest.raises(InputError, match=r"^image: expected 640 x 480, the camera's, or another size of that asp"):
            one.overlay(np.zeros(shape, np.uint8))
    assert result.overlay(np.zeros((121, 160), np.uint8)).shape == (121, 160, 3)  # rounded


def test_results_are_shown_in_one_line(result: Result, followed: TrackResult) -> None:
    assert repr(result).startswith(f"Result('0001', {result.status}, position_mm=[")
    assert repr(followed).startswith(f"TrackResult(time=0.03, {followed.status}, position_mm=[")
    assert "joints_deg={'wrist_pitch': " in repr(followed)
    assert f"reasons={[*followed.reasons]}" in repr(followed)
    assert "\n" not in repr(followed)


def test_a_result_from_a_file_needs_a_renderer_for_its_overlay(result: Result, tmp_path: Any) -> None:
    import json

    path = tmp_path / "0001.json"
    path.write_text(json.dumps(result.to_dict()))
    read, image = read_result(path), np.zeros((480, 640, 3), np.uint8)
    with pytest.raises(InputError, match="expected renderer=Renderer"):
        read.overlay(image)
    drawn = read.overlay(image, Renderer(prepare("lnd"), CAMERA))
    assert (drawn != result.overlay(image)).mean() < 0.001  # poses in files are rounded


def test_axes_name_the_rows_of_the_covariance(result: Result, followed: TrackResult) -> None:
    for one in (result, followed):
        assert one.axes == ("tx", "ty", "tz", "rx", "ry", "rz", "wrist_pitch", "wrist_yaw", "jaw")
        assert one.covariance is not None
        assert one.covariance.shape == (len(one.axes),) * 2
    assert result.to_dict()["covariance"]["axes"] == [*result.axes]


def test_rows_are_those_of_the_tables(result: Result, followed: TrackResult) -> None:
    row = result.to_row()
    assert row["frame"] == "0001"
    assert row["camera_from_root_z_mm"] == pytest.approx(1e3 * result.camera_from_root[2, 3])  # type: ignore[index]
    line = followed.to_row("0002")
    assert (line["frame"], line["time"], line["status"]) == ("0002", 0.03, followed.status)
    assert line["jaw_deg"] == pytest.approx(np.degrees(followed.joints["jaw"]), abs=1e-4)


def test_frames_are_those_of_pandas(result: Result, tmp_path: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    import json

    (tmp_path / "0001.json").write_text(json.dumps(result.to_dict()))
    folder = read_results(tmp_path)
    monkeypatch.setitem(sys.modules, "pandas", SimpleNamespace(DataFrame=lambda rows: ("frame of", rows)))
    assert folder.to_frame() == ("frame of", folder.to_rows())
    assert result.to_frame()[1][0]["frame"] == "0001"
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(InputError, match=r"^to_frame: needs the library pandas, .* -m pip install 'pandas"):
        result.to_frame()


def test_notebooks_show_results_as_tables(result: Result, tmp_path: Any) -> None:
    import json

    (tmp_path / "0001.json").write_text(json.dumps(result.to_dict()))
    folder = read_results(tmp_path)
    assert repr(folder) == f"ResultsFolder({str(tmp_path)!r}, 1 {result.status})"
    assert f"<tr><td>0001</td><td>{result.status}</td>" in folder._repr_html_()
    assert f"<tr><td>status</td><td>{result.status}</td></tr>" in result._repr_html_()


def test_a_pose_is_required_of_a_result(result: Result) -> None:
    assert result.require_pose() is result.camera_from_root
    failed = Result.failed("0009", "mask is empty", {}, instrument="lnd", root_link="roll_link")
    with pytest.raises(DvrkCmaesError, match=r"^frame 0009: no pose: mask is empty$"):
        failed.require_pose()


def test_single_pose_and_joints_by_name_render_one_image(result: Result, mask: Any) -> None:
    assert result.camera_from_root is not None
    renderer = Renderer(prepare("lnd"), CAMERA)
    one = renderer.masks(result.camera_from_root, result.joints)
    values = np.array([list(result.joints.values())])
    assert np.array_equal(one, renderer.masks(result.camera_from_root[None], values)[0])
    assert (one & mask).sum() / (one | mask).sum() > 0.95
    poses = np.stack([result.camera_from_root] * 2)
    two = renderer.masks(poses, result.joints | {"jaw": [0.2, result.joints["jaw"]]})
    assert two.shape == (2, 480, 640)
    assert np.array_equal(two[1], one)
    assert not np.array_equal(two[0], one)
    assert renderer.coverage(result.camera_from_root, values[0]).shape == (480, 640)


@pytest.mark.parametrize(
    ("joints", "expected"),
    [
        ({"jaw": 0.1}, "joints: expected values of wrist_pitch, wrist_yaw, jaw, got jaw"),
        ({"wrist_pitch": 0, "wrist_yaw": 0, "jaw": [0.1, 0.2]}, r"joints: jaw: expected a number, or \(1,\)"),
        ({"wrist_pitch": 0, "wrist_yaw": 0, "jaw": "open"}, "joints: jaw: expected a number"),
    ],
)
def test_wrong_joints_by_name_are_refused(joints: Any, expected: str) -> None:
    with pytest.raises(InputError, match=expected):
        Renderer(prepare("lnd"), CAMERA).masks(np.eye(4), joints)
