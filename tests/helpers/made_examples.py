"""A folder with everything that the commands of the reference pages read, under the names that they use."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
from scipy.spatial.transform import RigidTransform

from dvrk_cmaes.instrument.arm import base_from_root, root_from_tip
from helpers.made_clips import write_camera, write_clip
from helpers.made_recordings import good, write_bag, write_lerobot, write_video
from helpers.made_surgpose import made_arms, write_surgpose
from helpers.places import ROOT
from helpers.printed_blocks import run

FRAMES, EVERY = 30, 3
"""Frames of the recording that session is made of, and which of them it has."""
ARM_JOINTS = ("yaw", "pitch", "insertion", "roll", "wrist_pitch", "wrist_yaw")
SMALL_CAMERA = "width: 320\nheight: 240\nK: [512, 0, 160, 0, 512, 120, 0, 0, 1]\nD: [0, 0, 0, 0, 0]\n"
_BEGIN = 12.4
"""Time of the first image of suturing.mp4, s."""


def make_examples(folder: Path) -> Path:
    """Fill a new folder, which must be the working directory; some of it by commands of the program."""
    (folder / "data").symlink_to(ROOT / "data")
    _sessions(folder)
    _recordings(folder)
    return folder


def _sessions(folder: Path) -> None:
    """Make session, what was made of it, and a frame of two eyes."""
    small = folder / "small.yaml"
    small.write_text(SMALL_CAMERA)
    motion = f"--motion video --level easy --frames {FRAMES} --no-images --seed 5 --camera {small}"
    _run(f"synth session {motion}")
    for k in range(FRAMES):
        if k % EVERY:
            (folder / "session" / "masks" / f"{k:04d}.png").unlink()
    for command in (
        "batch session --out results",
        "calibrate session --results results --out calibrated",
        "track session",
        f"synth eyes --stereo --level easy --frames 1 --seed 4 --no-images --camera {small}",
    ):
        _run(command)
    images = ["frame,time", *(f"{k:04d},{k / 30!r}" for k in range(FRAMES))]
    (folder / "session" / "images.csv").write_text("\n".join(images) + "\n")
    labels = ["frame,marker,u,v", *(f"{frame:04d},{marker},160,120" for frame in (0, EVERY) for marker in (1, 2))]
    (folder / "session" / "markers.csv").write_text("\n".join(labels) + "\n")
    for name in ("before", "after"):
        shutil.copytree(folder / "results", folder / name)
    shutil.copytree(folder / "session", folder / "other", ignore=shutil.ignore_patterns("tracks"))
    for side in ("left", "right"):
        shutil.copy(folder / "eyes" / "masks" / side / "0000.png", folder / f"{side[0]}.png")
        shutil.copy(folder / "eyes" / f"{side}.yaml", folder)
    pose = "position: {x: 0.01, y: 0.02, z: 0.1}\norientation: {x: 0, y: 0, z: 0, w: 1}\n"
    (folder / "ecm.yaml").write_text(f"header: {{frame_id: ECM}}\npose:\n{_indented(pose)}")


def _run(command: str) -> None:
    ran = run(command)
    assert ran.code in (0, 3), (command, ran.err)


def _recordings(folder: Path) -> None:
    """Make the recordings that are imported."""
    write_bag(folder / "suturing.bag", "ros1", good())
    write_video(folder / "suturing.mp4", code="mp4v")
    write_camera(folder / "camera.yaml", 80.0)
    times = [k / 25 for k in range(20)]
    readings = [[*sweep_at(t), 0.5] for t in times]
    rows = list(zip(times, readings, strict=True))
    names = ["l", *(f"other{k}" for k in range(1, len(rows)))]  # the first is that of l.png, too
    lines = [f"{name},{_BEGIN + t!r},{','.join(map(repr, row))}" for name, (t, row) in zip(names, rows, strict=True)]
    (folder / "joints.csv").write_text("\n".join([f"frame,time,{','.join(ARM_JOINTS)},jaw", *lines]) + "\n")
    poses = []
    for t, row in rows:
        pose = RigidTransform.from_matrix(base_from_root(np.array(row[:4])) @ root_from_tip(*row[4:6]))
        poses.append([t, *pose.translation, *pose.rotation.as_quat(), row[6]])
    _table(folder / "poses.csv", ("time", "x", "y", "z", "qx", "qy", "qz", "qw", "jaw"), poses)
    videos = folder / "videos"
    videos.mkdir()
    for side in ("left", "right"):
        write_video(videos / f"{side}.mp4", code="mp4v")
        write_camera(videos / f"{side}.yaml", 80.0)
    _table(videos / "joints.csv", ("time", *ARM_JOINTS), [[t, *row[:6]] for t, row in rows])
    write_clip(folder / "online_data" / "2")
    (folder / "SurgPose").mkdir()
    write_surgpose(folder / "SurgPose" / "000000", made_arms(3))
    write_lerobot(folder / "dataset", readings[:10], episode=3)


def sweep_at(time: float) -> list[float]:
    """Give the readings of the six joints, which are linear in time, of a pose that the arm can take."""
    return [0.1 + 0.1 * time, 0.2, 0.12 + 0.01 * time, 0.3 * time, 0.3 - 0.2 * time, -0.2]


def _table(path: Path, names: tuple[str, ...], rows: list[list[float]]) -> None:
    lines = [",".join(names), *(",".join(repr(float(number)) for number in row) for row in rows)]
    path.write_text("\n".join(lines) + "\n")


def _indented(text: str) -> str:
    return "".join(f"  {line}\n" for line in text.splitlines())
