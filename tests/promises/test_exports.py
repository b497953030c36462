"""Exports, read back in the way of the programs that they are for: the same transform in the documented direction."""

from __future__ import annotations

import csv
import json
import re
import shlex
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pytest
import yaml
from pyarrow import parquet
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore
from scipy.spatial.transform import Rotation

from dvrk_cmaes import read_camera, read_result, read_results
from promises.program import DEMO, Kept, Ran, run
from promises.truth import distance, matrix, results

FLIP = np.diag([-1.0, -1.0, 1.0, 1.0])


@pytest.fixture
def calibrated(kept: Kept) -> Path:
    """The calibration of the bundled session."""
    return kept("calibrate", DEMO).folder


@pytest.fixture
def base(calibrated: Path) -> np.ndarray:
    """camera_from_base of the calibration."""
    return matrix(json.loads((calibrated / "session.json").read_text()), "camera_from_base")


def export(source: Path, to: str, out: Path, *more: object) -> Ran:
    """Export to a folder."""
    ran = run("export", source, "--to", to, "--arm", "PSM1", "--out", out, *more)
    assert ran.code == 0, ran.err
    return ran


def same(found: Any, expected: Any, atol: float = 1e-6) -> None:
    """Compare arrays."""
    np.testing.assert_allclose(np.array(found, float), expected, atol=atol)


def pose(translation: Any, quaternion: Any) -> np.ndarray:
    """Give a transform of a translation and a quaternion, mappings or objects of x, y, z, w."""
    get = (lambda one, name: one[name]) if isinstance(translation, dict) else getattr
    return pose_of_numbers([get(translation, axis) for axis in "xyz"] + [get(quaternion, axis) for axis in "xyzw"])


def pose_of_numbers(numbers: list[float]) -> np.ndarray:
    """Give a transform of three numbers of a translation and four of a quaternion."""
    out = np.eye(4)
    out[:3, :3], out[:3, 3] = Rotation.from_quat(numbers[3:]).as_matrix(), numbers[:3]
    return out


def times(folder: Path, begin: float, step: float) -> Path:
    """Write times of the frames."""
    lines = ["frame,time", *(f"{k:04d},{begin + k * step!r}" for k in range(5))]
    (folder / "images.csv").write_text("\n".join(lines) + "\n")
    return folder / "images.csv"


def test_registration_of_the_dvrk(calibrated: Path, base: np.ndarray, tmp_path: Path) -> None:
    ran = export(calibrated, "dvrk", tmp_path, "--dvrk-version", "2.3")
    for axes, expected in (("open-cv", base), ("dVRK", FLIP @ base)):
        entry = json.loads((tmp_path / f"PSM1-registration-{axes}.json").read_text())["base-frame"]
        same(entry["transform"], expected)
    assert "camera_from_base" in ran.out
    export(calibrated, "dvrk", tmp_path / "new")
    entry = json.loads((tmp_path / "new" / "PSM1-registration-dVRK.json").read_text())["base_frame"]
    same(entry["transform"], FLIP @ base)


def test_fixed_setup_joints_of_the_dvrk(calibrated: Path, base: np.ndarray, tmp_path: Path) -> None:
    position, orientation = {"x": 0.01, "y": 0.02, "z": 0.1}, {"x": 0.0, "y": 0.6, "z": 0.0, "w": 0.8}
    ecm = {"header": {"frame_id": "ECM"}, "pose": {"position": position, "orientation": orientation}}
    (tmp_path / "ecm.yaml").write_text(yaml.safe_dump(ecm))
    export(calibrated, "dvrk", tmp_path / "out", "--ecm-pose", tmp_path / "ecm.yaml")
    arms = json.loads((tmp_path / "out" / "suj-fixed.json").read_text())["arms"]
    (arm,) = (arm for arm in arms if arm["name"] == "PSM1")
    same(arm["measured_cp"], pose(position, orientation) @ FLIP @ base)


def test_easy_handeye(calibrated: Path, base: np.ndarray, tmp_path: Path) -> None:
    export(calibrated, "easy-handeye", tmp_path)
    (path,) = tmp_path.glob("*.calib")
    document = yaml.safe_load(path.read_text())
    assert document["parameters"]["calibration_type"] == "eye_on_base"
    same(pose(document["transform"]["translation"], document["transform"]["rotation"]), np.linalg.inv(base))


def test_tf_line_is_alone_on_stdout(calibrated: Path, base: np.ndarray) -> None:
    words = shlex.split(run("export", calibrated, "--to", "tf", "--arm", "PSM3").out)
    assert words[:4] == ["ros2", "run", "tf2_ros", "static_transform_publisher"]
    given = dict(zip(words[4::2], words[5::2], strict=True))
    assert (given["--frame-id"], given["--child-frame-id"]) == ("camera", "PSM3_base")
    same(pose_of_numbers([float(given[f"--{name}"]) for name in ("x", "y", "z", "qx", "qy", "qz", "qw")]), base)


def test_tables_of_poses(calibrated: Path, tmp_path: Path) -> None:
    """Each frame's camera_from_root, in BOP's table, in that of this program, along TUM's trajectory and in Python."""
    found = results(calibrated)
    assert [*read_results(calibrated).frames] == [*found]
    for to in ("bop", "csv"):
        export(calibrated, to, tmp_path)
    export(calibrated, "tum", tmp_path, "--times", times(tmp_path, 100.0, 1 / 30))
    (bop,) = (path for path in tmp_path.glob("*.csv") if path.name not in ("poses.csv", "images.csv"))
    assert bop.read_text().splitlines()[0] == "scene_id,im_id,obj_id,score,R,t,time"
    tum = [line for line in (tmp_path / "PSM1.tum").read_text().splitlines() if not line.startswith("#")]
    tables = [list(csv.DictReader(path.read_text().splitlines())) for path in (bop, tmp_path / "poses.csv")]
    for row, named, line, (frame, result) in zip(*tables, tum, found.items(), strict=True):
        expected = matrix(result, "camera_from_root")
        assert (f"{int(row['im_id']):04d}", named["frame"]) == (frame, frame)
        same(np.reshape(row["R"].split(), (3, 3)), expected[:3, :3])
        same(row["t"].split(), expected[:3, 3] * 1e3, 1e-3)
        numbers = [value for name, value in named.items() if re.fullmatch(r".*root.*_[xyz]_mm|[xyz]_mm", name)]
        same(numbers[:3], expected[:3, 3] * 1e3, 1e-3)
        read = read_result(calibrated / "frames" / f"{frame}.json")
        same(read.camera_from_root, expected, 1e-12)
        assert (read.to_dict()["joints"], read.status) == (result["joints"], result["status"])
        time, *numbers_of_tum = map(float, line.split())
        assert time == pytest.approx(100 + int(frame) / 30, abs=1e-6)
        assert distance(pose_of_numbers(numbers_of_tum), expected) < (1e-3, 1e-3)


@pytest.mark.parametrize("kind", ["ros1-bag", "ros2-bag"])
def test_ros_recording(calibrated: Path, base: np.ndarray, tmp_path: Path, kind: str) -> None:
    export(calibrated, kind, tmp_path / "out", "--times", times(tmp_path, 1795000000.5, 1.0))
    path = tmp_path / "out" / ("PSM1.bag" if kind == "ros1-bag" else "PSM1")
    messages: dict[str, list[Any]] = {}
    with AnyReader([path], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader:
        for connection, time, data in reader.messages():
            messages.setdefault(connection.topic, []).append((time, reader.deserialize(data, connection.msgtype)))
    found = results(calibrated)
    for (time, message), result in zip(messages["/dvrk_cmaes/PSM1/camera_from_root"], found.values(), strict=True):
        assert time == (1795000000 + int(result["frame"])) * 10**9 + 5 * 10**8
        read, true = pose(message.pose.pose.position, message.pose.pose.orientation), matrix(result, "camera_from_root")
        same(read, true)
        turned, stated = true[:3, :3], np.array(result["covariance"]["matrix"])[:3, :3]
        in_camera = message.pose.covariance.reshape(6, 6)[:3, :3]
        np.testing.assert_allclose(in_camera, turned @ stated @ turned.T, rtol=1e-3, atol=1e-12)
        assert message.header.frame_id == "camera"
    for (_, message), result in zip(messages["/PSM1/measured_js"], found.values(), strict=True):
        read = dict(zip(message.name, message.position, strict=True))
        assert read == pytest.approx({name: result["readings"][name] for name in read})
    transforms = {one.child_frame_id: one.transform for _, message in messages["/tf"] for one in message.transforms}
    same(pose(transforms["PSM1_base"].translation, transforms["PSM1_base"].rotation), base)


def test_episode_has_corrected_columns_beside_its_own(calibrated: Path, base: np.ndarray, tmp_path: Path) -> None:
    episode, states = tmp_path / "episode_000003.parquet", [[0.1 * k] for k in range(7)]
    parquet.write_table(pa.table({"frame_index": list(range(7)), "observation.state": states}), episode)
    export(calibrated, "lerobot", tmp_path / "out", "--table", episode)
    rows = parquet.read_table(tmp_path / "out" / episode.name).to_pylist()
    assert [row["observation.state"] for row in rows] == states
    offsets = json.loads((calibrated / "session.json").read_text())["offsets"]
    for row in rows[:5]:
        result = results(calibrated)[f"{row['frame_index']:04d}"]
        own = {name.removeprefix("psm1_corrected."): value for name, value in row.items()}
        assert (own["status"], own["tip_probability"]) == (result["status"], result["tip_probability"])
        assert own["jaw"] == pytest.approx(result["joints"]["jaw"])
        assert own["yaw"] == pytest.approx(result["readings"]["yaw"] + offsets.get("yaw", 0.0))
        same(np.reshape(own["camera_from_base"], (4, 4)), base)
    assert rows[6]["psm1_corrected.status"] is None
    refusal = run("export", calibrated, "--to", "lerobot", "--out", tmp_path / "more").refusal
    assert "--table: expected the parquet file of the episode" in refusal


def test_cameras_are_read_back(calibrated: Path, tmp_path: Path) -> None:
    export(calibrated, "camera", tmp_path)
    for name in ("ros/camera.yaml", "opencv/camera.xml", "plain/camera.yaml"):
        same(read_camera(tmp_path / name, size=(640, 480)).matrix, read_camera(DEMO / "camera.yaml").matrix)


def test_results_of_another_program_are_read(tmp_path: Path) -> None:
    (tmp_path / "frames").mkdir()
    for frame, one in json.loads((DEMO / "golden.json").read_text())["frames"].items():
        document = {"camera_from_root": one["T_camera_roll_link"], "joints": one["joints"]}
        (tmp_path / "frames" / f"{frame}.json").write_text(json.dumps(document))
    ran = run("compare", DEMO / "golden.json", tmp_path)
    assert ran.code == 0, ran.err
    assert "5 of 5" in ran.out or "5 frames" in ran.out
