"""``dvrk-cmaes import`` of LeRobot data sets, v2.1 and v3.0, written with pyarrow."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from helpers.commands import Ran, run_command
from scipy.spatial.transform import RigidTransform

from dvrk_cmaes import read_session
from dvrk_cmaes.instrument.arm import OUTER_JOINTS, base_from_root, root_from_tip

KEY = "observation.images.left"
NAMES = ["PSM1.outer_yaw", "psm1_pitch", *(f"psm1_joint_{k}" for k in range(3, 7)), "psm1_jaw", "psm2_yaw", "force"]
FRAMES = 4  # of each of two episodes
Import = Callable[..., Ran]


def state(episode: int, k: int) -> list[float]:
    return [0.1 * place + 0.01 * k + 0.05 * episode for place in range(len(NAMES))]


def write_video(path: Path, greys: list[int]) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    writer = cv2.VideoWriter(str(path), cv2.CAP_FFMPEG, cv2.VideoWriter.fourcc(*"mp4v"), 10, (64, 48))
    for grey in greys:
        writer.write(np.full((48, 64, 3), grey, np.uint8))
    writer.release()


def write_table(path: Path, columns: dict[str, list[object]]) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    pq.write_table(pa.table(columns), path)


def rows(*episodes: int) -> dict[str, list[object]]:
    pairs = [(episode, k) for episode in episodes for k in range(FRAMES)]
    return {
        "episode_index": [episode for episode, _ in pairs],
        "frame_index": [k for _, k in pairs],
        "timestamp": [k / 10 for _, k in pairs],
        "observation.state": [state(*pair) for pair in pairs],
    }


def write_info(folder: Path, version: str, names: object = NAMES) -> None:
    part = "chunk-{chunk_index:03d}/file-{file_index:03d}"
    old = "chunk-{episode_chunk:03d}/"
    paths = {
        "v2.1": (
            f"data/{old}episode_{{episode_index:06d}}.parquet",
            f"videos/{old}{{video_key}}/episode_{{episode_index:06d}}.mp4",
        ),
        "v3.0": (f"data/{part}.parquet", f"videos/{{video_key}}/{part}.mp4"),
    }.get(version, ("", ""))
    features = {"observation.state": {"names": names}, KEY: {"dtype": "video"}}
    info = {"codebase_version": version, "fps": 10, "data_path": paths[0], "video_path": paths[1], "features": features}
    (folder / "meta").mkdir(parents=True, exist_ok=True)
    (folder / "meta" / "info.json").write_text(json.dumps(info))


@pytest.fixture(params=["v2.1", "v3.0"])
def made(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    """Give a set of two episodes, whose images get brighter from frame to frame."""
    folder = tmp_path / "set"
    write_info(folder, request.param)
    greys = [[100 * episode + 20 * k for k in range(FRAMES)] for episode in range(2)]
    if request.param == "v2.1":
        for k in range(2):
            write_table(folder / f"data/chunk-000/episode_{k:06d}.parquet", rows(k))
            write_video(folder / f"videos/chunk-000/{KEY}/episode_{k:06d}.mp4", greys[k])
        return folder
    write_table(folder / "data/chunk-000/file-000.parquet", rows(0, 1))
    write_video(folder / f"videos/{KEY}/chunk-000/file-000.mp4", greys[0] + greys[1])
    video = {f"videos/{KEY}/{name}_index": [0, 0] for name in ("chunk", "file")}
    episodes = {"episode_index": [0, 1], "data/chunk_index": [0, 0], "data/file_index": [0, 0], **video}
    episodes[f"videos/{KEY}/from_timestamp"] = [0.0, FRAMES / 10]  # type: ignore[list-item]
    write_table(folder / "meta/episodes/chunk-000/file-000.parquet", episodes)  # type: ignore[arg-type]
    return folder


@pytest.fixture
def imported(made: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> Import:
    monkeypatch.chdir(made.parent)
    Path("camera.yaml").write_text("width: 64\nheight: 48\nK: [70, 0, 32, 0, 70, 24, 0, 0, 1]\nD: []\n")
    return lambda *more: run_command(
        capsys, "import", "set", "--out", "session", *(more or ("--arm", "PSM1", "--camera", "camera.yaml"))
    )


def test_arm_camera_and_episode_are_asked_for(imported: Import) -> None:
    assert "--camera: expected a camera file" in imported("--arm", "PSM1").refusal
    assert "--arm: expected one of PSM1, PSM2" in imported("--camera", "camera.yaml").refusal
    assert "--arm: expected one of PSM1, PSM2, got ECM" in imported("--camera", "camera.yaml", "--arm", "ECM").refusal
    imported("--arm", "PSM1", "--camera", "camera.yaml", "--episode", 7).refusal  # noqa: B018


def test_unknown_names_are_refused_with_their_list(imported: Import, made: Path) -> None:
    version = json.loads((made / "meta/info.json").read_text())["codebase_version"]
    write_info(made, version, {"motors": ["psm1_x", "force"]})
    assert "expected names of joints such as PSM1.yaw, got psm1_x, force" in imported().refusal


def test_missing_pyarrow_is_one_line(imported: Import, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    assert imported().refusal.endswith("-m pip install 'pyarrow<27,>=18'")


def table_of(made: Path) -> Path:
    return min((made / "data").rglob("*.parquet"))


@pytest.mark.parametrize("wrong", [None, float("nan"), -1.0])
def test_time_that_is_none_is_refused_by_file_and_field(imported: Import, made: Path, wrong: float | None) -> None:
    columns = rows(0, 1)
    columns["timestamp"][1] = wrong
    write_table(table_of(made), columns)
    said = imported().refusal
    assert f"{table_of(made).name}: timestamp: expected a number of at least 0, got " in said


def test_text_as_time_is_refused_by_file_and_field(imported: Import, made: Path) -> None:
    write_table(table_of(made), rows(0, 1) | {"timestamp": ["now"] * 2 * FRAMES})
    assert f"{table_of(made).name}: timestamp: expected a number of at least 0, got 'now'" in imported().refusal


def test_video_start_is_refused(imported: Import) -> None:
    said = imported("--arm", "PSM1", "--camera", "camera.yaml", "--video-start", "2").refusal
    assert "--video-start: expected stereo videos or a video with it, got a LeRobot data set" in said


@pytest.mark.parametrize("damage", ["cut", "empty", "foot", "middle"])
def test_damaged_table_is_refused_by_name(imported: Import, made: Path, damage: str) -> None:
    path = table_of(made)
    whole = path.read_bytes()
    half = len(whole) // 2
    damaged = {
        "cut": whole[:half],
        "empty": b"",
        "foot": whole[:-40] + b"\xff" * 32 + whole[-8:],
        "middle": whole[:4] + b"\xff" * half + whole[half + 4 :],
    }
    path.write_bytes(damaged[damage])
    said = imported().refusal
    assert f"{path.name}: " in said
    assert "parquet file" in said


@pytest.mark.parametrize("key", ["data_path", "video_path"])
@pytest.mark.parametrize("template", ["../{video_key}", "/etc/passwd", "data/../../other", "link/outside", "a\0b"])
def test_paths_that_leave_the_folder_are_refused(imported: Import, made: Path, key: str, template: str) -> None:
    if template.startswith("link"):
        (made / "link").symlink_to(made.parent)
    file = made / "meta" / "info.json"
    info = json.loads(file.read_text())
    file.write_text(json.dumps(info | {key: template.replace("{video_key}", KEY)}))
    said = imported().refusal
    assert f"info.json: {key}: expected a path within the folder, got " in said or "got a link that leaves it" in said


@pytest.mark.parametrize(
    "names",
    [
        [*(f"psm1_pose.position.{a}" for a in "xyz"), *(f"psm1_pose.orientation.{a}" for a in "xyzw"), "psm1_jaw"],
        [*(f"psm1_pos_{a}" for a in "xyz"), *(f"psm1_quat_{a}" for a in "xyzw"), "psm1_jaw"],
    ],
)
@pytest.mark.parametrize("base", ["local", "base.yaml"])
def test_joints_of_poses_are_found(imported: Import, made: Path, names: list[str], base: str) -> None:
    table = next(path for path in sorted((made / "data").rglob("*.parquet")))
    reference = RigidTransform.identity() if base == "local" else RigidTransform.from_exp_coords([0.3, 0, 0, 0.1, 0, 0])
    columns = pq.read_table(table).to_pydict()
    joints = [np.array([0.1, 0.2, 0.12, 0.4, 0.3, -0.2]) + 0.01 * k for k in columns["frame_index"]]
    columns["observation.state"] = []
    for own in joints:
        pose = reference * RigidTransform.from_matrix(base_from_root(own[:4]) @ root_from_tip(*own[4:]))
        columns["observation.state"].append([*pose.translation.tolist(), *pose.rotation.as_quat().tolist(), 0.5])
    write_table(table, columns)
    write_info(made, json.loads((made / "meta/info.json").read_text())["codebase_version"], names)
    rows = "\n".join(f"  - {row}" for row in reference.as_matrix().tolist())
    Path("base.yaml").write_text(f"measured_cp:\n{rows}\n")
    more = () if base == "local" else ("--pose-of", "tip", "--pose-base", base)
    ran = imported("--arm", "PSM1", "--camera", "camera.yaml", *more)
    assert ran.code == 0, ran.err
    said = " ".join(ran.out.split())
    assert "inverse kinematics of poses of the tip" in said
    assert names[0] in said
    assert ("--pose-base says otherwise" in said) == (base == "local")
    for files, own in zip(read_session("session").frames, joints, strict=False):
        expected = dict(zip((*OUTER_JOINTS, "wrist_pitch", "wrist_yaw", "jaw"), (*own, 0.5), strict=True))
        assert files.readings == pytest.approx(expected, abs=1e-6)
