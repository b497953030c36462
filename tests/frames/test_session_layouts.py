"""Sessions of other layouts, with readings by time, and with single unusable frames."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
from helpers.files import write_image
from helpers.places import bundled_path

from dvrk_cmaes import InputError, Session, read_frame, read_session

CAMERA = bundled_path("demo") / "camera.yaml"
MASK = np.zeros((480, 640), np.uint8)
MASK[100:200, 100:150] = 255


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Make a session of three frames with masks, and no readings yet."""
    root = tmp_path / "session"
    for name in ("0000", "0001", "0002"):
        write_image(root / "masks" / f"{name}.png", MASK)
    shutil.copy(CAMERA, root)
    return root


def published(root: Path, folder: str, number: int, readings: list[float], jaw: float = 0.5) -> Path:
    """Write a frame in the layout of published frames."""
    inside = root / folder
    write_image(inside / f"frame{number:04d}.png", np.dstack([MASK] * 3))
    write_image(inside / f"{number:05d}.jpg", MASK)
    np.save(inside / f"joint_{number:04d}.npy", np.array(readings))
    np.save(inside / f"jaw_{number:04d}.npy", np.array([jaw]))
    return inside


def jaws(session: Session) -> list[float | None]:
    return [frame.readings.get("jaw") for frame in session.frames]


def state(stamp: float, jaw: float) -> str:
    sec, rest = divmod(round(stamp * 1e9), 10**9)
    return f"header:\n  stamp:\n    sec: {sec}\n    nanosec: {rest}\nname:\n- jaw\nposition:\n- {jaw}\n---\n"


def test_folder_name_disambiguates_equal_numbers(tmp_path: Path) -> None:
    for name in ("a", "b"):
        published(tmp_path, name, 26, [0.0] * 6)
    assert [frame.name for frame in read_session(tmp_path, camera=CAMERA).frames] == ["a_0026", "b_0026"]


def test_damaged_reading_affects_its_frame_only(tmp_path: Path) -> None:
    published(tmp_path, "0", 26, [0.0] * 6)
    inside = published(tmp_path, "1", 27, [0.0] * 5)
    good, bad = read_session(tmp_path, camera=CAMERA).frames
    assert good.problem is None
    with pytest.raises(InputError, match=r"joint_0027\.npy: expected 6 values .*, got 5$"):
        read_frame(bad, read_session(inside, camera=CAMERA).camera)


def test_image_outside_recording_is_unusable(folder: Path) -> None:
    (folder / "joints.csv").write_text("time,jaw\n10.00,0.2\n10.04,0.4\n")
    (folder / "images.csv").write_text("frame,time\n0000,10.02\n0001,10.05\n")
    session = read_session(folder)
    assert jaws(session)[0] == pytest.approx(0.3)
    assert [frame.problem for frame in session.frames] == [
        None,
        f"{folder / 'joints.csv'}: frame 0001: jaw: expected readings before and after the image's time 10.050 s, "
        "within 0.05 s, got the nearest 0.010 s away",
        f"{folder / 'joints.csv'}: frame 0002: expected a column frame, or the image's time (images.csv of a session, "
        "--time of one frame; of a video, `dvrk-cmaes import`), to find its row among 2",
    ]
    (folder / "images.csv").write_text("frame,time\n0000,20.02\n")
    with pytest.raises(InputError, match="frame 0000: jaw: expected readings before and after"):
        read_session(folder)


def test_topic_dumps_are_found_by_name(folder: Path) -> None:
    (folder / "PSM1_jaw_measured_js.yaml").write_text(state(10.0, 0.2) + state(10.04, 0.4))
    (folder / "PSM1_measured_js.csv").write_text(
        "# Topic: /PSM1/measured_js\n# Type: sensor_msgs/msg/JointState\n"
        "timestamp,name.0,position.0\n10000000000,roll,0.1\n10050000000,roll,0.2\n"
    )
    (folder / "images.csv").write_text("frame,time\n0000,10.02\n0001,10.02\n0002,10.02\n")
    session = read_session(folder)
    assert session.frames[0].readings == pytest.approx({"jaw": 0.3, "roll": 0.14})
    assert "readings: JointState messages (YAML)" in session.notes


def test_frame_may_have_image_only(folder: Path) -> None:
    (folder / "joints.csv").write_text("frame,jaw\n0003,0.1\n")
    write_image(folder / "images" / "0003.png", np.dstack([MASK] * 3))
    session = read_session(folder)
    assert [frame.name for frame in session.frames] == ["0000", "0001", "0002", "0003"]
    assert (session.frames[3].mask, session.frames[3].readings) == (None, {"jaw": 0.1})
