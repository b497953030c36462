"""``dvrk-cmaes import --pose-of``: readings of a recording that has only the Cartesian poses of its arm."""

from __future__ import annotations

import csv
import json
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from helpers.commands import Ran, run_command
from helpers.made_recordings import write_video
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from dvrk_cmaes import read_results, read_session
from dvrk_cmaes.instrument.arm import base_from_root, root_from_tip

pytestmark = pytest.mark.usefixtures("searches_short", "tasks_here", "estimates_shared")

Import = Callable[..., Ran]
REFERENCE_FROM_BASE = RigidTransform.from_exp_coords([0.3, -0.4, 0.2, 0.1, -0.2, 0.3])
NAMES = ("yaw", "pitch", "insertion", "roll", "wrist_pitch", "wrist_yaw")


def joints(k: int) -> NDArray[np.float64]:
    """Give the joints at the time of image k of the video; roll passes half a turn."""
    return np.array([0.1 + 0.01 * k, 0.2, 0.12 + 0.001 * k, 3.0 + 0.05 * k, 0.3 - 0.02 * k, -0.2])


@pytest.fixture
def imported(tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> Import:
    """Import a video whose readings are a table of poses in the arm's base (local.csv) or a cart's (cart.csv)."""
    monkeypatch.chdir(tmp_path)
    write_video(tmp_path / "video.avi")
    Path("camera.yaml").write_text("width: 64\nheight: 48\nK: [70, 0, 32, 0, 70, 24, 0, 0, 1]\nD: []\n")
    for name, reference in (("local.csv", RigidTransform.identity()), ("cart.csv", REFERENCE_FROM_BASE)):
        lines = ["time,x,y,z,qx,qy,qz,qw,jaw"]
        for k in range(10):
            tip = base_from_root(joints(k)[:4]) @ root_from_tip(*joints(k)[4:])
            pose = reference * RigidTransform.from_matrix(tip)
            numbers = [k / 25, *pose.translation, *pose.rotation.as_quat(), 0.5]
            lines.append(",".join(repr(float(number)) for number in numbers))
        Path(name).write_text("\n".join(lines) + "\n")
    rows = "\n".join(f"  - {row}" for row in REFERENCE_FROM_BASE.as_matrix().tolist())
    Path("base.yaml").write_text(f"measured_cp:\n{rows}\n")
    arguments = ("import", "video.avi", "--camera", "camera.yaml", "--out", "session")
    return lambda *more: run_command(capsys, *arguments, *more)


@pytest.mark.parametrize(("table", "base"), [("local.csv", "local"), ("cart.csv", "base.yaml")])
@pytest.mark.parametrize("point", ["tip", "wrist-yaw"])  # at one place for this tool, whose tip offset is zero
def test_readings_are_the_joints_of_the_poses(imported: Import, table: str, base: str, point: str) -> None:
    ran = imported("--joints", table, "--pose-of", point, "--pose-base", base)
    assert ran.code == 0
    assert f"{table} (inverse kinematics of poses of the {point}, classic arm)" in " ".join(ran.out.split())
    frames = read_session("session").frames
    assert len(frames) == 10
    for k, frame in enumerate(frames):
        expected = dict(zip(NAMES, joints(k), strict=True)) | {"jaw": 0.5}
        assert frame.readings == pytest.approx(expected, abs=1e-6)


@pytest.mark.parametrize(
    ("more", "message"),
    [
        (("--pose-of", "tip"), "--pose-base: expected local"),
        (("--pose-base", "local"), "--pose-of: expected tip or wrist-yaw"),
    ],
)
def test_point_and_frame_are_asked_for(imported: Import, more: tuple[str, ...], message: str) -> None:
    ran = imported("--joints", "local.csv", *more)
    assert ran.code == 2
    assert message in ran.err


def test_a_quaternion_that_is_no_rotation_is_refused(imported: Import) -> None:
    Path("local.csv").write_text("time,x,y,z,qx,qy,qz,qw\n0,0,0,0.1,0,0,0,2\n")
    ran = imported("--joints", "local.csv", "--pose-of", "tip", "--pose-base", "local")
    assert ran.code == 2
    assert "local.csv: line 2: qx: expected a unit quaternion" in ran.err


def test_poses_beyond_the_limits_of_the_tool_are_counted(imported: Import) -> None:
    joint = {"type": "revolute", "alpha": 0, "A": 0, "theta": 0, "D": 0, "mode": "active"}
    limits = {"roll": (-9.0, 9.0), "wrist_pitch": (0.2, 1.5), "wrist_yaw": (-1.4, 1.4)}
    rows = [joint | {"name": name, "qmin": low, "qmax": high} for name, (low, high) in limits.items()]
    rows[0]["D"], rows[2]["A"] = 0.4162, 0.0091
    offset = [[0, -1, 0, 0], [0, 0, 1, 0], [-1, 0, 0, 0], [0, 0, 0, 1]]
    document = {"DH": {"convention": "modified", "joints": rows}, "tooltip_offset": offset}
    Path("tool.json").write_text(json.dumps(document))
    ran = imported("--joints", "local.csv", "--pose-of", "tip", "--pose-base", "local", "--tool", "tool.json")
    assert ran.code == 0
    assert "4 of 10 poses are not reached, e.g. wrist_pitch" in " ".join(ran.out.split())


def test_session_with_poses_alone_gives_the_results_of_one_with_joints(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    camera = "width: 400\nheight: 300\nK: [640, 0, 200, 0, 640, 150, 0, 0, 1]\nD: [0, 0, 0, 0, 0]\n"
    Path("camera.yaml").write_text(camera)
    made = "synth made --motion video --level easy --frames 4 --seed 5 --camera camera.yaml --mp4"
    assert run_command(capsys, *made.split()).code == 0
    with open("made/joints.csv", newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    lines = ["time,x,y,z,qx,qy,qz,qw,jaw"]
    for row in rows:
        own = [float(row[name]) for name in NAMES]
        pose = RigidTransform.from_matrix(base_from_root(np.array(own[:4])) @ root_from_tip(*own[4:]))
        numbers = [row["time"], *pose.translation, *pose.rotation.as_quat(), row["jaw"]]
        lines.append(",".join(repr(float(number)) for number in numbers))
    Path("poses.csv").write_text("\n".join(lines) + "\n")
    poses = ("poses.csv", "--pose-of", "tip", "--pose-base", "local")
    for name, joints in (("joints", ("made/joints.csv",)), ("poses", poses)):
        source = ("import", "made/video.mp4", "--camera", "made/camera.yaml", "--joints", *joints, "--out", name)
        assert run_command(capsys, *source).code == 0
        Path(name, "masks").mkdir()
        images, masks = sorted(Path(name, "images").iterdir()), sorted(Path("made/masks").iterdir())
        for image, mask in zip(images, masks, strict=True):
            shutil.copy(mask, Path(name, "masks", image.stem + ".png"))
        assert run_command(capsys, "batch", name, "--out", f"{name}-results").code in (0, 3)
    results = [list(read_results(f"{name}-results").frames.values()) for name in ("joints", "poses")]
    assert [int(result.frame) for result in results[0]] == [int(result.frame) for result in results[1]]
    for one, other in zip(*results, strict=True):
        assert one.status == other.status
        assert one.readings == pytest.approx(other.readings, abs=1e-6)
        assert one.tips is not None
        assert other.tips is not None
        assert np.asarray(one.tips) == pytest.approx(np.asarray(other.tips), abs=1e-5)
        assert one.camera_from_root is not None
        assert other.camera_from_root is not None
        assert one.camera_from_root[:3, 3] == pytest.approx(other.camera_from_root[:3, 3], abs=1e-5)  # 0.01 mm
