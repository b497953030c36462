"""A frame whose base lies far from the others' is doubtful; status and reasons follow the frames that are there."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
from helpers.canned_results import canned

from dvrk_cmaes.geometry import moved
from dvrk_cmaes.io.json_file import write_json
from dvrk_cmaes.pose.doubts import BASE_APART
from dvrk_cmaes.results.folder import read_results, result_path
from dvrk_cmaes.results.result import Result
from dvrk_cmaes.runs.agreement import base_doubts, compare_bases

BASE = moved(np.eye(4), np.array([0.1, 0.0, 0.05, 0.3, -0.8, 1.0]))


def session(turns_deg: list[float]) -> dict[str, Result]:
    found = {}
    for k, turn in enumerate(turns_deg):
        name = f"{k:04d}"
        base = moved(BASE, np.array([0, 0, 0, 0, np.deg2rad(turn), 0]))
        found[name] = replace(canned(name), camera_from_base=base)
    return found


def test_frame_apart_is_named_with_its_angle() -> None:
    doubts = base_doubts(session([0, 1, -1, 2, 0.5, 40.3]), 10.0)
    assert list(doubts) == ["0005"]
    assert doubts["0005"].startswith(f"{BASE_APART}: rotated by 40 deg, expected at most 10 deg")


def test_frames_that_agree_are_not_doubted() -> None:
    assert base_doubts(session([0, 1, -1, 2, 0.5, 8]), 10.0) == {}


def write_frames(out: Path, turns_deg: list[float]) -> None:
    for k, turn in enumerate(turns_deg):
        base = moved(np.eye(4), np.array([0, 0, 0.1, 0, np.deg2rad(turn), 0]))
        write_json(result_path(out, f"{k:04d}"), replace(canned(f"{k:04d}"), camera_from_base=base).to_dict())


def test_reason_is_written_and_withdrawn(tmp_path: Path) -> None:
    write_frames(tmp_path, [0, 1, 2, 1, 0, 40])
    before = {path.name: path.read_bytes() for path in (tmp_path / "frames").iterdir()}
    compared = compare_bases(tmp_path, read_results(tmp_path).frames, 10.0)
    assert [name for name, one in compared.items() if one.status == "doubtful"] == ["0005"]
    document = json.loads(result_path(tmp_path, "0005").read_text())
    assert (document["status"], document["reasons"]) == ("doubtful", list(compared["0005"].reasons))
    assert compare_bases(tmp_path, read_results(tmp_path).frames, 10.0)["0005"].reasons == compared["0005"].reasons

    back = compare_bases(tmp_path, read_results(tmp_path).frames, 90.0)
    assert (back["0005"].status, back["0005"].reasons) == ("ok", ())
    assert {path.name: path.read_bytes() for path in (tmp_path / "frames").iterdir()} == before
