"""A recording that was followed is exported, inspected and compared as results of single frames are."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from helpers.commands import run_command
from helpers.files import write_json
from helpers.track_rows import row

from dvrk_cmaes.results.tracked import TRACKS, line_of

ROWS = [row(0), row(1), row(2, "doubtful", "no mask"), row(3, "lost")]


@pytest.fixture
def tracks(tmp_path: Path) -> Path:
    """A folder of `track` with four frames: ok, ok, doubtful, lost."""
    (tmp_path / "tracks").mkdir()
    (tmp_path / "tracks" / TRACKS).write_text("".join(map(line_of, ROWS)))
    return tmp_path / "tracks"


@pytest.mark.parametrize("to", ["csv", "bop", "tum", "ros1-bag", "ros2-bag"])
def test_recording_is_exported(capsys: pytest.CaptureFixture[str], tracks: Path, to: str) -> None:
    ran = run_command(capsys, "export", tracks, "--to", to, "--json")
    assert ran.code == 0, ran.err
    assert ran.result["left_out"] == ([] if to == "csv" else ["0003"])  # the table has a row of each frame
    assert all(Path(path).stat().st_size for path in ran.result["written"])


def test_tum_takes_times_and_says_where_there_are_none(capsys: pytest.CaptureFixture[str], tracks: Path) -> None:
    table = tracks.parent / "images.csv"
    table.write_text("frame,time\n0000,10.5\n0001,11\n0002,12\n0003,13\n")
    arguments = ("export", tracks, "--to", "tum", "--out", tracks.parent / "out")
    assert run_command(capsys, *arguments, "--times", table).code == 0
    assert (tracks.parent / "out" / "PSM1.tum").read_text().startswith("10.500000000 0.000000000 ")
    text = (tracks / TRACKS).read_text().splitlines(keepends=True)
    (tracks / TRACKS).write_text("".join(line_of({**json.loads(line), "time": None}) for line in text))
    ran = run_command(capsys, *arguments)
    assert "the frames' times are not known" in ran.err
    assert (tracks.parent / "out" / "PSM1.tum").read_text().startswith("1.000000000 ")


def test_folder_is_inspected(capsys: pytest.CaptureFixture[str], tracks: Path) -> None:
    ran = run_command(capsys, "inspect", tracks)
    assert ran.code == 0, ran.err
    assert "4 frames (1 doubtful, 1 failed, 2 ok)" in ran.out
    assert "a recording that track followed" in ran.out


def test_comparison_with_the_truth_states_coverage(capsys: pytest.CaptureFixture[str], tracks: Path) -> None:
    truth = {
        entry["frame"]: {
            "T_camera_roll_link": (np.array(entry["camera_from_root"]) + shift).tolist(),
            "joints": entry["joints"],
            "tips_camera_m": np.add(entry["tips"], shift[:3, 3]).tolist(),
        }
        for entry, shift in zip(ROWS[:3], (moved_by(0.4e-3), moved_by(0.9e-3), moved_by(1.1e-3)), strict=True)
    }
    golden = tracks.parent / "golden.json"
    write_json(golden, {"schema": 1, "frames": truth})
    ran = run_command(capsys, "compare", golden, tracks, "--json")
    assert ran.code == 0, ran.err
    assert ran.result["sets"]["B"]["tips_within_std"] == {"once": 1, "twice": 2, "of": 3}
    printed = run_command(capsys, "compare", golden, tracks).out
    assert (
        "tips within their stated standard deviation of the truth: 33% of 3 frames, within twice of it 67%" in printed
    )


def moved_by(distance: float) -> np.ndarray:
    """A change of a pose along the camera's axis, m."""
    shift = np.zeros((4, 4))
    shift[2, 3] = distance
    return shift
