"""Session folders: files are assigned to frames by name, and every wrong file is named."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from dvrk_cmaes.camera import Camera
from dvrk_cmaes.errors import InputError
from dvrk_cmaes.frames.frame import FrameFiles, read_frame
from dvrk_cmaes.frames.keypoints import read_keypoints
from dvrk_cmaes.frames.session_folder import read_session
from dvrk_cmaes.frames.truth import SessionTruth, read_golden, write_golden
from dvrk_cmaes.io.bundled import bundled_path

DEMO = bundled_path("demo")
POSE = np.eye(4).tolist()


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Copy the demo session, to be damaged."""
    return Path(shutil.copytree(DEMO, tmp_path / "session"))


def message(folder: Path) -> str:
    with pytest.raises(InputError) as caught:
        read_session(folder)
    text = str(caught.value)
    assert "\n" not in text
    return text


def test_frames_have_their_files() -> None:
    session = read_session(DEMO)
    assert (session.camera.width, session.camera.height) == (640, 480)
    assert [frame.name for frame in session.frames] == ["0000", "0001", "0002", "0003", "0004"]
    first = session.frames[0]
    assert first.mask == DEMO / "masks" / "0000.png"
    assert first.image == DEMO / "images" / "0000.jpg"
    assert (first.ignore, first.keypoints) == (None, None)
    assert first.readings["wrist_pitch"] == 0.826268
    assert set(session.truth.frames) == {frame.name for frame in session.frames}
    assert session.truth.frames["0000"].camera_from_root.shape == (4, 4)
    assert session.truth.camera_from_base is not None


def test_times_of_images_are_those_of_frames(folder: Path) -> None:
    (folder / "images.csv").write_text("frame,time\n0000,1.5\n0002,1755000000250\n")
    times = [frame.time for frame in read_session(folder).frames]
    assert times == [1.5, None, 1755000000.25, None, None]


def test_times_of_readings_are_those_of_frames(folder: Path) -> None:
    header, *rows = (folder / "joints.csv").read_text().splitlines()
    timed = [f"{row},{k / 4}" for k, row in enumerate(rows)]
    (folder / "joints.csv").write_text("\n".join([f"{header},time", *timed]))
    assert [frame.time for frame in read_session(folder).frames] == [0, 0.25, 0.5, 0.75, 1]


@pytest.mark.parametrize("tips", [1, 2])
def test_golden_tips_are_one_or_two(folder: Path, tips: int) -> None:
    truth = read_golden(folder / "golden.json")
    frame = truth.frames["0000"]
    assert frame.tips is not None
    write_golden(folder / "golden.json", SessionTruth({"0000": replace(frame, tips=frame.tips[:tips])}))
    again = read_golden(folder / "golden.json").frames["0000"].tips
    np.testing.assert_allclose(again, frame.tips[:tips], atol=1e-9)


def test_optional_files(folder: Path) -> None:
    shutil.rmtree(folder / "images")
    (folder / "golden.json").unlink()
    (folder / "ignore").mkdir()
    shutil.copy(folder / "masks" / "0001.png", folder / "ignore" / "0001.png")
    (folder / "keypoints.csv").write_text("frame,tip_1_u,tip_1_v,tip_2_u,tip_2_v\n0001,1,2,3,4.5\n0002,,,,\n")
    session = read_session(folder)
    frames = {frame.name: frame for frame in session.frames}
    assert all(frame.image is None for frame in session.frames)
    assert frames["0001"].ignore == folder / "ignore" / "0001.png"
    np.testing.assert_array_equal(frames["0001"].keypoints, [[1, 2], [3, 4.5]])
    assert frames["0002"].keypoints is None
    assert session.truth.frames == {}
    assert session.truth.camera_from_base is None


def test_frame_without_row_has_no_readings(folder: Path) -> None:
    rows = (folder / "joints.csv").read_text().splitlines()
    (folder / "joints.csv").write_text("\n".join(rows[:-1]))
    assert read_session(folder).frames[-1].readings == {}


def test_other_files_among_masks_are_ignored(folder: Path) -> None:
    for name in ("notes.txt", ".0007.png", "Thumbs.db"):
        (folder / "masks" / name).write_text("x")
    assert len(read_session(folder).frames) == 5


@pytest.mark.parametrize("name", ["made/clean", "made/hard", "real/easy"])
def test_real_and_synthetic_sessions_are_read(shared: Path, name: str) -> None:
    session = read_session(shared / "frames" / name)
    assert len(session.frames) >= 10
    assert all(frame.readings for frame in session.frames)
    made = name.startswith("made")
    assert all((frame.image is None) == made for frame in session.frames)
    assert set(session.truth.frames) == ({frame.name for frame in session.frames} if made else set())


def test_other_folder_is_refused(tmp_path: Path) -> None:
    assert message(tmp_path / "nowhere").startswith(f"{tmp_path / 'nowhere'}: no such folder; expected a session")
    assert message(tmp_path).startswith(f"{tmp_path / 'masks'}: expected masks")


@pytest.mark.parametrize(
    ("damaged", "text", "expected"),
    [
        ("joints.csv", "frame,wrist_pich\n", "unknown joint 'wrist_pich'"),
        ("camera.yaml", "image_width: 3\n", "expected a camera file: camera_matrix"),
        ("keypoints.csv", "frame,u,v\n", "header: expected frame,tip_1_u"),
        ("keypoints.csv", "frame,tip_1_u,tip_1_v,tip_2_u,tip_2_v\n0000,1,2,3\n", "line 2: expected 5 cells as in"),
        ("keypoints.csv", "frame,tip_1_u,tip_1_v,tip_2_u,tip_2_v\n0000,1,2,3,x\n", "line 2: keypoints: expected four"),
        ("keypoints.csv", "frame,tip_1_u,tip_1_v,tip_2_u,tip_2_v\na,1,2,3,4\na,1,2,3,4\n", "each frame once"),
        ("golden.json", "{", "no valid JSON"),
        ("golden.json", "[]", "expected the truth of a session (golden.json), got []"),
        ("golden.json", '{"frames": {"a": {"joints": {}}}}', "frame a: T_camera_roll_link: expected 4 rows"),
        ("golden.json", json.dumps({"frames": {"a": {"T_camera_roll_link": POSE}}}), "frame a: joints: expected an"),
        (
            "golden.json",
            json.dumps({"frames": {"a": {"T_camera_roll_link": POSE, "joints": {"jaw": "x"}}}}),
            "frame a: joints.jaw: expected a finite number",
        ),
        ("golden.json", json.dumps({"frames": {}, "camera_from_base": np.diag([1, 1, 2, 1]).tolist()}), "a rotation"),
    ],
)
def test_damaged_file_is_named(folder: Path, damaged: str, text: str, expected: str) -> None:
    (folder / damaged).write_text(text)
    said = message(folder)
    assert said.startswith(f"{folder / damaged}: ")
    assert expected in said


def test_two_masks_of_one_frame_are_refused(folder: Path) -> None:
    shutil.copy(folder / "masks" / "0000.png", folder / "masks" / "0000.jpg")
    assert "expected one file for frame 0000" in message(folder)


def test_keypoints_are_read_by_frame(tmp_path: Path) -> None:
    path = tmp_path / "keypoints.csv"
    path.write_text("frame,tip_1_u,tip_1_v,tip_2_u,tip_2_v\n7, 1,2 ,3,4\n")
    found = read_keypoints(path)
    np.testing.assert_array_equal(found["7"], [[1, 2], [3, 4]])


def test_golden_pose_is_read_exactly() -> None:
    truth = read_golden(DEMO / "golden.json")
    document = json.loads((DEMO / "golden.json").read_text())
    np.testing.assert_array_equal(
        truth.frames["0003"].camera_from_root, document["frames"]["0003"]["T_camera_roll_link"]
    )
    assert truth.frames["0003"].joints["jaw"] == document["frames"]["0003"]["joints"]["jaw"]


def test_golden_file_round_trip(tmp_path: Path) -> None:
    write_golden(tmp_path / "golden.json", read_golden(DEMO / "golden.json"))
    again, first = (json.loads((folder / "golden.json").read_text()) for folder in (tmp_path, DEMO))
    assert again["frames"]["0003"] == first["frames"]["0003"]
    assert again["camera_from_base"] == first["camera_from_base"]


def test_parts_of_frame_must_have_matching_sizes(tmp_path: Path) -> None:
    mask = np.zeros((240, 320), np.uint8)
    mask[50:100] = 255
    for name, pixels in (("mask", mask), ("whole", np.zeros((480, 640, 3), np.uint8)), ("other", mask[:, :200])):
        cv2.imwrite(str(tmp_path / f"{name}.png"), pixels)
    camera = Camera(640, 480, 1000.0, 1000.0, 320.0, 240.0)
    files = FrameFiles("a", tmp_path / "mask.png", image=tmp_path / "whole.png", ignore=tmp_path / "mask.png")
    data = read_frame(files, camera)
    assert (data.camera.width, data.camera.fx) == (320, 500.0)
    assert len(data.notes) == 1
    assert data.image is not None
    assert data.image.shape == (480, 640, 3)
    for wrong in ({"image": tmp_path / "other.png"}, {"ignore": tmp_path / "other.png"}):
        with pytest.raises(InputError, match=r"other\.png: expected the mask's size 320 x 240.*got 200 x 240"):
            read_frame(FrameFiles("a", tmp_path / "mask.png", **wrong), camera)
