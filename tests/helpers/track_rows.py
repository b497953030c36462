"""Lines of tracks.jsonl of a recording that was not really followed, for tests of what is made of them."""

from __future__ import annotations

from typing import Any

import numpy as np

from dvrk_cmaes.report.template import webp
from dvrk_cmaes.report.track_page import FollowedRecording

JOINTS = ("wrist_pitch", "wrist_yaw", "jaw")
STD = {
    "translation_mm": [0.1, 0.2, 0.3],
    "rotation_deg": [1.0, 2.0, 3.0],
    "tip_mm": 0.5,
    "joints_deg": dict.fromkeys(JOINTS, 1.0),
}


def row(
    number: int, status: str = "ok", *reasons: str, name: str | None = None, time: float | None = 0.0
) -> dict[str, Any]:
    """The line of a frame; a moved and turned pose, except for a frame without a pose (status lost)."""
    angle = 0.02 * number
    pose = np.eye(4)
    pose[:2, :2] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
    pose[:3, 3] = [0.001 * number, 0.0, 0.1]
    there = status != "lost"
    return {
        "frame": f"{number:04d}" if name is None else name,
        "time": None if time is None else time + number / 30,
        "status": status,
        "reasons": list(reasons),
        "camera_from_root": pose.tolist() if there else None,
        "joints": {joint: 0.1 * k + 0.01 * number for k, joint in enumerate(JOINTS)} if there else {},
        "std": STD if there else None,
        "offsets": {"roll": 0.05, **dict.fromkeys(JOINTS, -0.1)} if there else {},
        "tips": [[0.001 * number, 0.002, 0.11], [0.001 * number, 0.004, 0.11]] if there else None,
        "seconds": 0.02,
        "searched": False,
        "residual_px": 0.8 if there else None,
        "tip_probability": 0.98 if there else None,
    }


def recording(rows: list[dict[str, Any]], *, session: str = "made") -> FollowedRecording:
    """A recording with readings, overlaps, and a grey picture of each third frame."""
    count = len(rows)
    picture = webp(np.full((120, 160, 3), 90, np.uint8), 128)
    read = {joint: np.linspace(0, 1, count) for joint in JOINTS}
    pictures = dict.fromkeys(range(0, count, 3), picture)
    return FollowedRecording(rows, session, "lnd", None, read, np.linspace(0.9, 1, count), pictures)
