"""Exported files, read back in the way of each format's readers: the same transform, in the documented direction."""

from __future__ import annotations

import csv
import io
import json
import shlex
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from helpers.canned_results import BASE, canned, failed
from scipy.spatial.transform import Rotation

from dvrk_cmaes import estimate
from dvrk_cmaes.errors import InputError
from dvrk_cmaes.export.base_choice import base_of_session
from dvrk_cmaes.export.bop import bop_files
from dvrk_cmaes.export.dvrk_registration import registration_files
from dvrk_cmaes.export.easy_handeye import calibration_file
from dvrk_cmaes.export.frames import FrameNames
from dvrk_cmaes.export.tf import publisher_command
from dvrk_cmaes.export.tracker import joint_vector, pose_vector, tracker_files
from dvrk_cmaes.frames.frame import read_frame
from dvrk_cmaes.frames.session_folder import read_session
from dvrk_cmaes.geometry import moved
from dvrk_cmaes.results.result import Result
from dvrk_cmaes.silhouette import Body

NAMES = FrameNames("PSM2", "endoscope_left_optical", "PSM2_base")


def pose(translation: list[float], quaternion_xyzw: list[float]) -> np.ndarray:
    out = np.eye(4)
    out[:3, :3] = Rotation.from_quat(quaternion_xyzw).as_matrix()
    out[:3, 3] = translation
    return out


def read_bop(text: str) -> list[dict[str, Any]]:
    """Read rows as the BOP toolkit does: seven fields, with blanks between the numbers of a field."""
    header, *lines = text.splitlines()
    assert header == "scene_id,im_id,obj_id,score,R,t,time"
    poses = []
    for line in lines:
        scene, image, thing, score, rotation, translation, time = line.split(",")
        poses.append(
            {
                "ids": (int(scene), int(image), int(thing)),
                "score": float(score),
                "R": np.array([float(number) for number in rotation.split()]).reshape(3, 3),
                "t": np.array([float(number) for number in translation.split()]),
                "time": float(time),
            }
        )
    return poses


def test_easy_handeye_holds_base_from_camera() -> None:
    (name, text), (ros1_name, ros1_text) = calibration_file(BASE, NAMES).items()
    document, ros1 = yaml.safe_load(text), yaml.safe_load(ros1_text)
    assert name == "PSM2_camera.calib"
    assert document["parameters"] == {
        "name": "PSM2_camera",
        "calibration_type": "eye_on_base",
        "robot_base_frame": "PSM2_base",
        "robot_effector_frame": "PSM2_tool",
        "tracking_base_frame": "endoscope_left_optical",
        "tracking_marker_frame": "PSM2_instrument",
    }
    translation, rotation = document["transform"]["translation"], document["transform"]["rotation"]
    base_from_camera = pose([translation[a] for a in "xyz"], [rotation[a] for a in "xyzw"])
    np.testing.assert_allclose(base_from_camera @ BASE, np.eye(4), atol=1e-12)
    assert ros1_name == "PSM2_camera_eye_on_base.yaml"
    assert ros1["parameters"] == {
        "namespace": "/PSM2_camera_eye_on_base/",
        "eye_on_hand": False,
        "robot_base_frame": "PSM2_base",
        "robot_effector_frame": "PSM2_tool",
        "tracking_base_frame": "endoscope_left_optical",
        "tracking_marker_frame": "PSM2_instrument",
    }
    place = ros1["transformation"]
    base_from_camera = pose([place[a] for a in "xyz"], [place[f"q{a}"] for a in "xyzw"])
    np.testing.assert_allclose(base_from_camera @ BASE, np.eye(4), atol=1e-12)


def test_tf_command_states_frames_and_transform() -> None:
    line = publisher_command(BASE, NAMES)
    words = shlex.split(line)
    assert words[:4] == ["ros2", "run", "tf2_ros", "static_transform_publisher"]
    options = dict(zip(words[4::2], words[5::2], strict=True))
    assert options.pop("--frame-id") == "endoscope_left_optical"
    assert options.pop("--child-frame-id") == "PSM2_base"
    values = [float(options[f"--{name}"]) for name in ("x", "y", "z", "qx", "qy", "qz", "qw")]
    assert len(options) == 7
    np.testing.assert_allclose(pose(values[:3], values[3:]), BASE, atol=1e-10)


@pytest.mark.parametrize("write", [publisher_command, calibration_file])
def test_leading_slash_in_frame_name_is_refused(write: Any) -> None:
    with pytest.raises(InputError) as caught:
        write(BASE, FrameNames("PSM1", "/decklink_frame", "PSM1_base"))
    assert str(caught.value) == (
        "--camera-frame: expected a name as tf2 knows them, without a leading slash, got '/decklink_frame'"
    )


def test_names_with_blanks_or_paths_are_refused() -> None:
    with pytest.raises(InputError, match="--base-frame: expected a name without blanks, got 'a b'"):
        FrameNames(base="a b")
    with pytest.raises(InputError, match="--camera-frame: expected a name without blanks, got ''"):
        FrameNames(camera="")
    with pytest.raises(InputError, match=r"--arm: expected a name that can begin a file's, e.g. PSM1, got '../PSM1'"):
        FrameNames(arm="../PSM1")


def test_bop_holds_root_pose_in_mm() -> None:
    result = canned("0026")
    files = bop_files([result, failed("0027")], scene=3, obj=2)
    assert list(files) == ["dvrk-cmaes_dvrk-test.csv"]
    (line,) = read_bop(files["dvrk-cmaes_dvrk-test.csv"])
    assert line["ids"] == (3, 26, 2)
    assert (line["score"], line["time"]) == (0.96, 0.75)
    assert result.camera_from_root is not None
    np.testing.assert_allclose(line["R"], result.camera_from_root[:3, :3], atol=1e-12)
    np.testing.assert_allclose(line["t"], 1e3 * result.camera_from_root[:3, 3], atol=1e-9)


@pytest.mark.parametrize("names", [("a", "12", "c,d"), ("1", "01", "2"), ("٣", "4", "5")])
def test_frames_without_number_are_numbered_in_map(names: tuple[str, ...]) -> None:
    first, second, third = names
    files = bop_files([canned(first), failed(second), canned(third)])
    rows = list(csv.DictReader(io.StringIO(files["im_ids.csv"])))
    assert [(row["im_id"], row["frame"]) for row in rows] == [("0", first), ("1", second), ("2", third)]
    assert [line["ids"][1] for line in read_bop(files["dvrk-cmaes_dvrk-test.csv"])] == [0, 2]


def test_tracker_files_hold_rotation_vector_and_joints() -> None:
    result = canned("0026")
    files = tracker_files([result, failed("0027")])
    assert list(files) == ["0026/optimized_ctr.npy", "0026/optimized_joint_angles.npy"]
    start, joints = (np.load(io.BytesIO(data), allow_pickle=False) for data in files.values())
    assert (start.shape, start.dtype, joints.shape, joints.dtype) == ((6,), np.float32, (4,), np.float32)
    read = np.eye(4)
    read[:3, :3], read[:3, 3] = Rotation.from_rotvec(start[:3]).as_matrix(), start[3:]
    np.testing.assert_allclose(read, result.camera_from_root, atol=1e-6)
    np.testing.assert_allclose(joints, [0.3, -0.2, 0.35, 0.35], atol=1e-6)


def test_tracker_refuses_instrument_without_jaws() -> None:
    with pytest.raises(InputError, match="0026: joints: expected wrist_pitch, wrist_yaw and jaw, got no jaw"):
        tracker_files([canned("0026", joints={"wrist_pitch": 0.1, "wrist_yaw": 0.2})])


def test_published_poses_give_published_tracker_files(shared: Path) -> None:
    with open(shared / "frames" / "real" / "easy" / "published.csv", newline="") as file:
        row = next(row for row in csv.DictReader(file) if row["frame"] == "0026")
    number = {name: float(value) for name, value in row.items() if name != "frame"}
    camera_from_root = np.eye(4)
    camera_from_root[:3, :3] = Rotation.from_rotvec([number[a] for a in ("rx", "ry", "rz")]).as_matrix()
    camera_from_root[:3, 3] = [number[a] for a in ("tx", "ty", "tz")]
    joints = {name: number[name] for name in ("wrist_pitch", "wrist_yaw")} | {"jaw": number["jaw_1"] + number["jaw_2"]}
    result = Result("0026", "ok", (), "lnd", "roll_link", camera_from_root, joints, {})
    published = shared / "formats" / "published_layout" / "0"
    np.testing.assert_allclose(pose_vector(camera_from_root), np.load(published / "optimized_ctr.npy"), atol=2e-6)
    theirs = np.load(published / "optimized_joint_angles.npy")
    np.testing.assert_allclose(joint_vector(result)[:2], theirs[:2], atol=2e-6)
    assert joint_vector(result)[2:].sum() == pytest.approx(theirs[2:].sum(), abs=2e-6)
    np.testing.assert_allclose(theirs[2:], [number["jaw_2"], number["jaw_1"]], atol=2e-6)


def test_estimate_agrees_with_published_tracker_start(shared: Path, scanned_body: Body) -> None:
    session = read_session(shared / "frames" / "real" / "easy")
    files = next(frame for frame in session.frames if frame.name == "0026")
    frame = read_frame(files, session.camera)
    result = estimate(frame.mask, frame.camera, files.readings, scanned_body)
    assert result.camera_from_root is not None
    published = shared / "formats" / "published_layout" / "0"
    start, theirs = pose_vector(result.camera_from_root), np.load(published / "optimized_ctr.npy")
    apart = Rotation.from_rotvec(start[:3]).inv() * Rotation.from_rotvec(theirs[:3])
    assert np.degrees(apart.magnitude()) < 6
    assert np.linalg.norm(start[3:] - theirs[3:]) < 3e-3
    np.testing.assert_allclose(joint_vector(result), np.load(published / "optimized_joint_angles.npy"), atol=0.15)


def test_moving_endoscope_is_exported_by_what_stays() -> None:
    """The camera in the endoscope's tip and the arm's base in that of its arm, in place of one moment's base."""
    tip, ecm = moved(np.eye(4), [0.001, 0.002, 0.01, 0.0, 0.0, np.pi]), moved(np.eye(4), [0.1, 0.2, 0.0, 0.3, 0.0, 0.4])
    document = {
        "camera_from_base": BASE.tolist(),
        "endoscope": {"tip_from_camera": tip.tolist(), "ecm_from_base": ecm.tolist()},
    }
    base = base_of_session("session.json", document, {})
    assert base.tip_from_camera is not None
    files = registration_files(base.camera_from_base, NAMES, ecm_from_base=base.ecm_from_base)
    arms = {one["name"]: np.array(one["measured_cp"]) for one in json.loads(files["suj-fixed.json"])["arms"]}
    np.testing.assert_allclose(arms[NAMES.arm], ecm, atol=1e-9)
    pieces = base_of_session("session.json", {**document, "endoscope": {"tip_from_camera": None}}, {})
    assert pieces.warnings
    assert not base.warnings
