"""``dvrk-cmaes track``: files, statuses and exit codes, an interrupted run, and wrong use."""

from __future__ import annotations

import shutil
import threading
from pathlib import Path

import pytest
from helpers.commands import run_command
from helpers.followed_folder import track_folder
from helpers.moving_worlds import SMALL

from dvrk_cmaes import EstimateConfig, prepare, read_session
from dvrk_cmaes.cli.session_tools import reason_lines
from dvrk_cmaes.results.track_files import read_tracks
from dvrk_cmaes.runs.track import TrackSettings
from dvrk_cmaes.synth.levels import LEVELS
from dvrk_cmaes.synth.recording import write_recording
from dvrk_cmaes.synth.session import SessionPlan

FRAMES = 8
SETTINGS = TrackSettings(EstimateConfig(), lag=0.0)


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording of an arm that moves slowly, with exact masks."""
    folder = tmp_path_factory.mktemp("recording") / "session"
    write_recording(folder, SessionPlan(prepare("lnd"), SMALL, LEVELS["clean"], "video", FRAMES, 2, {}))
    return folder


@pytest.fixture(scope="module")
def tracks(recording: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The results of the whole recording."""
    out = tmp_path_factory.mktemp("tracks")
    track_folder(read_session(recording), out, prepare("lnd"), SETTINGS, video=False, page=False)
    return out


def without_seconds(path: Path) -> list[dict[str, object]]:
    return [{**row, "seconds": 0} for row in read_tracks(path / "tracks.jsonl")]


def test_reasons_are_counted_with_their_frames() -> None:
    seen = {"reasons": []}
    rows = [seen, *[{"reasons": ["lost: no mask", "no mask"]}] * 2, seen, {"reasons": ["lost: 3 px"]}, seen]
    lines = [line.text for line in reason_lines({f"{k:04d}": row["reasons"] for k, row in enumerate(rows)})]
    assert lines[:2] == ["  lost: 3 frames (0001 to 0002, 0004)", "  no mask: 2 frames (0001 to 0002)"]
    assert lines[2:] == ["  what to do about reasons: dvrk-cmaes help problems"]
    assert list(reason_lines({"0000": []})) == []


def test_video_and_page_can_be_left_out(recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    options = ["--out", str(tmp_path / "out"), "--every", "4", "--lag", "0", "--no-video", "--no-page"]
    ran = run_command(capsys, "track", str(recording), *options)
    assert ran.code in (0, 3)
    assert "page:" not in ran.out
    assert {path.name for path in (tmp_path / "out").iterdir()}.isdisjoint({"tracks.mp4", "report.html"})


def test_interrupted_run_begins_anew_with_same_results(recording: Path, tracks: Path, tmp_path: Path) -> None:
    session, body, stop = read_session(recording), prepare("lnd"), threading.Event()

    def interrupt(done: int, total: int) -> None:
        if done == 3:
            stop.set()

    first = track_folder(session, tmp_path, body, SETTINGS, video=False, stop=stop, progress=interrupt)
    assert first.interrupted
    assert len(without_seconds(tmp_path)) == 3
    with open(tmp_path / "tracks.jsonl", "a", encoding="utf-8") as file:
        file.write('{"frame": "00')  # as if the process was killed while writing
    done = []
    track_folder(session, tmp_path, body, SETTINGS, video=False, progress=lambda k, total: done.append(k))
    assert done == list(range(FRAMES + 1))  # from the first frame
    assert without_seconds(tmp_path) == without_seconds(tracks)


def test_short_recording_is_followed_from_image_to_image_and_one_line_says_why(recording: Path, tmp_path: Path) -> None:
    said: list[str] = []
    session = read_session(recording)
    settings = TrackSettings(EstimateConfig(), lag=0.0, every=4, evidence="masks")
    track_folder(session, tmp_path, prepare("lnd"), settings, video=False, page=False, notice=said.append)
    assert said == [
        "followed from image to image, as by --causal: 2 frames are well in view and have readings, fewer than 12"
    ]


def test_results_of_other_settings_are_not_continued(
    recording: Path, tracks: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    shutil.copytree(tracks, out)
    before = (out / "tracks.jsonl").read_bytes()
    ran = run_command(capsys, "track", str(recording), "--out", str(out), "--lag", "0.1")
    assert ran.code == 2
    assert "track.lag: 0.0 -> 0.1" in ran.err
    assert (out / "tracks.jsonl").read_bytes() == before


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        (["--every", "0"], "--every: expected a whole number of at least 1, got 0"),
        (
            ["--lag", "soon"],
            "--lag: expected a number of seconds such as 0.13, or of frames such as 4frames, got 'soon'",
        ),
        (["--workers", "0"], "--workers: expected a whole number of at least 1, got 0"),
        (["--fps", "0"], "--fps: expected frames a second above 0, got 0"),
        (["--session", "none.json"], "none.json: no such file"),
        (["--rerun", "a.mp4"], "--rerun: expected the name of a file that ends in .rrd, got 'a.mp4'"),
    ],
)
def test_wrong_options_are_refused(
    recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], options: list[str], expected: str
) -> None:
    ran = run_command(capsys, "track", str(recording), "--out", str(tmp_path / "out"), *options)
    assert ran.code == 2
    assert expected in ran.err
    assert not (tmp_path / "out").exists()
