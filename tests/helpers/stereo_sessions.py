"""Small stereo sessions with exact masks of known poses."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import yaml

from dvrk_cmaes import Body, Camera, Renderer
from helpers.transforms import lookat_pose, transform

CAMERA = Camera(160, 120, 256.0, 256.0, 79.5, 59.5)
BASELINE = 0.0053
RIGHT_FROM_LEFT = transform(np.eye(3), [-BASELINE, 0.0, 0.0])
JOINTS = {"wrist_pitch": 0.4, "wrist_yaw": -0.3, "jaw": 0.5}
POSES = {"0000": lookat_pose(0.5, 1.0, 0.7, 0.11), "0001": lookat_pose(0.6, 0.3, 0.5, 0.12)}


def camera_info(baseline: float = 0.0) -> dict[str, Any]:
    """Give the camera_info of an eye of the session, whose images are rectified."""
    projection = np.c_[CAMERA.matrix, [-CAMERA.fx * baseline, 0.0, 0.0]]
    return {
        "image_width": CAMERA.width,
        "image_height": CAMERA.height,
        "camera_matrix": {"rows": 3, "cols": 3, "data": CAMERA.matrix.ravel().tolist()},
        "distortion_model": "plumb_bob",
        "distortion_coefficients": {"rows": 1, "cols": 5, "data": [0.0] * 5},
        "rectification_matrix": {"rows": 3, "cols": 3, "data": np.eye(3).ravel().tolist()},
        "projection_matrix": {"rows": 3, "cols": 4, "data": projection.ravel().tolist()},
    }


def make_stereo_session(folder: Path, body: Body) -> Path:
    """Write a session of two frames seen by two eyes; returns the folder."""
    for side, baseline in (("left", 0.0), ("right", BASELINE)):
        (folder / "masks" / side).mkdir(parents=True)
        (folder / f"{side}.yaml").write_text(yaml.safe_dump(camera_info(baseline)), encoding="utf-8")
        renderer = Renderer(body, CAMERA, threads=1)
        for name, pose in POSES.items():
            seen = pose if side == "left" else RIGHT_FROM_LEFT @ pose
            mask = renderer.masks(seen[None], np.array([list(JOINTS.values())]))[0]
            (folder / "masks" / side / f"{name}.png").write_bytes(
                cv2.imencode(".png", mask.astype(np.uint8) * 255)[1].tobytes()
            )
    rows = [",".join(["frame", *JOINTS]), *(",".join([name, *map(str, JOINTS.values())]) for name in POSES)]
    (folder / "joints.csv").write_text("\n".join(rows) + "\n", encoding="utf-8")
    golden = {"frames": {name: {"T_camera_roll_link": pose.tolist(), "joints": JOINTS} for name, pose in POSES.items()}}
    (folder / "golden.json").write_text(json.dumps(golden), encoding="utf-8")
    return folder


SECOND_POSES = {"0000": lookat_pose(0.5, 2.0, -0.75, 0.12), "0001": lookat_pose(0.55, 1.2, -0.7, 0.13)}
SECOND_JOINTS = {"wrist_pitch": -0.5, "wrist_yaw": 0.4, "jaw": 0.9}


def make_session_of_two_tools(folder: Path, body: Body) -> Path:
    """Write a session of two arms in masks of labels."""
    (folder / "masks").mkdir(parents=True)
    (folder / "camera.yaml").write_text(yaml.safe_dump(camera_info()), encoding="utf-8")
    renderer = Renderer(body, CAMERA, threads=1)
    for name in POSES:
        first, second = (
            renderer.masks(transform(np.eye(3), shift) @ poses[name][None], np.array([list(joints.values())]))[0]
            for poses, joints, shift in ((POSES, JOINTS, [-0.012, 0, 0]), (SECOND_POSES, SECOND_JOINTS, [0.012, 0, 0]))
        )
        labels = np.where(first, 1, np.where(second, 2, 0)).astype(np.uint8)
        (folder / "masks" / f"{name}.png").write_bytes(cv2.imencode(".png", labels)[1].tobytes())
    lines = ['[camera]\nfile = "camera.yaml"']
    for number, joints in enumerate((JOINTS, SECOND_JOINTS), start=1):
        rows = [",".join(["frame", *joints]), *(",".join([name, *map(str, joints.values())]) for name in POSES)]
        (folder / f"joints_{number}.csv").write_text("\n".join(rows) + "\n", encoding="utf-8")
        lines.append(f'[[tool]]\narm = "PSM{number}"\ninstrument = "lnd"\nlabel = {number}')
        lines.append(f'joints = "joints_{number}.csv"')
    (folder / "session.toml").write_text("\n".join(lines) + "\n", encoding="utf-8")
    return folder
