"""``dvrk-cmaes import``: ROS 1 and ROS 2 recordings and videos are converted to sessions."""

from __future__ import annotations

import csv
import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest
from helpers.commands import main, run_command
from helpers.files import read_image, write_json
from helpers.made_recordings import (
    ARM,
    BEGIN,
    KINDS,
    SECOND,
    Message,
    camera_info,
    compressed,
    good,
    image,
    joints,
    pixels,
    stamped,
    sweep,
    write_bag,
)
from helpers.page_calibrations import calibration, solved
from helpers.transforms import moved

from dvrk_cmaes import Camera, Lag, read_session
from dvrk_cmaes.geometry import quaternion_xyzw
from dvrk_cmaes.instrument.endoscope import ecm_from_tip_and_jacobian
from dvrk_cmaes.instrument.setup_joints import read_setup_joints
from dvrk_cmaes.joints.names import ECM_JOINTS
from dvrk_cmaes.recording.messages import ecm_values
from dvrk_cmaes.recording.recording import RecordedImage, Recording
from dvrk_cmaes.recording.write_session import write_session

CAMERA = Camera(64, 48, 80.25, 81.75, 31.5, 22.125, (-0.21, 0.1, 1e-05, -2e-05, 0.0))

Import = Callable[..., dict[str, Any]]


@pytest.fixture
def imported(tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> Import:
    """Import into ``session`` in an empty folder, and give the summary."""
    monkeypatch.chdir(tmp_path)

    def go(source: Path, *arguments: object) -> dict[str, Any]:
        code = main(["import", str(source), "--out", "session", "--json", *map(str, arguments)])
        printed = capsys.readouterr()
        assert code == 0, printed.err
        summary: dict[str, Any] = json.loads(printed.out)
        return {**summary, "said": printed.err}

    return go


def rows(name: str) -> list[dict[str, str]]:
    with open(Path("session") / name, newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


# ROS recordings


def calibrated(path: Path, **changes: object) -> Path:
    """Write the session.json of a calibration that found a lag of 50 ms."""
    lag = Lag(1.5, 0.1, 0.05, 0.003, **changes)  # type: ignore[arg-type]
    write_json(path, calibration(solved(["a", "b", "c"]), lag=lag).to_dict())
    return path


def test_lag_of_a_calibrated_session_is_taken_out(imported: Import, tmp_path: Path) -> None:
    bag = write_bag(tmp_path / "bag", KINDS[0], good())
    for words in ((), ("--lag", "auto")):
        summary = imported(bag, "--session", calibrated(tmp_path / "session.json"), "--overwrite", *words)
        assert summary["lag_s"] == 0.05
        expected = dict(zip(ARM, sweep(BEGIN + 2 * SECOND // 10 - SECOND // 20), strict=True))
        frames = read_session("session").frames
        assert {name: frames[2].readings[name] for name in ARM} == pytest.approx(expected, abs=1e-8)


def test_lag_that_is_zero_within_its_error_is_not_taken_out(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    write_bag(tmp_path / "run", "ros1", good())
    calibrated(tmp_path / "session.json", applied=False)
    assert main(["import", "run.bag", "--out", "session", "--session", "session.json"]) == 0
    assert capsys.readouterr().err == (
        "dvrk-cmaes: warning: session.json: lag: zero within its standard deviation (images are 1.50 frames (0.050 s) "
        "later than the readings, std 0.10 frames): none is taken out\n"
    )


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--lag", "auto"], "--lag: auto: expected --session FILE too, the session.json of a calibrated session"),
        (["--lag", "3frames"], "--lag: expected a number of seconds such as 0.13, got '3frames'"),
        (["--lag", "100"], "--lag: expected at most 60 seconds in magnitude, got '100'"),
        (
            ["--session", "frames.json"],
            "frames.json: lag: expected seconds, as of a session with times, got 2 frames",
        ),
        (["--session", "far.json"], "lag: expected at most 60 s in magnitude, got 100 s"),
    ],
)
def test_lag_that_cannot_be_taken_out_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, words: list[str], message: str
) -> None:
    monkeypatch.chdir(tmp_path)
    write_bag(tmp_path / "run", "ros1", good())
    write_json(tmp_path / "frames.json", calibration(solved(["a", "b", "c"]), lag=Lag(2.0, 0.1)).to_dict())
    far = Lag(None, seconds=100.0)
    write_json(tmp_path / "far.json", calibration(solved(["a", "b", "c"]), lag=far).to_dict())
    assert main(["import", "run.bag", "--out", "session", *words]) == 2
    assert capsys.readouterr().err.startswith(f"dvrk-cmaes: {message}")
    assert not (tmp_path / "session").exists()


def test_frames_without_near_readings_are_counted(imported: Import, tmp_path: Path) -> None:
    first, last = BEGIN + SECOND // 10, BEGIN + 3 * SECOND // 10
    gap = [m for m in good() if m.kind != "JointState" or m.topic.endswith("jaw/measured_js") or m.time < first]
    summary = imported(write_bag(tmp_path / "bag", "mcap", [*gap, joints(last, sweep(last))]))
    assert [row["wrist_yaw"] != "" for row in rows("joints.csv")] == [True, False, False, True, False]
    assert all(row["jaw"] for row in rows("joints.csv"))
    arm = summary["readings"][0]
    assert (arm["frames"], arm["without"]) == (2, 3)
    assert arm["nearest_s"] == pytest.approx(0.007)
    assert summary["said"] == ("dvrk-cmaes: warning: /PSM1/measured_js: 3 of 5 frames have no readings within 0.05 s\n")
    assert read_session("session").frames[1].readings.keys() == {"jaw"}


def test_readings_are_imported_alone_where_no_topic_of_images_is_asked_for(imported: Import, tmp_path: Path) -> None:
    summary = imported(write_bag(tmp_path / "bag", "mcap", good()), "--image-topic", "none")
    assert "images: none, readings only" in summary["notes"]
    assert not any(path.is_dir() or "camera" in path.name for path in Path("session").iterdir())
    assert any(row["jaw"] for row in rows("joints.csv"))


@pytest.mark.parametrize(
    ("encoding", "stored", "seen"),
    [
        ("rgb8", pixels(1)[:, :, ::-1], pixels(1)),
        ("bgra8", np.dstack([pixels(1), pixels(2, 1)]), pixels(1)),
        ("rgba8", np.dstack([pixels(1)[:, :, ::-1], pixels(2, 1)]), pixels(1)),
        ("mono8", pixels(1, 1), np.repeat(pixels(1, 1), 3, axis=2)),
    ],
)
def test_image_encodings_give_same_image(
    imported: Import, tmp_path: Path, encoding: str, stored: np.ndarray, seen: np.ndarray
) -> None:
    messages = [m for m in good(1) if m.kind != "Image"]
    imported(write_bag(tmp_path / "bag", "ros1", [*messages, image(BEGIN, stored, encoding, pad=5)]))
    assert np.array_equal(read_image(Path("session/images/000000.png")), seen)


@pytest.mark.parametrize("pattern", ["rggb", "bggr", "gbrg", "grbg"])
def test_bayer_patterns_are_decoded(imported: Import, tmp_path: Path, pattern: str) -> None:
    colour = {"r": 200, "g": 120, "b": 40}
    mosaic = np.tile(np.array([colour[c] for c in pattern], np.uint8).reshape(2, 2), (24, 32))[:, :, None]
    messages = [m for m in good(1) if m.kind != "Image"]
    imported(write_bag(tmp_path / "bag", "mcap", [*messages, image(BEGIN, mosaic, f"bayer_{pattern}8")]))
    inner = read_image(Path("session/images/000000.png"))[4:-4, 4:-4]
    assert np.unique(inner.reshape(-1, 3), axis=0).tolist() == [[40, 120, 200]]


@pytest.mark.parametrize("encoding", ["yuv422", "yuv422_yuy2"])
def test_yuv422_orders_are_decoded(imported: Import, tmp_path: Path, encoding: str) -> None:
    luma, u, v = 150, 90, 200
    pair = [u, luma, v, luma] if encoding == "yuv422" else [luma, u, luma, v]
    stored = np.tile(np.array(pair, np.uint8), (48, 32)).reshape(48, 64, 2)
    messages = [m for m in good(1) if m.kind != "Image"]
    imported(write_bag(tmp_path / "bag", "mcap", [*messages, image(BEGIN, stored, encoding)]))
    # ITU-R BT.601, limited range
    y, cb, cr = 1.164 * (luma - 16), u - 128, v - 128
    expected = [y + 2.018 * cb, y - 0.392 * cb - 0.813 * cr, min(y + 1.596 * cr, 255)]
    np.testing.assert_allclose(read_image(Path("session/images/000000.png"))[20, 20], expected, atol=1.5)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("extension", [".jpg", ".png"])
def test_compressed_images_are_copied_unchanged(imported: Import, tmp_path: Path, kind: str, extension: str) -> None:
    data = cv2.imencode(extension, pixels(3))[1].tobytes()
    messages = [m for m in good(1) if m.kind != "Image"]
    summary = imported(write_bag(tmp_path / "bag", kind, [*messages, compressed(BEGIN, data)]))
    assert (Path("session/images") / f"000000{extension}").read_bytes() == data
    assert "camera: /left/camera_info" in summary["notes"]


def renamed(messages: list[Message], topics: dict[str, str]) -> list[Message]:
    return [replace(m, topic=topics.get(m.topic, m.topic)) for m in messages]


def test_recording_times_replace_missing_header_times(imported: Import, tmp_path: Path) -> None:
    messages = [m for m in good() if m.kind != "JointState"] + stamped([m for m in good() if m.kind == "JointState"], 0)
    summary = imported(write_bag(tmp_path / "bag", "ros1", messages))
    note = (
        "times: those of recording, for the headers on /PSM1/measured_js have none, and on /PSM1/jaw/measured_js "
        "have none"
    )
    assert note in summary["notes"]
    assert [one["without"] for one in summary["readings"]] == [0, 0]


def test_changing_camera_and_rectified_images_are_noted(imported: Import, tmp_path: Path) -> None:
    zoomed = camera_info(BEGIN + 9, k=np.array([99.0, 0, 31.5, 0, 99.0, 22.1, 0, 0, 1]))
    messages = renamed([*good(), zoomed], {"/left/image_raw": "/left/image_rect_color"})
    notes = imported(write_bag(tmp_path / "bag", "mcap", messages))["notes"]
    assert "camera: /left/camera_info (the first: 1 later messages differ from it)" in notes
    assert any("--rectified" in note for note in notes)
    assert read_session("session").camera == CAMERA


def test_one_image_is_in_memory_at_a_time(tmp_path: Path) -> None:
    loaded = []

    def load() -> bytes:
        loaded.append(len(list((tmp_path).rglob("*.png"))))  # those before are written and not held
        return cv2.imencode(".png", pixels(0))[1].tobytes()

    images = (RecordedImage(k, k, load) for k in range(20))
    camera = b"width: 64\nheight: 48\nK: [70, 0, 32, 0, 70, 24, 0, 0, 1]\nD: []\n"
    recording = Recording(tmp_path / "r.bag", images, None, camera, {"": ()}, ())
    summary = write_session(recording, tmp_path / "s")
    assert summary.frames == 20
    assert loaded == [*range(20)]


# videos


def test_masks_that_were_drawn_in_an_imported_session_are_never_removed(
    capsys: pytest.CaptureFixture[str], imported: Import, tmp_path: Path
) -> None:
    bag = write_bag(tmp_path / "bag", "mcap", good())
    imported(bag)
    mask = Path("session/masks/000000.png")
    mask.parent.mkdir()
    mask.write_bytes(b"drawn by hand")
    ran = run_command(capsys, "import", bag, "--out", "session", "--overwrite")
    assert ran.refusal == ("session: masks/000000.png was not written by `import`; choose another --out, or move it")
    assert mask.read_bytes() == b"drawn by hand"


# the arm of the endoscope


def test_joints_of_the_endoscopes_arm_are_read_beside_those_of_the_instruments(
    imported: Import, tmp_path: Path
) -> None:
    names = ("outer_yaw", "outer_pitch", "outer_insertion", "outer_roll")
    of_ecm = [
        joints(one.time, sweep(one.time)[:4], names, "/ECM/measured_js") for one in good() if "PSM1/m" in one.topic
    ]
    summary = imported(write_bag(tmp_path / "bag", "mcap", [*good(), *of_ecm]))
    assert any(note == "ecm_yaw ecm_pitch ecm_insertion ecm_roll: /ECM/measured_js" for note in summary["notes"])
    for k, frame in enumerate(read_session("session").frames):
        expected = dict(zip(ECM_JOINTS, sweep(BEGIN + k * SECOND // 10)[:4], strict=True))
        assert {name: frame.readings[name] for name in ECM_JOINTS} == pytest.approx(expected, abs=1e-8)


def test_joints_follow_from_the_pose_of_the_endoscopes_tip() -> None:
    values = [0.2, -0.3, 0.12, 0.4]
    pose, _ = ecm_from_tip_and_jacobian(np.array(values))
    x, y, z, w = quaternion_xyzw(pose)
    place = SimpleNamespace(x=pose[0, 3], y=pose[1, 3], z=pose[2, 3])
    message = SimpleNamespace(pose=SimpleNamespace(position=place, orientation=SimpleNamespace(x=x, y=y, z=z, w=w)))
    assert ecm_values(message, "bag") == pytest.approx(values, abs=1e-9)


def test_set_up_joints_of_a_recording_are_kept(imported: Import, tmp_path: Path) -> None:
    """They are what `calibrate` of several arms compares the arms' bases with."""
    poses = {arm: moved(np.eye(4), [x, 0.2, 0.3, 0.4, 0.5, 0.6]) for arm, x in (("PSM1", -0.1), ("PSM2", 0.1))}
    of_setup = [
        Message(f"/SUJ/{arm}/{kind}measured_cp", "PoseStamped", BEGIN, {"pose": [*pose[:3, 3], *quaternion_xyzw(pose)]})
        for arm, pose in poses.items()
        for kind in ("", "local/")
    ]
    summary = imported(write_bag(tmp_path / "bag", "mcap", [*good(), *of_setup]))
    assert "set-up joints: of PSM1 PSM2, as suj-fixed.json" in summary["notes"]
    found = read_setup_joints(Path("session/suj-fixed.json"))
    for arm, pose in poses.items():
        np.testing.assert_allclose(found[arm], pose, atol=1e-12)
