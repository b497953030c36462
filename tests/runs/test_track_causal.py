"""`track --causal`: keyframes are solved while a recording is followed."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from helpers.followed_folder import track_folder
from helpers.moving_worlds import SMALL

from dvrk_cmaes import EstimateConfig, prepare, read_calibration, read_session
from dvrk_cmaes.config import TrustConfig
from dvrk_cmaes.results.track_files import read_tracks
from dvrk_cmaes.runs.track import TrackSettings
from dvrk_cmaes.synth.levels import LEVELS
from dvrk_cmaes.synth.recording import write_recording
from dvrk_cmaes.synth.session import SessionPlan

FRAMES = 72
SETTINGS = TrackSettings(
    EstimateConfig(trust=TrustConfig(tip_mm=3.0)), causal=True, evidence="masks", workers=1
)  # small images tell less about the depth


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("causal") / "session"
    write_recording(folder, SessionPlan(prepare("lnd"), SMALL, LEVELS["clean"], "video", FRAMES, 4, {}))
    return folder


@pytest.fixture(scope="module")
def tracks(recording: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("tracks")
    track_folder(read_session(recording), out, prepare("lnd"), SETTINGS, video=False)
    return out


def rows_of(folder: Path) -> list[dict[str, object]]:
    return [{**row, "seconds": 0} for row in read_tracks(folder / "tracks.jsonl")]


def test_no_frame_is_ok_before_a_solution_expects_it(tracks: Path) -> None:
    rows = rows_of(tracks)
    used, solved = [row["base"]["used"] for row in rows], [row["base"]["solved"] for row in rows]
    first = used.index(True)
    assert 60 < first < FRAMES - 3
    assert all(used[first:])
    assert solved[first] >= 12
    assert {row["status"] for row in rows[: solved.index(8)]} <= {"doubtful", "lost"}
    assert sum(row["status"] == "ok" for row in rows[first:]) > (FRAMES - first) / 2


def test_poses_that_are_ok_or_by_the_solution_are_near_the_truth(recording: Path, tracks: Path) -> None:
    golden = json.loads((recording / "golden.json").read_text(encoding="utf-8"))["frames"]
    for row in rows_of(tracks):
        if row["base"]["used"] or row["status"] == "ok":
            off = np.array(row["tips"]) - np.array(golden[row["frame"]]["tips_camera_m"])
            assert 1e3 * np.linalg.norm(off, axis=1).mean() < 2.0


def test_solution_is_written_and_shown_on_the_page(tracks: Path) -> None:
    assert len(read_calibration(tracks / "session.json").frames) >= 3
    page = (tracks / "report.html").read_text(encoding="utf-8")
    assert "<h3>Offsets</h3>" in page
    assert "from frame " in page
