"""``dvrk-cmaes import --side both``: recordings of both eyes of a stereo endoscope become stereo sessions."""

from __future__ import annotations

import json
import tomllib
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers.commands import Ran, run_command
from helpers.files import read_image
from helpers.made_clips import write_clip
from helpers.made_recordings import BEGIN, KINDS, SECOND, Message, camera_info, good, image, pixels, write_bag
from helpers.transforms import exp_rotation, transform

from dvrk_cmaes import read_session

Import = Callable[..., Ran]
BASELINE = 0.0052


@pytest.fixture
def imported(tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> Import:
    """Import into ``session`` in an empty folder."""
    monkeypatch.chdir(tmp_path)
    return lambda source, *arguments: run_command(
        capsys, "import", source, "--out", "session", "--json", "--side", "both", *arguments
    )


def both(late_ms: float = 1.0, *, baseline: float = BASELINE, missing: int | None = None) -> list[Message]:
    """Give the messages of both eyes; those of the right are ``late_ms`` late, and one of its images may be missing."""
    projection = np.array([78.0, 0, 30.0, -78.0 * baseline, 0, 78.0, 23.0, 0, 0, 0, 1, 0])
    times = [BEGIN + k * SECOND // 10 + round(late_ms * 1e6) for k in range(5)]
    eye = [
        replace(image(time, pixels(4 - k)), topic="/right/image_raw") for k, time in enumerate(times) if k != missing
    ]
    return [*good(), camera_info(BEGIN - 5, "/right/camera_info", p=projection), *eye]


@pytest.mark.parametrize("kind", KINDS)
def test_images_of_both_eyes_are_paired(imported: Import, tmp_path: Path, kind: str) -> None:
    ran = imported(write_bag(tmp_path / "bag", kind, both()))
    assert ran.code == 0, ran.err
    session = read_session("session", rectified=True)
    assert session.rig.views[1].view_from_camera[0, 3] == pytest.approx(-BASELINE)
    for k, frame in enumerate(session.frames):
        right = frame.others["right"].image
        assert frame.image is not None
        assert right is not None
        assert np.array_equal(read_image(frame.image), pixels(k))
        assert np.array_equal(read_image(right), pixels(4 - k))
        assert "yaw" in frame.readings
    entries = tomllib.loads(Path("session/session.toml").read_text())
    assert entries["camera"] == {"left": "left.yaml", "right": "right.yaml"}
    assert ran.result["notes"][-1] == (
        "right eye: 5 of 5 frames, images at most 1.0 ms after or before those of the left"
    )


def test_frame_without_its_right_image_is_kept(imported: Import, tmp_path: Path) -> None:
    ran = imported(write_bag(tmp_path / "bag", "mcap", both(missing=2)))
    assert ran.code == 0, ran.err
    frames = read_session("session", rectified=True).frames
    assert [("right" in frame.others and frame.others["right"].image is not None) for frame in frames] == [
        *(True, True, False, True, True)
    ]


def test_right_camera_without_baseline_is_refused(imported: Import, tmp_path: Path) -> None:
    refusal = imported(write_bag(tmp_path / "bag", "mcap", both(baseline=0.0))).refusal
    assert "right.yaml" in refusal


def test_recording_of_one_eye_is_refused(imported: Import, tmp_path: Path) -> None:
    refusal = imported(write_bag(tmp_path / "bag", "mcap", good())).refusal
    assert "--image-topic-right: expected a topic of images of the right eye" in refusal


def test_both_cameras_of_a_clip_are_imported(imported: Import, tmp_path: Path) -> None:
    clip = write_clip(tmp_path / "clip")
    for side, offset in (("left", 0.0), ("right", -80.0 * BASELINE)):
        with (clip / "camera_calibration" / f"{side}.yaml").open("a", encoding="utf-8") as file:
            projection = [80.0, 0, 31.5, offset, 0, 80.0, 22.0, 0, 0, 0, 1, 0]
            file.write(f"projection_matrix: {{rows: 3, cols: 4, data: {projection}}}\n")
            file.write("rectification_matrix: {rows: 3, cols: 3, data: [1, 0, 0, 0, 1, 0, 0, 0, 1]}\n")
    ran = imported(clip, "--arm", "PSM1")
    assert ran.code == 0, ran.err
    frames = read_session("session").frames
    for k, frame in enumerate(frames):
        seen = frame.others["right"].image
        assert seen is not None
        assert np.array_equal(read_image(seen), pixels(100 + k))
    entries = tomllib.loads(Path("session/session.toml").read_text())
    assert [tool["arm"] for tool in entries["tool"]] == ["PSM1"]


def stereo_parameters(clip: Path, distance: float) -> np.ndarray:
    """Write the result of the clip's stereo calibration, eyes at a distance; returns the right eye's pose (4, 4)."""
    turn = exp_rotation(np.array([0.01, -0.02, 0.005]))
    moved = [[-distance], [0.0001], [0.0002]]
    matrix = [[80.0, 0, 31.5], [0, 80.0, 22.0], [0, 0, 1]]
    intrinsics = {f"cameraMatrix{eye}": matrix for eye in "LR"} | {f"distCoeffs{eye}": [[0.0] * 5] for eye in "LR"}
    path = clip / "camera_calibration" / "stereo_calib_params.json"
    path.write_text(json.dumps(intrinsics | {"R": turn.tolist(), "T": moved}), encoding="utf-8")
    return transform(turn, np.ravel(moved))


def test_pose_between_the_eyes_of_a_clip_is_that_of_its_stereo_calibration(imported: Import, tmp_path: Path) -> None:
    clip = write_clip(tmp_path / "clip")  # whose right.yaml states no baseline
    pose = stereo_parameters(clip, BASELINE)
    ran = imported(clip, "--arm", "PSM1")
    assert ran.code == 0, ran.err
    rig = read_session("session").rig
    assert rig is not None
    np.testing.assert_allclose(rig.views[1].view_from_camera, pose, atol=1e-9)
    assert rig.views[1].camera.fx == 81.0  # the intrinsics are those of right.yaml
    assert any("pose between the eyes" in note and "stereo_calib_params.json" in note for note in ran.result["notes"])


def test_baseline_that_right_yaml_states_counts_more(imported: Import, tmp_path: Path) -> None:
    clip = write_clip(tmp_path / "clip")
    stereo_parameters(clip, 2 * BASELINE)
    for side, offset in (("left", 0.0), ("right", -80.0 * BASELINE)):
        with (clip / "camera_calibration" / f"{side}.yaml").open("a", encoding="utf-8") as file:
            file.write(f"projection_matrix: {{data: {[80.0, 0, 31.5, offset, 0, 80.0, 22.0, 0, 0, 0, 1, 0]}}}\n")
            file.write("rectification_matrix: {data: [1, 0, 0, 0, 1, 0, 0, 0, 1]}\n")
    imported(clip, "--arm", "PSM1")
    rig = read_session("session").rig
    assert rig is not None
    np.testing.assert_allclose(rig.views[1].view_from_camera[:3, 3], [-BASELINE, 0, 0])


def test_wrong_stereo_calibration_of_a_clip_is_refused(imported: Import, tmp_path: Path) -> None:
    clip = write_clip(tmp_path / "clip")
    stereo_parameters(clip, 0.0004)
    refusal = imported(clip, "--arm", "PSM1").refusal
    assert "stereo_calib_params.json: R and T: expected 0.0005 to 0.5 m between the cameras, got " in refusal
