"""Small packed episodes of SurgSync: the fields of the published schemas that matter here, and some others."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from helpers.made_clips import LATE, RIGHT_LATE, image_time, jaw_position, positions, write_camera, write_file
from helpers.made_recordings import BEGIN, HEIGHT, WIDTH, pixels

COUNT = 4


def write_ffv1(path: Path, numbers: Sequence[int]) -> None:
    """Write images without loss."""
    path.parent.mkdir(parents=True, exist_ok=True)
    writer = cv2.VideoWriter(str(path), cv2.CAP_FFMPEG, cv2.VideoWriter.fourcc(*"FFV1"), 10, (WIDTH, HEIGHT))
    assert writer.isOpened()
    for number in numbers:
        writer.write(pixels(number))
    writer.release()


def times_table(count: int = COUNT) -> dict[str, Any]:
    """Columns of timestamp.parquet."""
    columns: dict[str, Any] = {
        "frame_index": pa.array(range(count), pa.int32()),
        "source_frame_index": pa.array(range(count), pa.int32()),
        "master_timestamp_ns": pa.array([image_time(k) - BEGIN for k in range(count)], pa.int64()),
        "delta_to_master.image_right_ns": pa.array([RIGHT_LATE] * count, pa.int32()),
        "is_contiguous_to_prev": [True] * count,
    }
    for arm, late in LATE.items():
        for topic in ("measured_js", "measured_cp", "jaw_measured"):
            columns[f"delta_to_master.{arm}.{topic}_ns"] = pa.array([late] * count, pa.int32())
    return columns


def arm_table(arm: str, count: int = COUNT) -> dict[str, Any]:
    """Columns of an arm's table."""
    moments = [image_time(k) + LATE[arm] for k in range(count)]
    return {
        "frame_index": pa.array(range(count), pa.int32()),
        "master_timestamp_ns": pa.array([image_time(k) - BEGIN for k in range(count)], pa.int64()),
        "measured_cp.position": pa.array([[0.0, 0.0, 0.1]] * count, pa.list_(pa.float32())),
        "measured_js.position": pa.array([positions(arm, time) for time in moments], pa.list_(pa.float32())),
        "setpoint_js.position": pa.array([[9.0] * 6] * count, pa.list_(pa.float32())),
        "jaw.measured_position": pa.array([jaw_position(time) for time in moments], pa.float32()),
    }


def write_table(path: Path, columns: dict[str, Any]) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    pq.write_table(pa.table(columns), path)


def write_packed(path: Path, arms: Sequence[str] = ("PSM1", "PSM2"), count: int = COUNT) -> Path:
    """Write an episode; the right image of frame N has the pixels of number 100 + N."""
    write_table(path / "timestamp.parquet", times_table(count))
    for arm in arms:
        write_table(path / f"{arm}.parquet", arm_table(arm, count))
    write_table(path / "annotation.parquet", {"frame_index": list(range(count)), "phase": ["Suturing"] * count})
    for side, first in (("left", 0), ("right", 100)):
        write_ffv1(path / "video_raw" / f"stereo_{side}.mkv", [first + k for k in range(count)])
    for side, focal in (("left", 80.0), ("right", 81.0)):
        write_camera(path / "calibration" / f"{side}.yaml", focal)
    stereo = {"R": np.eye(3).tolist(), "T": [[-0.005], [0.0], [0.0]]}
    write_file(path / "calibration" / "stereo_calib_params.json", json.dumps(stereo).encode())
    write_file(path / "calibration" / "hand_eye" / "PSM1-registration-dVRK.json", b'{"base-frame": {}}')
    meta = {"schema_version": "1.0.0", "master_t0_ns": BEGIN, "length_frames": count}
    write_file(path / "episode_meta.json", json.dumps(meta).encode())
    return path
