"""`track --causal`: keyframes are solved beside the following, and an interrupted run is begun anew."""

from __future__ import annotations

import json
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.followed_folder import track_folder
from helpers.moving_worlds import SMALL

from dvrk_cmaes import EstimateConfig, prepare, read_calibration, read_session
from dvrk_cmaes.config import TrustConfig
from dvrk_cmaes.results.track_files import read_tracks
from dvrk_cmaes.runs import manifest, solver_process
from dvrk_cmaes.runs.pool import Pool
from dvrk_cmaes.runs.track import TrackSettings
from dvrk_cmaes.synth.levels import LEVELS
from dvrk_cmaes.synth.recording import write_recording
from dvrk_cmaes.synth.session import SessionPlan

FRAMES, INTERRUPTED_AFTER = 72, 24
SETTINGS = TrackSettings(
    EstimateConfig(trust=TrustConfig(tip_mm=3.0)), causal=True, evidence="masks", workers=1
)  # small images tell less about the depth


@pytest.fixture(scope="module", autouse=True)
def solved_once() -> Iterator[None]:
    """Let keyframes be estimated and solved in a process, and the same ones again give the same answer at once."""
    submit = Pool.submit
    known: dict[str, Future[Any]] = {}

    def answer(pool: Pool, function: Callable[..., Any], *arguments: Any) -> Future[Any]:
        if function not in (solver_process._estimate, solver_process._solve):
            return submit(pool, function, *arguments)
        key = manifest.digest_of(arguments[1])
        if key not in known:
            known[key] = submit(pool, function, *arguments)
        return known[key]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Pool, "submit", answer)
        yield


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


def test_interrupted_run_begins_anew_with_the_same_results(recording: Path, tracks: Path, tmp_path: Path) -> None:
    session, body, stop = read_session(recording), prepare("lnd"), threading.Event()

    def interrupt(done: int, total: int) -> None:
        if done == INTERRUPTED_AFTER:
            stop.set()

    first = track_folder(session, tmp_path, body, SETTINGS, video=False, page=False, stop=stop, progress=interrupt)
    assert first.interrupted
    again = track_folder(session, tmp_path, body, SETTINGS, video=False, page=False)
    assert not again.interrupted
    assert rows_of(tmp_path) == rows_of(tracks)
