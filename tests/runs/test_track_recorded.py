"""A recording followed with the calibration of its keyframes: poses, statuses, resumption, and what is not."""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.followed_folder import track_folder
from helpers.session_worlds import make_frames_in_memory, write_folder
from helpers.transforms import change_between

from dvrk_cmaes import (
    Body,
    EstimateConfig,
    FrameData,
    Result,
    prepare,
    read_calibration,
    read_session,
)
from dvrk_cmaes.calibration.session_problem import ArmSetup
from dvrk_cmaes.calibration.together import solved_alone
from dvrk_cmaes.instrument.arm import Arm
from dvrk_cmaes.results.track_files import read_tracks
from dvrk_cmaes.runs import keyframes
from dvrk_cmaes.runs.keyframes import (
    RecordedKeyframe,
    begin_keyframes,
)
from dvrk_cmaes.runs.recording import RecordedFrames, RecordedSolution
from dvrk_cmaes.runs.track import TrackSettings
from dvrk_cmaes.runs.track_inputs import TrackClock, series_of
from dvrk_cmaes.synth.truth import Truth

FRAMES = 14
EMPTY = "0005"
SETTINGS = TrackSettings(EstimateConfig(), evidence="masks", workers=1)


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, Truth]]:
    """A session of an arm that moves from frame to frame; the mask of one frame shows nothing."""
    folder = tmp_path_factory.mktemp("recorded") / "session"
    _, truths, frames = make_frames_in_memory(prepare("lnd"), FRAMES, seed=5)
    names = [frame.name for frame in frames]
    hidden = names.index(EMPTY)
    data = frames[hidden].data
    assert isinstance(data, FrameData)
    frames[hidden] = replace(frames[hidden], data=FrameData.of(np.zeros_like(data.mask), data.camera, None))
    write_folder(folder, frames)
    return folder, dict(zip(names, truths, strict=True))


@pytest.fixture(scope="module")
def tracks(made: tuple[Path, dict[str, Truth]], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The results of the whole recording."""
    out = tmp_path_factory.mktemp("tracks")
    done = track_folder(read_session(made[0]), out, prepare("lnd"), SETTINGS, video=False, page=False)
    assert not done.interrupted
    return out


def tip_error_mm(row: dict[str, object], truth: Truth) -> float:
    instrument = prepare("lnd").instrument
    pose = truth.camera_from_root
    true = instrument.tips(truth.values) @ pose[:3, :3].T + pose[:3, 3]
    return 1e3 * float(np.linalg.norm(np.array(row["tips"]) - true, axis=1).mean())


def test_every_pose_is_near_the_truth_and_within_its_stated_error(
    made: tuple[Path, dict[str, Truth]], tracks: Path
) -> None:
    rows = [row for row in read_tracks(tracks / "tracks.jsonl") if row["frame"] != EMPTY]
    errors = np.array([tip_error_mm(row, made[1][row["frame"]]) for row in rows])
    assert len(rows) == FRAMES - 1
    assert np.median(errors) < 1.5
    assert (errors / [row["std"]["tip_mm"] for row in rows]).max() < 3.5
    assert sum(row["status"] == "ok" for row in rows) >= FRAMES // 2


def test_frame_that_shows_nothing_is_lost_and_has_the_predicted_pose(
    made: tuple[Path, dict[str, Truth]], tracks: Path
) -> None:
    row = next(row for row in read_tracks(tracks / "tracks.jsonl") if row["frame"] == EMPTY)
    assert row["status"] == "lost"
    assert row["reasons"] == ["lost: the mask shows nothing of the instrument"]
    assert tip_error_mm(row, made[1][EMPTY]) < 10
    assert row["residual_px"] is None


def test_calibration_of_the_keyframes_is_kept_beside_the_tracks(tracks: Path) -> None:
    calibration = read_calibration(tracks / "session.json")
    assert EMPTY not in calibration.frames
    assert len(calibration.frames) >= 10


def test_finished_recording_is_not_followed_again(
    made: tuple[Path, dict[str, Truth]], tracks: Path, tmp_path: Path
) -> None:
    out, said = tmp_path / "out", []
    shutil.copytree(tracks, out)
    done = track_folder(
        read_session(made[0]), out, prepare("lnd"), SETTINGS, video=False, page=True, notice=said.append
    )
    assert said == []
    assert sum(done.counts.values()) == FRAMES
    assert (out / "report.html").exists()
    assert (out / "tracks.jsonl").read_bytes() == (tracks / "tracks.jsonl").read_bytes()


def test_given_calibration_is_used_instead_of_keyframes(
    made: tuple[Path, dict[str, Truth]], tracks: Path, tmp_path: Path
) -> None:
    doubtful = replace(read_calibration(tracks / "session.json"), doubts=("the camera file is contradicted",))
    given = replace(SETTINGS, calibration=doubtful)
    said: list[str] = []
    track_folder(read_session(made[0]), tmp_path, prepare("lnd"), given, video=False, page=False, notice=said.append)
    assert said == [f"fitting {FRAMES} frames"]
    pairs = zip(read_tracks(tmp_path / "tracks.jsonl"), read_tracks(tracks / "tracks.jsonl"), strict=True)
    assert all(np.allclose(own["tips"], other["tips"], atol=2e-4) for own, other in pairs)
    rows = read_tracks(tmp_path / "tracks.jsonl")
    assert {row["status"] for row in rows} == {"doubtful", "lost"}
    assert {row["reasons"][0] for row in rows} == {"session: the camera file is contradicted"}
    assert read_calibration(tmp_path / "session.json").status == "doubtful"


def test_keyframes_start_from_where_the_first_of_them_expect_them(
    made: tuple[Path, dict[str, Truth]], tracks: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(keyframes, "SEARCHED", 7)
    tried: list[RecordedKeyframe] = []
    alone = keyframes.alone_task

    def noted(body: Body, config: EstimateConfig, keyframe: RecordedKeyframe, *, arm: Arm) -> Result:
        tried.append(keyframe)
        return alone(body, config, keyframe, arm=arm)

    monkeypatch.setattr(keyframes, "alone_task", noted)
    body = prepare("lnd")
    session = read_session(made[0])
    clock = TrackClock.of(session, session.frames, 30.0)
    recorded = RecordedFrames.of(
        session.frames, session.rig, series_of(session), np.array([clock.times[own.name] for own in session.frames])
    )
    config = replace(EstimateConfig(), threads=1)

    def run(function: Any, tasks: Sequence[Any]) -> list[Any]:
        return [function(body, config, task) for task in tasks]

    problem = ArmSetup(recorded.series, body.instrument, "classic", config, run)
    solved = solved_alone(begin_keyframes(recorded, problem))
    assert isinstance(solved, RecordedSolution)
    assert [task.start is None for task in tried] == [True] * 7 + [False] * (len(tried) - 7)
    for task in tried[7:]:
        assert task.start is not None
        truth = made[1][task.files.name]
        assert np.linalg.norm(task.start.pose[:3, 3] - truth.camera_from_root[:3, 3]) < 5e-3
    of_searches = read_calibration(tracks / "session.json").camera_from_base
    assert np.linalg.norm(change_between(solved.calibration.camera_from_base, of_searches)[3:]) < np.deg2rad(0.5)
