"""Small clips in SurgSync's raw layout, as its online and its offline recorder write them."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal

import cv2
import numpy as np

from helpers.made_recordings import BEGIN, HEIGHT, SECOND, WIDTH, pixels, sweep

Recorder = Literal["online", "offline"]

ARMS = ("ECM", "PSM1", "PSM2")
LATE = {"PSM1": 3_000_000, "PSM2": 7_000_000}
"""How much later than the left images the readings are, ns."""

RIGHT_LATE = 1_000_000


def image_time(number: int) -> int:
    """Give the time of a left image, ns; images come at 10 Hz."""
    return BEGIN + number * SECOND // 10


def positions(arm: str, time: int) -> list[float]:
    """Give readings that are linear in time, other ones for each arm."""
    return [value + (0.05 if arm == "PSM2" else 0.0) for value in sweep(time)]


def jaw_position(time: int) -> float:
    return 0.2 + 0.3 * (time - BEGIN) / SECOND


def stamp(time: int) -> dict[str, int]:
    return {"sec": time // SECOND, "nsec": time % SECOND}


def kinematic(arm: str, time: int, recorder: Recorder) -> list[dict[str, Any]]:
    """Give the document of an arm's readings."""
    cartesian = {"position": [0.0, 0.0, 0.1], "orientation": [0.0, 0.0, 0.0, 1.0]}
    values = positions(arm, time)
    joints = {"position": values[:4] if arm == "ECM" else values, "velocity": [], "effort": []}
    commanded = {"position": [9.0] * len(joints["position"])}
    inner: dict[str, Any] = {
        "measured_data": {"measured_js": joints, "measured_cp": cartesian, "local_measured_cp": cartesian},
        "setpoint_data": {"setpoint_js": commanded},
    }
    if recorder == "online":
        inner["setpoint_data"]["setpoint_cp"] = cartesian
    document: dict[str, Any] = {"arm": inner}
    if arm != "ECM":
        (document if recorder == "online" else inner)["jaw"] = {
            "setpoint_data": {"position": [9.0]},
            "measured_data": {"position": [jaw_position(time)]},
        }
    return [document]


def times(number: int) -> dict[str, Any]:
    """Give the document of a frame's times."""
    now = image_time(number)
    arms = {
        arm: {
            "measured_data": {"measured_js_stamp": stamp(now + LATE.get(arm, 0)), "measured_cp_stamp": stamp(now)},
            "setpoint_data": {"setpoint_js_stamp": stamp(now)},
            "jaw": {"measured_stamp": stamp(now + LATE.get(arm, 0)), "setpoint_stamp": stamp(now)},
        }
        for arm in ARMS
    }
    return {
        "Kinematics_set_1": arms,
        "frame": number,
        "image_left_stamp": stamp(now),
        "image_right_stamp": stamp(now + RIGHT_LATE),
        "side_image_1_stamp": stamp(now),
    }


def write_camera(path: Path, focal: float) -> None:
    """Write a camera file of ROS."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(
        f"image_width: {WIDTH}\nimage_height: {HEIGHT}\ncamera_name: {path.stem}\n"
        f"camera_matrix: {{rows: 3, cols: 3, data: [{focal}, 0, 31.5, 0, {focal}, 22.0, 0, 0, 1]}}\n"
        "distortion_model: plumb_bob\ndistortion_coefficients: {rows: 1, cols: 5, data: [0, 0, 0, 0, 0]}\n"
    )


def write_clip(
    path: Path, recorder: Recorder = "online", numbers: Sequence[int] = range(4), arms: Sequence[str] = ARMS
) -> Path:
    """Write a clip; the right image of frame N has the pixels of number 100 + N."""
    for number in numbers:
        for side, first in (("left", 0), ("right", 100)):
            write_file(
                path / "image" / side / f"{number}.png", cv2.imencode(".png", pixels(first + number))[1].tobytes()
            )
        for arm in arms:
            document = kinematic(arm, image_time(number) + LATE.get(arm, 0), recorder)
            write_file(path / "kinematic" / arm / f"{number}.json", json.dumps(document).encode())
        write_file(path / "time_syn" / f"{number}.json", json.dumps(times(number)).encode())
    for side, focal in (("left", 80.0), ("right", 81.0)):
        write_camera(path / "camera_calibration" / f"{side}.yaml", focal)
    for convention in ("dVRK", "open-cv"):
        entry = {"base-frame": {"reference-frame": "left", "transform": np.eye(4).tolist()}}
        write_file(path / "hand_eye_calibration" / f"PSM1-registration-{convention}.json", json.dumps(entry).encode())
    write_file(path / "meta_data.json", b'{"user_id": 1}')
    return path


def write_file(path: Path, data: bytes) -> None:
    """Write a file in a folder that need not exist."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(data)
