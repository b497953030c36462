"""``dvrk-cmaes import``: clips in SurgSync's raw layout, and folders with the videos of a stereo endoscope."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.commands import run_command
from helpers.files import read_image
from helpers.made_clips import image_time, jaw_position, kinematic, times, write_camera, write_clip
from helpers.made_recordings import ARM, SECOND, pixels, write_video

from dvrk_cmaes import read_session

ECM_JOINTS = ("ecm_yaw", "ecm_pitch", "ecm_insertion", "ecm_roll")

Import = Callable[..., dict[str, Any]]
Refused = Callable[..., str]


@pytest.fixture
def imported(tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> Import:
    """Import into ``session`` in an empty folder, and give the summary."""
    monkeypatch.chdir(tmp_path)

    def go(source: Path, *arguments: object) -> dict[str, Any]:
        ran = run_command(capsys, "import", source, "--out", "session", "--json", *arguments)
        assert ran.code == 0, ran.err
        return {**ran.result, "said": ran.err}

    return go


@pytest.fixture
def refused(tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> Refused:
    """Run an import that must be refused, check that nothing was written, and give the line on stderr."""
    monkeypatch.chdir(tmp_path)

    def go(source: Path, *arguments: object) -> str:
        line = run_command(capsys, "import", source, "--out", "session", *arguments).refusal
        assert not Path("session").exists()
        return line

    return go


# SurgSync's raw layout


def test_right_camera_is_chosen(imported: Import, tmp_path: Path) -> None:
    imported(write_clip(tmp_path / "clip"), "--arm", "PSM1", "--side", "right")
    session = read_session("session")
    assert session.camera.fx == 81
    image = session.frames[2].image
    assert image is not None
    assert np.array_equal(read_image(image), pixels(102))
    assert session.image_times["000002"] == image_time(2) + 1_000_000


def test_damaged_readings_of_the_endoscopes_arm_are_named_and_left_out(imported: Import, tmp_path: Path) -> None:
    clip = write_clip(tmp_path / "clip")
    (clip / "kinematic/ECM/1.json").write_text("{}")
    summary = imported(clip, "--arm", "PSM1")
    assert any("endoscope's arm is not read" in note and "ECM/1.json" in note for note in summary["notes"])
    assert set(read_session("session").frames[0].readings) == {*ARM, "jaw"}


def test_readings_far_from_their_image_are_omitted(imported: Import, tmp_path: Path) -> None:
    clip = write_clip(tmp_path / "clip", numbers=range(5))
    document = times(2)
    arm = document["Kinematics_set_1"]["PSM1"]
    arm["measured_data"]["measured_js_stamp"]["nsec"] += 60_000_000
    (clip / "time_syn/2.json").write_text(json.dumps(document))
    imported(clip, "--arm", "PSM1")
    found = [{*frame.readings} - {*ECM_JOINTS} for frame in read_session("session").frames[1:4]]
    assert found == [
        {*ARM, "jaw"},
        {"jaw"},
        {*ARM, "jaw"},
    ]


@pytest.mark.parametrize(
    ("document", "seconds"),
    [
        ({"timestamp": "1795000000_7"}, 1_795_000_000 * SECOND + 7),
        ({"image_left_stamp": {"secs": 1795000000, "nsecs": 5}}, 1_795_000_000 * SECOND + 5),
        ({"image_left": 1795000000.25}, 1_795_000_000 * SECOND + 250_000_000),
    ],
)
def test_other_forms_of_times_are_read(imported: Import, tmp_path: Path, document: Any, seconds: int) -> None:
    """Without times of their own, the readings are taken at the time of the image."""
    clip = write_clip(tmp_path / "clip", numbers=[0])
    (clip / "time_syn/0.json").write_text(json.dumps(document))
    imported(clip, "--arm", "PSM1")
    session = read_session("session")
    assert session.image_times["000000"] == seconds
    assert session.frames[0].readings["jaw"] == pytest.approx(jaw_position(image_time(0) + 3_000_000))


def test_readings_from_file_replace_those_of_clip(imported: Import, tmp_path: Path) -> None:
    clip = write_clip(tmp_path / "clip", numbers=range(2))
    table = tmp_path / "table.csv"
    table.write_text("time,jaw\n" + "".join(f"{image_time(k) / SECOND:.6f},0.{k + 5}\n" for k in range(2)))
    imported(clip, "--joints", table, "--tolerance", 0.2)
    assert "wrist_yaw" not in read_session("session").frames[1].readings


def test_wrong_clips_are_refused(refused: Refused, tmp_path: Path) -> None:
    clip = write_clip(tmp_path / "clip")
    assert refused(clip) == f"{clip}: --arm: expected the name of the arm to import, for this clip has PSM1, PSM2"
    assert refused(clip, "--arm", "PSM3") == f"{clip}: --arm: expected one of ECM, PSM1, PSM2, got 'PSM3'"
    assert refused(clip, "--arm", "ECM") == (
        f"{clip}/kinematic/ECM/0.json: measured_js: expected 6 values (yaw, pitch, insertion, roll, wrist_pitch, "
        "wrist_yaw), 1 (jaw) or all 7, got 4"
    )
    (clip / "image/left/1.png").write_bytes(b"no image")
    assert refused(clip, "--arm", "PSM1") == (
        f"{clip}/image/left/1.png: expected an image (PNG or JPEG), got something else or a damaged file"
    )
    said = refused(clip, "--arm", "PSM1", "--image-topic", "/left")
    assert said == f"{clip}: --image-topic: expected a ROS recording with it, got a clip of SurgSync"


@pytest.mark.parametrize(
    ("file", "text", "expected"),
    [
        ("kinematic/PSM1/1.json", "[{}]", "measured_js: expected an object with position, a list of numbers, got none"),
        (
            "kinematic/PSM1/1.json",
            json.dumps(kinematic("PSM1", 10**12 + image_time(0), "online")),
            "yaw: expected radians (at most 2 pi), got 1000.1: this looks like degrees",
        ),
        ("kinematic/PSM1/1.json", "{", "expected the readings of an arm (kinematic, JSON), got no valid JSON"),
        ("time_syn/1.json", "{}", "image_left_stamp: expected the image's time (sec, nsec), got none"),
        (
            "time_syn/1.json",
            '{"image_left_stamp": {"sec": 1.5, "nsec": 0}}',
            "image_left_stamp: expected whole seconds and nanoseconds, got {'sec': 1.5, 'nsec': 0}",
        ),
    ],
)
def test_wrong_files_of_frame_are_refused(
    refused: Refused, tmp_path: Path, file: str, text: str, expected: str
) -> None:
    clip = write_clip(tmp_path / "clip")
    (clip / file).write_text(text)
    assert refused(clip, "--arm", "PSM1").startswith(f"{clip}/{file}: {expected}")


def test_missing_parts_of_clip_are_named(refused: Refused, tmp_path: Path) -> None:
    clip = write_clip(tmp_path / "clip")
    (clip / "time_syn/3.json").unlink()
    assert refused(clip, "--arm", "PSM1").startswith(f"{clip}/time_syn/3.json: no such file; expected the times")
    (clip / "camera_calibration/right.yaml").unlink()
    (clip / "time_syn/3.json").write_text(json.dumps(times(3)))
    assert refused(clip, "--arm", "PSM1", "--side", "right").startswith(
        f"{clip}/camera_calibration/right.yaml: no such"
    )
    for path in (clip / "image/left").iterdir():
        path.unlink()
    assert refused(clip, "--arm", "PSM1") == f"{clip}/image/left: expected images N.png, got none"


# stereo videos


def stereo_folder(path: Path) -> Path:
    """Write the videos of both eyes; the right one has twice as many frames."""
    path.mkdir()
    write_video(path / "suturing_left.avi")
    write_video(path / "suturing_right.avi", frames=20)
    for side, focal in (("left", 80.0), ("right", 81.0)):
        write_camera(path / f"{side}.yaml", focal)
    rows = [f"{0.02 * k:.2f},{0.01 * k:.2f}" for k in range(60)]
    (path / "joints.csv").write_text("\n".join(["time,jaw", *rows]))
    return path


def test_camera_readings_and_start_of_stereo_videos_may_be_given(imported: Import, tmp_path: Path) -> None:
    folder = stereo_folder(tmp_path / "videos")
    camera = (folder / "left.yaml").rename(tmp_path / "other.yaml")
    (folder / "joints.csv").rename(tmp_path / "table.csv")
    arguments = ("--camera", camera, "--joints", tmp_path / "table.csv", "--video-start", 0.2)
    imported(folder, *arguments)
    assert read_session("session").frames[0].readings["jaw"] == pytest.approx(0.1)


def test_wrong_stereo_folders_are_refused(refused: Refused, tmp_path: Path) -> None:
    folder = stereo_folder(tmp_path / "videos")
    assert refused(folder, "--arm", "PSM1") == (
        f"{folder}: --arm: expected a LeRobot data set or a folder of SurgPose or an episode of SurgSync or a clip of "
        "SurgSync or a ROS recording with it, got stereo videos"
    )
    write_video(folder / "left_2.avi")
    assert (
        refused(folder) == f"{folder}: expected one video of the left eye, got several: left_2.avi, suturing_left.avi"
    )
    (folder / "left_2.avi").unlink()
    (folder / "joints.csv").unlink()
    assert refused(folder).endswith(
        "suturing_left.avi: --joints: a video needs a camera file and a table of readings; got none"
    )
    (folder / "suturing_right.avi").unlink()
    assert refused(folder, "--side", "right").startswith(
        f"{folder}: expected a recording, got a folder: one of pictures"
    )
