"""Formats of joint readings: topic dumps, recorded tables and NumPy files, matched by frame, number or time."""

from __future__ import annotations

import pickle
from pathlib import Path

import numpy as np
import pytest
from helpers.readings import read_joints

from dvrk_cmaes import InputError
from dvrk_cmaes.joints.reading import frame_readings, read_joint_file
from dvrk_cmaes.joints.times import parse_time, time_in_name

ARM = ("yaw", "pitch", "insertion", "roll", "wrist_pitch", "wrist_yaw")
VALUES = (0.59, -0.48, 0.1697, 0.39, -0.68, -0.36)
ROS_1 = """\
header:
  seq: 7
  stamp:
    secs: 100
    nsecs: 250000000
  frame_id: ''
name: [yaw, pitch, insertion, roll, wrist_pitch, wrist_yaw]
position: [0.59, -0.48, 0.1697, 0.39, -0.68, -0.36]
velocity: []
effort: [1.0, 1.0, 1.0, 1.0, 1.0, 1.0]
---
"""
COLLECTED = """\
# Topic: /PSM1/measured_js
# Type: sensor_msgs/msg/JointState
timestamp,effort.0,header.frame_id,header.stamp.nanosec,header.stamp.sec,name.0,name.1,position.0,position.1
1755000000000000000,0,,0,1755000000,wrist_pitch,insertion,0.1,0.15
1755000000020000000,0,,20000000,1755000000,wrist_pitch,insertion,0.3,0.17
"""


def written(folder: Path, text: str, name: str = "readings.txt") -> Path:
    path = folder / name
    path.write_text(text, encoding="utf-8")
    return path


def saved(path: Path, values: object) -> Path:
    np.save(path, np.array(values))
    return path


def message(path: Path, frame: str | None = None) -> str:
    with pytest.raises(InputError) as caught:
        read_joints(path, frame=frame)
    text = str(caught.value)
    assert "\n" not in text
    assert text.startswith(f"{path}: ")
    return text.removeprefix(f"{path}: ")


# messages of a topic


def test_gap_beyond_tolerance_is_refused(tmp_path: Path) -> None:
    table = written(tmp_path, "time,jaw\n10.0,0.2\n10.2,0.4\n")
    file = read_joint_file(table)
    with pytest.raises(InputError) as caught:
        frame_readings([file], "a", time=parse_time("", "10.1"))
    assert str(caught.value) == (
        f"{table}: frame a: jaw: expected readings before and after the image's time 10.100 s, within 0.05 s, "
        "got the nearest 0.100 s away"
    )
    wider = frame_readings([file], "a", time=parse_time("", "10.1"), tolerance=100_000_000)
    assert wider[0]["jaw"] == pytest.approx(0.3)


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ("position: [0.59,", "position: [[0.59],", "message 1: yaw: expected a finite number in rad, got [0.59]"),
        ("position: [0.59,", "position: [.inf,", "message 1: yaw: expected a finite number in rad, got inf"),
        (
            "position: [0.59,",
            "position: [59.1,",
            "message 1: yaw: expected radians (at most 2 pi), got 59.1: this looks",
        ),
        ("0.1697", "169.7", "message 1: insertion: expected metres, got 169.7: this looks like millimetres"),
        ("name: [yaw,", "name: [", "message 1: name: expected 6 different names, one for each position, got ["),
        ("name: [yaw,", "name: [outer_jow,", "message 1: name: unknown joint 'jow'; expected one of jaw, yaw, roll"),
        ("secs: 100", "secs: -1", "message 1: header.stamp: expected whole seconds and nanoseconds, got {"),
        ("effort: [1.0", "effort: [*x", "expected plain values, got a YAML alias ('x')"),
        ("effort: [1.0", "effort: [" + "[" * 30, "expected a small file, got YAML of more than 20 levels"),
        (
            "velocity: []",
            "velocity: [",
            "expected joint readings (JointState messages), got no valid YAML (line ",
        ),
    ],
)
def test_unusable_message_is_refused_with_field(tmp_path: Path, old: str, new: str, expected: str) -> None:
    assert old in ROS_1
    assert message(written(tmp_path, ROS_1.replace(old, new, 1))).startswith(expected)


# tables of recorders


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        (
            "sensor_msgs/msg/JointState",
            "geometry_msgs/msg/PoseStamped",
            "# Type: expected sensor_msgs/JointState, got ",
        ),
        ("position.0,position.1", "p.0,p.1", "header: expected columns position.0, ..., got timestamp, effort.0"),
        ("1755000000000000000", "soon", "line 2: time: expected a finite number of seconds, got 'soon'"),
        (",wrist_pitch,", ",wrist_pich,", "line 2: name: unknown joint 'wrist_pich'; expected one of wrist_pitch"),
    ],
)
def test_unusable_recording_is_refused(tmp_path: Path, old: str, new: str, expected: str) -> None:
    assert message(written(tmp_path, COLLECTED.replace(old, new))).startswith(expected)


# NumPy


def test_other_numpy_files_are_refused_without_running_code(tmp_path: Path) -> None:
    expected = "expected joint readings (joint_NNNN.npy of 6 numbers or jaw_NNNN.npy of 1), got "
    path = tmp_path / "joint_1.npy"
    assert message(saved(path, [1.0, 2.0])) == "expected 6 values (" + ", ".join(ARM) + "), 1 (jaw) or all 7, got 2"
    assert message(saved(path, np.zeros(100))) == f"{expected}float64 of shape (100,)"
    assert message(saved(path, ["a"])) == f"{expected}<U1 of shape (1,)"
    assert message(saved(path, [np.inf])) == "jaw: expected a finite number in rad, got inf"
    np.save(path, np.array([{"a": 1}], dtype=object), allow_pickle=True)
    assert message(path).startswith(f"{expected}no valid NumPy file (Object arrays cannot be loaded")
    whole = saved(path, VALUES).read_bytes()
    path.write_bytes(whole[:-9])
    assert message(path).startswith(f"{expected}no valid NumPy file (")
    path.write_bytes(whole.replace(b"(6,)", b"(10**9,)"))
    assert message(path).startswith(f"{expected}no valid NumPy file (")
    path.write_bytes(whole.replace(b"False", b"Fals]"))
    assert message(path).startswith(f"{expected}no valid NumPy file (")
    path.write_bytes(whole[:6] + b"\x09\x09" + pickle.dumps(1))
    assert message(path).startswith(f"{expected}no valid NumPy file (")


# times


@pytest.mark.parametrize("text", ["1755000000.000000001", "1755000000000000001", " 1.755000000000000001e9 "])
def test_times_are_parsed_to_the_nanosecond(text: str) -> None:
    assert parse_time("x", text) == 1755000000000000001


@pytest.mark.parametrize("text", ["", "soon", "nan", "inf", "1e400", "1e9999999", "-9e999999"])
def test_invalid_time_is_refused(text: str) -> None:
    with pytest.raises(InputError, match=r"^x: time: expected a finite number of seconds, got "):
        parse_time("x", text)


def test_time_is_read_from_end_of_image_name() -> None:
    assert time_in_name("left_1755000000.123456789") == 1755000000123456789
    assert time_in_name("left_0026") is None
