"""`dvrk-cmaes export --to ros1-bag|ros2-bag`, read back by rosbags: poses, times, names of frames and of joints."""

from __future__ import annotations

import builtins
import json
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.canned_results import BASE, canned, failed, write_results
from helpers.commands import Ran, run_command
from helpers.files import write_json
from helpers.transforms import moved
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore
from scipy.spatial.transform import Rotation

from dvrk_cmaes.instrument.arm import base_from_root

KINDS = {"ros1-bag": "PSM1.bag", "ros2-bag": "PSM1"}
TIMES = {"0000": 1_795_000_000_123_456_789, "0001": 1_795_000_000_156_789_012, "0002": 1_795_000_000_190_000_001}
FOUND = "/dvrk_cmaes/PSM1"
SESSION_BASE = moved(BASE, [0.002, -0.001, 0.001, 0.01, 0.02, -0.03])
PLACES = [moved(BASE, [0.01 * k, 0.0, 0.02 * k, 0.1 * k, 0.0, 0.2 * k]).tolist() for k in range(2)]
IN_TIP = moved(np.eye(4), [0.001, 0.002, 0.01, 0.0, 0.5, 3.0]).tolist()
IN_ECM = {name: moved(np.eye(4), [x, 0.2, 0.0, 0.3, 0.0, 0.4]).tolist() for name, x in (("PSM1", -0.1), ("PSM2", 0.1))}

Run = Callable[..., Ran]
Messages = dict[str, list[Any]]


@pytest.fixture
def run(capsys: pytest.CaptureFixture[str]) -> Run:
    """Run ``dvrk-cmaes export``."""
    return partial(run_command, capsys, "export")


@pytest.fixture
def results(tmp_path: Path) -> Path:
    """Write three frames with poses and a failed one, a session calibration, and the frames' times."""
    out = write_results(tmp_path / "out", *(canned(name, k) for k, name in enumerate(TIMES)), failed("0003"))
    write_json(out / "session.json", {"schema": 1, "camera_from_base": SESSION_BASE.tolist(), "frames": list(TIMES)})
    rows = [f"{name},{time // 10**9}.{time % 10**9:09d}" for name, time in TIMES.items()]
    (tmp_path / "images.csv").write_text("\n".join(["frame,time", *rows, ""]))
    return out


def read_bag(path: Path) -> Messages:
    """Read all messages by topic, as (time of recording, message)."""
    messages: Messages = {}
    with AnyReader([path], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader:
        for connection, time, data in reader.messages():
            messages.setdefault(connection.topic, []).append((time, reader.deserialize(data, connection.msgtype)))
    return messages


def exported(run: Run, results: Path, kind: str, *arguments: object) -> Messages:
    ran = run(results, "--to", kind, "--times", results.parent / "images.csv", *arguments)
    assert ran.code == 0, ran.err
    return read_bag(results / "exports" / KINDS[kind])


def matrix(position: Any, orientation: Any) -> np.ndarray:
    out = np.eye(4)
    out[:3, :3] = Rotation.from_quat([orientation.x, orientation.y, orientation.z, orientation.w]).as_matrix()
    out[:3, 3] = position.x, position.y, position.z
    return out


def poses(messages: Messages, topic: str) -> list[np.ndarray]:
    stated = [message.pose.pose if hasattr(message.pose, "pose") else message.pose for _, message in messages[topic]]
    return [matrix(pose.position, pose.orientation) for pose in stated]


@pytest.fixture
def steered(results: Path) -> Path:
    """Put the results below PSM1 of two arms; the endoscope stood in the first two frames, and moved in the third."""
    folder = results.rename(results.parent / "PSM1").parent
    stands = [
        {"first": name, "last": name, "camera_from_base": base} for name, base in zip(TIMES, PLACES, strict=False)
    ]
    moves = {"bases": stands, "tip_from_camera": IN_TIP, "ecm_from_base": IN_ECM["PSM1"]}
    session = {"camera_from_base": PLACES[0], "frames": list(TIMES), "endoscope": moves}
    write_json(folder / "PSM1" / "session.json", session)
    arms = {name: {"ecm_from_base": base, "std": [0.001] * 6} for name, base in IN_ECM.items()}
    write_json(folder / "arms.json", {"reference": "PSM1", "arms": {}, "endoscope": {"arms": arms}})
    return folder / "PSM1"


def test_moving_endoscope_is_in_tf_by_its_places(run: Run, steered: Path) -> None:
    """The chain from the ECM's base to the tool gives each frame's base; both arms' bases stay where they are."""
    messages = exported(run, steered, "ros2-bag")
    roots = poses(messages, f"{FOUND}/camera_from_root")
    frames = list(zip(PLACES, roots[:2], messages["/tf"], strict=False))
    assert len(frames) == 2
    for base, root, (_, message) in frames:
        found = {
            (one.header.frame_id, one.child_frame_id): matrix(one.transform.translation, one.transform.rotation)
            for one in message.transforms
        }
        np.testing.assert_allclose(found["ECM_base", "PSM1_base"], IN_ECM["PSM1"], atol=1e-9)
        np.testing.assert_allclose(found["ECM_base", "PSM2_base"], IN_ECM["PSM2"], atol=1e-9)
        np.testing.assert_allclose(found["camera", "PSM1_roll_link"], root, atol=1e-9)
        ecm_from_camera = found["ECM_base", "ECM_tip"] @ found["ECM_tip", "camera"]
        np.testing.assert_allclose(ecm_from_camera @ base, IN_ECM["PSM1"], atol=1e-9)
    assert len({child for _, child in found}) == len(found)  # tf allows one parent of each


def test_moving_endoscope_has_both_bases_in_other_formats(run: Run, steered: Path) -> None:
    assert run(steered, "--to", "dvrk").code == 0
    arms = json.loads((steered / "exports" / "suj-fixed.json").read_text())["arms"]
    assert [one["name"] for one in arms] == ["ECM", "PSM1", "PSM2"]
    np.testing.assert_allclose(arms[2]["measured_cp"], IN_ECM["PSM2"], atol=1e-9)
    lines = run(steered, "--to", "tf").out.splitlines()
    children = [line.split("--child-frame-id ")[1] for line in lines]
    assert children == ["camera", "PSM1_base", "PSM2_base"]


def test_measured_cp_is_tip_by_readings_beside_tip_found(run: Run, results: Path) -> None:
    """The tip of the driver lies on the wrist yaw axis: 9.1 mm from the root, in a direction that the wrist gives."""
    messages = exported(run, results, "ros2-bag")
    for k, name in enumerate(TIMES):
        result = canned(name, k)
        read, found = (poses(messages, topic)[k] for topic in ("/PSM1/measured_cp", f"{FOUND}/measured_cp"))
        assert result.camera_from_root is not None
        for tip, root, joints in (
            (read, SESSION_BASE @ base_from_root(result.readings), result.readings),
            (found, result.camera_from_root, result.joints),
        ):
            pitch = joints["wrist_pitch"]
            np.testing.assert_allclose(
                np.linalg.inv(root) @ tip[:, 3], [0.0091 * np.sin(pitch), 0, 0.0091 * np.cos(pitch), 1], atol=1e-9
            )


def test_tip_is_that_of_tool_description(run: Run, results: Path, shared: Path) -> None:
    tool = shared / "formats" / "tool" / "PROGRASP_FORCEPS_400093.json"
    default = poses(exported(run, results, "ros2-bag"), f"{FOUND}/measured_cp")
    other = poses(exported(run, results, "ros2-bag", "--tool", tool), f"{FOUND}/measured_cp")
    roots = poses(read_bag(results / "exports" / "PSM1"), f"{FOUND}/camera_from_root")
    lengths = [
        [float(np.linalg.norm(tip[:3, 3] - root[:3, 3])) for tip, root in zip(tips, roots, strict=True)]
        for tips in (default, other)
    ]
    assert lengths[0] == pytest.approx([0.0091] * 3)
    assert lengths[1] == pytest.approx([0.0107] * 3)


def test_base_that_is_not_known_is_left_out(run: Run, tmp_path: Path) -> None:
    out = write_results(tmp_path / "out", canned("0001", camera_from_base=None))
    ran = run(out, "--to", "ros2-bag")
    assert "camera_from_base is not known: no measured_cp by the readings, and no base in tf" in ran.err
    messages = read_bag(out / "exports" / "PSM1")
    assert "/PSM1/measured_cp" not in messages
    assert [one.child_frame_id for one in messages["/tf"][0][1].transforms] == ["PSM1_roll_link"]


def test_wrong_input_is_refused(run: Run, results: Path, tmp_path: Path) -> None:
    short = tmp_path / "short.csv"
    short.write_text("frame,time\n0000,1\n")
    assert run(results, "--to", "ros2-bag", "--times", short).refusal == (
        "--times: expected a time of every frame, got none of 0001, 0002"
    )
    assert run(results, "--to", "csv", "--times", short).refusal == (
        "--times, --tool: expected the format ros1-bag or ros2-bag, got --to csv"
    )
    assert run(results, "--to", "ros2-bag", "--camera-frame", "/camera").code == 2
    none = write_results(tmp_path / "none", failed("0001"))
    assert run(none, "--to", "ros1-bag").refusal == (
        f"{none}: camera_from_root: expected a pose in at least one frame, got none"
    )


def test_missing_library_is_named(monkeypatch: pytest.MonkeyPatch, run: Run, results: Path) -> None:
    load = builtins.__import__

    def without(name: str, *rest: Any, **options: Any) -> Any:
        if name.startswith("rosbags"):
            raise ImportError(name)
        return load(name, *rest, **options)

    monkeypatch.setattr(builtins, "__import__", without)
    assert run(results, "--to", "ros1-bag").refusal == (
        "--to ros1-bag: needs the library rosbags, which is not installed; "
        f"run: {sys.executable} -m pip install 'rosbags<0.12,>=0.11'"
    )
