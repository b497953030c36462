"""Input that ``dvrk-cmaes import`` refuses: one line, and nothing written."""

from __future__ import annotations

import errno
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from helpers.commands import main
from helpers.made_recordings import (
    BEGIN,
    KINDS,
    SECOND,
    Message,
    camera_info,
    compressed,
    good,
    image,
    jaw,
    joints,
    pixels,
    sweep,
    write_bag,
    write_video,
)

CAMERA = "width: 64\nheight: 48\nK: [70, 0, 32, 0, 70, 24, 0, 0, 1]\nD: []\n"
TABLE = "time,jaw\n0,0.5\n0.4,0.5\n"

Refused = Callable[..., str]


@pytest.fixture
def refused(tmp_path: Path, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> Refused:
    """Run an import that must be refused, check that nothing was written, and give the line on stderr."""
    monkeypatch.chdir(tmp_path)

    def go(source: object, *arguments: object, code: int = 2) -> str:
        before = sorted(tmp_path.rglob("*"))
        assert main(["import", str(source), "--out", "session", *map(str, arguments)]) == code
        assert sorted(tmp_path.rglob("*")) == before
        printed = capfd.readouterr()
        assert printed.out == ""
        assert printed.err.startswith("dvrk-cmaes: ")
        assert printed.err.count("\n") == 1
        return printed.err.strip().removeprefix("dvrk-cmaes: ")

    return go


def without(kind: str, messages: list[Message] | None = None) -> list[Message]:
    return [m for m in (good(2) if messages is None else messages) if m.kind != kind]


def with_image(message: Message) -> list[Message]:
    return [*without("Image"), message]


# topics


@pytest.mark.parametrize(
    ("messages", "arguments", "expected"),
    [
        (
            [*good(2), image(BEGIN, pixels(0), topic="/right/image_raw")],
            (),
            "--image-topic: expected one topic of images, got several: /left/image_raw, /right/image_raw",
        ),
        (
            good(2),
            ("--image-topic", "/left/image"),
            "--image-topic: no messages on /left/image; expected one of "
            "/left/image_raw, /left/camera_info, /PSM1/measured_js, /PSM1/jaw/measured_js",
        ),
        (
            good(2),
            ("--image-topic", "/left/camera_info"),
            "--image-topic: /left/camera_info: expected sensor_msgs/Image or sensor_msgs/CompressedImage, "
            "got sensor_msgs/CameraInfo",
        ),
        (
            without("CameraInfo"),
            (),
            "--camera-topic: expected a topic of the camera (or --camera FILE, or none) (sensor_msgs/CameraInfo), "
            "got /PSM1/jaw/measured_js, /PSM1/measured_js, /left/image_raw",
        ),
        (
            [*without("CameraInfo"), camera_info(BEGIN, "/a/camera_info"), camera_info(BEGIN, "/b/camera_info")],
            (),
            "--camera-topic: expected one topic of the camera (or --camera FILE, or none), got several: "
            "/a/camera_info, /b/camera_info",
        ),
        (
            [*good(2), joints(BEGIN, sweep(BEGIN), topic="/PSM2/measured_js")],
            (),
            "--joints-topic: expected one topic of the arm's joints (--arm, or none), got several: "
            "/PSM1/measured_js, /PSM2/measured_js",
        ),
        (
            [*without("JointState"), jaw(BEGIN, 0.1), joints(BEGIN, sweep(BEGIN), topic="/PSM1/setpoint_js")],
            (),
            "--joints-topic: expected a topic of the arm's joints (--arm, or none) (sensor_msgs/JointState), "
            "got /PSM1/jaw/measured_js, /PSM1/setpoint_js, /left/camera_info, /left/image_raw",
        ),
        (
            good(2),
            ("--jaw-topic", "/PSM1/measured_js"),
            "/PSM1/measured_js: yaw, pitch, insertion, roll, wrist_pitch, wrist_yaw: expected joints that were not "
            "read before (leave a topic out by --jaw-topic none)",
        ),
    ],
)
def test_missing_or_ambiguous_topics_are_refused(
    refused: Refused, tmp_path: Path, messages: list[Message], arguments: tuple[str, ...], expected: str
) -> None:
    bag = write_bag(tmp_path / "bag", "mcap", messages)
    assert refused(bag, *arguments) == f"{bag}: {expected}"


# messages


@pytest.mark.parametrize(
    ("messages", "expected"),
    [
        (
            with_image(image(BEGIN, pixels(0, 2), "mono16")),
            "/left/image_raw: image 0: encoding: expected one of mono8, ",
        ),
        (with_image(image(BEGIN, pixels(0, 2), "")), "/left/image_raw: image 0: encoding: expected one of "),
        (
            with_image(image(BEGIN, pixels(0, 1), "bgr8")),
            "/left/image_raw: image 0: expected 64 x 48 pixels of bgr8, got 3072 bytes in rows of 64",
        ),
        (
            with_image(replace(m := image(BEGIN, pixels(0)), fields={**m.fields, "height": 60_000, "width": 60_000})),
            "/left/image_raw: image 0: expected at most 36 megapixels, got 60000 x 60000",
        ),
        (
            with_image(replace(m, fields={**m.fields, "height": 0})),
            "/left/image_raw: image 0: expected 1 pixel to 36 megapixels, got 64 x 0",
        ),
        (
            with_image(compressed(BEGIN, b"RIFF....WEBP", "webp")),
            "/left/image_raw/compressed: image 0: format: expected a PNG or JPEG, got 'webp'",
        ),
        (
            with_image(compressed(BEGIN, cv2.imencode(".png", pixels(0))[1].tobytes()[:-20])),
            "/left/image_raw/compressed: image 0: expected a PNG or JPEG, got one that is cut off or damaged",
        ),
        (
            [*good(2), image(BEGIN + SECOND, pixels(0)[:40])],
            "image 2: expected the first image's size 64 x 48, got 64 x 40",
        ),
        (
            [*without("JointState"), joints(BEGIN, [0.1] * 6, ["a", "b", "c", "d", "e", "f"])],
            "/PSM1/measured_js: name: unknown joint 'a'; expected one of jaw, yaw,",
        ),
        (
            [*without("JointState"), joints(BEGIN, [0.1] * 5, [])],
            "/PSM1/measured_js: position: expected 6 values (yaw, pitch, insertion, roll, wrist_pitch, wrist_yaw), "
            "1 (jaw) or all 7, got 5",
        ),
        (
            [*good(2), joints(BEGIN, [0.1] * 5)],
            "/PSM1/measured_js: position: expected 6 numbers, one for each name, got 5",
        ),
        (
            [*without("JointState"), *(joints(BEGIN - SECOND - k, sweep(BEGIN)) for k in range(9))],
            "/PSM1/measured_js: expected readings within 0.05 s before and after an image, got readings of ",
        ),
    ],
)  # fmt: skip
def test_unusable_message_is_refused(refused: Refused, tmp_path: Path, messages: list[Message], expected: str) -> None:
    bag = write_bag(tmp_path / "bag", "ros1", messages)
    assert refused(bag).startswith(f"{bag}: {expected}")


@pytest.mark.parametrize(
    ("messages", "expected"),
    [
        (
            [*without("CameraInfo"), camera_info(BEGIN, k=np.zeros(9), p=np.zeros(12))],
            "/left/camera_info: K: expected positive focal lengths in pixels",
        ),
        (
            [*without("CameraInfo"), camera_info(BEGIN, distortion_model="wavy")],
            "/left/camera_info: distortion_model: expected one of",
        ),
        (
            [*without("JointState"), *(joints(BEGIN + k * 10**7, [47.0] * 6) for k in range(20))],
            "session/joints.csv: frame 000000: yaw: expected radians (at most 2 pi), got 47: this looks like degrees",
        ),
    ],
)
def test_values_that_session_cannot_hold_are_refused(
    refused: Refused, tmp_path: Path, messages: list[Message], expected: str
) -> None:
    assert expected in refused(write_bag(tmp_path / "bag", "mcap", messages))


# damage


@pytest.mark.parametrize("kind", KINDS)
def test_truncated_recording_is_refused(refused: Refused, tmp_path: Path, kind: str) -> None:
    bag = write_bag(tmp_path / "bag", kind, good(2))
    file = bag if bag.is_file() else next(path for path in bag.iterdir() if path.name != "metadata.yaml")
    data = file.read_bytes()
    for share in (0.0, 0.001, 0.05, 0.4, 0.8, 0.97):
        file.write_bytes(data[: int(share * len(data))])
        message = refused(bag)
        assert message.startswith((f"{bag}: expected a ROS recording", f"{bag}: --image-topic: expected"))


@pytest.mark.parametrize("text", ["", "[1, 2", "a: 1", "rosbag2_bagfile_information: {version: 99}", "\0"])
def test_unusable_metadata_is_refused(refused: Refused, tmp_path: Path, text: str) -> None:
    bag = write_bag(tmp_path / "bag", "sqlite3", good(1))
    (bag / "metadata.yaml").write_text(text)
    by_rosbags = f"{bag}: expected a ROS recording, got one that cannot be read: "
    assert refused(bag).startswith(
        (by_rosbags, f"{bag / 'metadata.yaml'}: expected metadata of a ROS 2 recording, got ")
    )


def test_other_files_are_refused(refused: Refused, tmp_path: Path) -> None:
    (tmp_path / "folder").mkdir()
    (tmp_path / "loop.bag").symlink_to("loop.bag")
    (tmp_path / "text.mp4").write_text("no video")
    (tmp_path / "picture0001.png").write_bytes(cv2.imencode(".png", pixels(0))[1].tobytes())
    (tmp_path / "camera.yaml").write_text(CAMERA)
    (tmp_path / "table.csv").write_text(TABLE)
    beside = ("--camera", "camera.yaml", "--joints", "table.csv")
    assert refused("folder").startswith("folder: expected a recording, got a folder: one of pictures or a session")
    assert refused("away.bag") == "away.bag: no such file; expected a ROS recording"
    assert "loop.bag: not readable (Too many levels of symbolic links)" in refused("loop.bag")
    assert refused("away.mp4", *beside).startswith("away.mp4: no such file; expected a video that OpenCV reads, or a")
    assert refused("text.mp4", *beside).endswith("got something else or a damaged file")
    assert refused("/dev/zero", *beside).endswith("got something that is not a regular file")
    assert refused("text.mp4", *beside, "--image-topic", "/a") == (
        "text.mp4: --image-topic: expected a ROS recording with it, got a video"
    )


@pytest.mark.parametrize(
    ("table", "expected"),
    [
        ("", "expected joint readings (joints.csv, or name=value,name=value), got an empty file"),
        ("frame,jaw\n0,1\n", "expected joint readings with times (a column time, in seconds), got rows of jaw without"),
        ("time,jav\n0,1\n", "header: unknown joint 'jav'; expected one of jaw, yaw"),
        ("time,jaw\nnoon,1\n", "line 2: time: expected a finite number of seconds, got 'noon'"),
        ("time,jaw\n0,inf\n", "line 2: jaw: expected a finite number in rad, got 'inf'"),
    ],
)
def test_unusable_reading_table_is_refused_with_line(
    refused: Refused, tmp_path: Path, table: str, expected: str
) -> None:
    write_video(tmp_path / "video.avi", 2)
    (tmp_path / "camera.yaml").write_text(CAMERA)
    (tmp_path / "table.csv").write_text(table)
    assert refused("video.avi", "--camera", "camera.yaml", "--joints", "table.csv").startswith(f"table.csv: {expected}")


def test_video_requires_camera_and_readings(refused: Refused, tmp_path: Path) -> None:
    write_video(tmp_path / "video.avi", 2)
    (tmp_path / "camera.yaml").write_text(CAMERA)
    message = "a video needs a camera file and a table of readings; got none"
    assert refused("video.avi").startswith(f"video.avi: --camera, --joints: {message}; without a calibration: ")
    assert refused("video.avi", "--camera", "camera.yaml") == f"video.avi: --joints: {message}"


# options and places


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (("--every", 0), "--every: expected a whole number of at least 1, got 0"),
        (("--tolerance", "nan"), "--tolerance: expected a time in seconds above 0, got nan"),
        (("--start", 3, "--end", 2), "--start, --end: expected 0 <= start < end in seconds, got 3 and 2"),
        (("--start", 60), "bag: expected images, got none (of those asked for)"),
    ],
)
def test_invalid_options_are_refused(
    refused: Refused, tmp_path: Path, arguments: tuple[object, ...], expected: str
) -> None:
    write_bag(tmp_path / "bag", "mcap", good(1))
    assert refused("bag", *arguments) == expected


def test_other_files_at_output_are_kept(refused: Refused, tmp_path: Path) -> None:
    bag = write_bag(tmp_path / "bag", "mcap", good(1))
    session = tmp_path / "session"
    session.write_text("mine")
    assert refused(bag, "--overwrite") == "session: expected a folder to write, got a file of that name"
    session.unlink()
    session.mkdir()
    (session / "thesis.tex").write_text("mine")
    assert refused(bag) == (
        "session: expected a new or empty folder, got one with files in it (--overwrite replaces it)"
    )
    assert refused(bag, "--overwrite") == (
        "session: expected a new or empty folder, or one of an earlier import, got one with thesis.tex; "
        "nothing was changed"
    )
    (session / "camera.yaml").write_text(CAMERA)
    inside = write_bag(session / "bag", "mcap", good(1))
    assert refused(inside, "--overwrite") == f"session: expected a folder apart from {inside}, got one that holds it"
    assert (session / "thesis.tex").read_text() == "mine"


def test_older_session_is_kept_on_failure(
    refused: Refused, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    bag = write_bag(tmp_path / "bag", "mcap", good(2))
    assert main(["import", str(bag), "--out", "session"]) == 0
    capfd.readouterr()

    def full(*_: object, **__: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr("dvrk_cmaes.io.output.os.replace", full)
    assert refused(bag, "--overwrite", code=1) == (
        "session: not written (No space left on device); expected a place to write results"
    )


def test_missing_library_is_reported_with_install_command(
    refused: Refused, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    bag = write_bag(tmp_path / "bag", "mcap", good(1))
    monkeypatch.setitem(sys.modules, "rosbags.highlevel", None)
    assert refused(bag) == (
        f"{bag}: a ROS recording: needs the library rosbags, which is not installed; "
        f"run: {sys.executable} -m pip install 'rosbags<0.12,>=0.11'"
    )
