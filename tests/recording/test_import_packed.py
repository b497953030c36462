"""``dvrk-cmaes import``: packed episodes of SurgSync, written with pyarrow."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pytest
from helpers.commands import run_command
from helpers.files import read_image
from helpers.made_clips import RIGHT_LATE, image_time, jaw_position, positions, write_file
from helpers.made_packed import COUNT, arm_table, times_table, write_packed, write_table
from helpers.made_recordings import ARM, pixels, write_video

from dvrk_cmaes import read_session

Import = Callable[..., dict[str, Any]]
Refused = Callable[..., str]


@pytest.fixture
def episode(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return write_packed(tmp_path / "online_data" / "episodes" / "stitch" / "2")


@pytest.fixture
def imported(episode: Path, capsys: pytest.CaptureFixture[str]) -> Import:
    """Import the episode into ``session``, and give the summary."""

    def go(*arguments: object) -> dict[str, Any]:
        ran = run_command(capsys, "import", episode, "--out", "session", "--json", *arguments)
        assert ran.code == 0, ran.err
        return dict(ran.result)

    return go


@pytest.fixture
def refused(episode: Path, capsys: pytest.CaptureFixture[str]) -> Refused:
    """Run an import that must be refused, check that nothing was written, and give the line on stderr."""

    def go(*arguments: object, source: Path = episode) -> str:
        line = run_command(capsys, "import", source, "--out", "session", *(arguments or ("--arm", "PSM1"))).refusal
        assert not Path("session").exists()
        return line

    return go


def images() -> list[np.ndarray]:
    frames = read_session("session").frames
    assert all(frame.image is not None for frame in frames)
    return [read_image(frame.image) for frame in frames if frame.image is not None]


@pytest.mark.parametrize("arm", ["PSM1", "PSM2"])
def test_readings_are_interpolated_to_images(imported: Import, arm: str) -> None:
    imported("--arm", arm)
    session = read_session("session")
    late = {"PSM1": 3_000_000, "PSM2": 7_000_000}[arm]
    assert dict(session.image_times) == {f"{k:06d}": image_time(k) for k in range(COUNT)}
    for k, frame in enumerate(session.frames):
        time = image_time(k) + (late if k == 0 else 0)  # the first image is earlier than all readings
        expected = {**dict(zip(ARM, positions(arm, time), strict=True)), "jaw": jaw_position(time)}
        assert frame.readings == pytest.approx(expected, abs=1e-6)
    for k, image in enumerate(images()):
        np.testing.assert_array_equal(image, pixels(k))


def test_right_eye_has_its_own_images_camera_and_times(imported: Import, episode: Path) -> None:
    columns = times_table()
    columns["delta_to_master.image_right_ns"] = pa.array([RIGHT_LATE, RIGHT_LATE, None, RIGHT_LATE], pa.int32())
    write_table(episode / "timestamp.parquet", columns)
    imported("--arm", "PSM1", "--side", "right")
    session = read_session("session")
    assert session.camera.fx == 81
    assert dict(session.image_times) == {f"{k:06d}": image_time(k) + RIGHT_LATE for k in (0, 1, 3)}
    for k, image in zip((0, 1, 3), images(), strict=True):
        np.testing.assert_array_equal(image, pixels(100 + k))
    time = image_time(3) + RIGHT_LATE
    readings = session.frames[2].readings
    assert readings["yaw"] == pytest.approx(positions("PSM1", time)[0], abs=1e-6)


def test_both_eyes_become_a_stereo_session(imported: Import) -> None:
    imported("--arm", "PSM2", "--side", "both")
    rig = read_session("session").rig
    assert rig.names == ("left", "right")
    np.testing.assert_allclose(rig.views[1].view_from_camera[:3, 3], [-0.005, 0, 0])


def test_rectified_images_need_a_camera_file(imported: Import, refused: Refused, episode: Path) -> None:
    shutil.rmtree(episode / "video_raw")
    (episode / "video").mkdir()
    write_video(episode / "video" / "stereo_left.mp4", COUNT, 10.0, "mp4v")
    assert "--camera: expected video_raw/stereo_left.mkv, or the camera file of the rectified images" in refused()
    notes = imported("--arm", "PSM1", "--camera", episode / "calibration" / "left.yaml")["notes"]
    assert "images: video/stereo_left.mp4 (rectified)" in notes


def test_arm_is_asked_for(refused: Refused) -> None:
    assert "--arm: expected the name of the arm to import, for this episode has PSM1, PSM2" in refused("--every", 1)
    assert "--arm: expected one of PSM1, PSM2, got 'PSM9'" in refused("--arm", "PSM9")


def test_release_is_refused_with_its_episodes(refused: Refused, tmp_path: Path) -> None:
    write_file(tmp_path / "meta" / "dataset.json", b"{}")
    said = refused("--arm", "PSM1", source=tmp_path)
    assert "expected the folder of one episode, one of online_data/episodes/stitch/2" in said


@pytest.mark.parametrize(
    ("table", "name", "values", "said"),
    [
        ("timestamp", "master_timestamp_ns", [0, 2, 1, 3], "master_timestamp_ns: expected increasing times"),
        ("timestamp", "master_timestamp_ns", [0, 1, None, 3], "expected a whole number of nanoseconds, got nothing"),
        ("timestamp", "master_timestamp_ns", list("abcd"), "expected a whole number of nanoseconds, got 'a'"),
        ("timestamp", "frame_index", [0, 1, 1, 2], "frame_index: expected the numbers from 0 on"),
        ("PSM1", "frame_index", [0, 1, 2, 9], "frame_index: expected the 4 rows of timestamp.parquet"),
        ("PSM1", "measured_js.position", [[0.1] * 3] * 4, "row 0: measured_js.position"),
        ("PSM1", "measured_js.position", [[0.1] * 6, [0.1] * 6, [0.1] * 5 + [float("nan")], [0.1] * 6], "row 2"),
        ("PSM1", "measured_js.position", ["a"] * 4, "row 0: measured_js.position"),
        ("PSM1", "measured_js.position", [None] * 4, "measured_js.position: expected readings"),
        ("PSM1", "jaw.measured_position", list("abcd"), "row 0: jaw.measured_position"),
    ],
)
def test_wrong_fields_are_refused_by_table_and_field(
    refused: Refused, episode: Path, table: str, name: str, values: list[Any], said: str
) -> None:
    columns = (times_table() if table == "timestamp" else arm_table(table)) | {name: values}
    write_table(episode / f"{table}.parquet", columns)
    line = refused()
    assert f"{table}.parquet: " in line
    assert said in line


def test_missing_field_is_refused_with_those_there(refused: Refused, episode: Path) -> None:
    columns = arm_table("PSM1")
    del columns["measured_js.position"]
    write_table(episode / "PSM1.parquet", columns)
    assert "PSM1.parquet: expected the fields measured_js.position, got frame_index, " in refused()


@pytest.mark.parametrize("damage", ["cut", "empty", "foot", "middle"])
@pytest.mark.parametrize("table", ["timestamp", "PSM1"])
def test_damaged_table_is_refused_by_name(refused: Refused, episode: Path, table: str, damage: str) -> None:
    path = episode / f"{table}.parquet"
    whole = path.read_bytes()
    half = len(whole) // 2
    damaged = {
        "cut": whole[:half],
        "empty": b"",
        "foot": whole[:-40] + b"\xff" * 32 + whole[-8:],
        "middle": whole[:4] + b"\xff" * half + whole[half + 4 :],
    }
    path.write_bytes(damaged[damage])
    line = refused()
    assert f"{path.name}: " in line
    assert "parquet file" in line


@pytest.mark.parametrize("wrong", [None, "now", 1.5, 2**63])
def test_wrong_start_is_refused(refused: Refused, episode: Path, wrong: Any) -> None:
    write_file(episode / "episode_meta.json", json.dumps({"master_t0_ns": wrong}).encode())
    assert "episode_meta.json: master_t0_ns: expected a whole number of nanoseconds" in refused()
