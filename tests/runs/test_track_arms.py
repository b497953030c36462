"""Followed arms that were exchanged, told from their tracks and readings."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from helpers.track_rows import JOINTS, row

from dvrk_cmaes.results.track_files import TRACKS, line_of
from dvrk_cmaes.runs.track_arms import exchanged_while_followed

COUNT = 40


def write_tracks(out: Path, arm: str, joints: np.ndarray, gone: int) -> None:
    """Write the tracks of an arm with joints (N, 3), rad, found in all frames but one."""
    rows = [row(k, "gone" if k == gone else "ok") for k in range(len(joints))]
    rows[gone]["status"] = "lost"
    for one, found in zip(rows, joints.tolist(), strict=True):
        if one["joints"]:
            one["joints"] = dict(zip(JOINTS, found, strict=True))
            one["std"] |= {"translation_mm": [0.1, 0.1, 0.3], "rotation_deg": [0.5, 0.5, 1.0]}
    (out / arm).mkdir(parents=True)
    (out / arm / TRACKS).write_text("".join(line_of(one) for one in rows), encoding="utf-8")


def readings_of(joints: np.ndarray) -> dict[str, np.ndarray]:
    """Give the readings (N,) of each joint, 8 deg off, of which the first are missing."""
    read = joints + np.deg2rad(8)
    read[:2] = np.nan
    return dict(zip(JOINTS, read.T, strict=True))


def test_arms_exchanged_on_the_way_are_named_with_the_frame(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    first, second = (
        at + np.cumsum(0.02 * rng.standard_normal((COUNT, 3)), axis=0) for at in ([0.6, 0.5, 0.9], [-0.5, 0.2, 0.3])
    )
    write_tracks(tmp_path / "right", "PSM1", first, gone=7)
    write_tracks(tmp_path / "right", "PSM2", second, gone=20)
    readings = {"PSM1": readings_of(first), "PSM2": readings_of(second)}
    assert exchanged_while_followed(tmp_path / "right", readings) == []
    write_tracks(tmp_path / "exchanged", "PSM1", np.r_[first[:12], second[12:]], gone=7)
    write_tracks(tmp_path / "exchanged", "PSM2", np.r_[second[:12], first[12:]], gone=20)
    (text,) = exchanged_while_followed(tmp_path / "exchanged", readings)
    assert text.endswith("seem to be exchanged from frame 0012 on")
