"""``dvrk-cmaes golden``: poses of a session are recorded, and deviations from them are found."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from helpers.commands import Ran, run_command
from helpers.places import bundled_path
from helpers.transforms import moved

from dvrk_cmaes.frames.truth import FrameTruth, SessionTruth, read_golden, write_golden

SURE, UNSURE = "0001", "0003"


Run = Callable[..., Ran]


@pytest.fixture
def run(capsys: pytest.CaptureFixture[str]) -> Run:
    """Run ``dvrk-cmaes golden``."""
    return partial(run_command, capsys, "golden")


@pytest.fixture
def session(tmp_path: Path) -> Path:
    """Make a session of two frames, one of them without readings and so indistinguishable from its mirror twin."""
    demo, folder = bundled_path("demo"), tmp_path / "session"
    (folder / "masks").mkdir(parents=True)
    shutil.copy(demo / "camera.yaml", folder)
    rows = (demo / "joints.csv").read_text().splitlines()
    (folder / "joints.csv").write_text("\n".join(row for row in rows if row.split(",")[0] in ("frame", SURE)))
    for name in (SURE, UNSURE):
        shutil.copy(demo / "masks" / f"{name}.png", folder / "masks")
    return folder


@pytest.fixture
def kept(session: Path) -> Path:
    """Record the true pose of one frame, and remove the other frame."""
    (session / "masks" / f"{UNSURE}.png").unlink()
    truth = read_golden(bundled_path("demo") / "golden.json").frames[SURE]
    write_golden(session / "golden.json", SessionTruth({SURE: truth}))
    return session


def test_ok_frames_are_recorded_and_pass_check(session: Path, run: Run) -> None:
    recorded = run("record", session, "--json")
    assert recorded.code == 3
    assert recorded.result["kept"] == [SURE]
    assert list(recorded.result["left_out"]) == [UNSURE]
    assert f"left out {UNSURE}: doubtful: " in recorded.err
    document = json.loads((session / "golden.json").read_text())
    assert set(document) == {"frames", "camera_from_base"}
    assert set(document["frames"][SURE]) == {"T_camera_roll_link", "joints", "tips_camera_m"}
    truth = read_golden(bundled_path("demo") / "golden.json").frames[SURE]
    tips = read_golden(session / "golden.json").frames[SURE].tips
    assert tips is not None
    assert truth.tips is not None
    assert np.linalg.norm(tips.mean(axis=0) - truth.tips.mean(axis=0)) < 2e-3
    again = run("check", session, "--json", "--root-mm", "0.001")
    assert (again.code, again.result["right"], again.result["not_checked"]) == (0, True, [UNSURE])
    assert again.result["frames"][0]["errors"]["root_mm"] < 1e-5


@pytest.mark.usefixtures("estimates_shared")
def test_deviation_gives_table_and_exit_code_1(kept: Path, run: Run) -> None:
    golden = read_golden(kept / "golden.json").frames[SURE]
    away = moved(golden.camera_from_root, [0.0, 0.0, 0.01, 0.0, 0.0, 0.0])
    write_golden(kept / "golden.json", SessionTruth({SURE: FrameTruth(away, golden.joints)}))
    ran = run("check", kept, "--tip-mm", "3", "--shaft-deg", "5")
    assert ran.code == 1
    heading, columns, line, *rest = ran.out.splitlines()
    assert heading == "Errors: root and tip in mm, else deg (! is off); stated: tips within, mm (90 %)"
    assert columns.split() == [
        "frame",
        "status",
        "stated",
        "root",
        "tip",
        "shaft",
        "roll",
        "wrist_pitch",
        "wrist_yaw",
        "jaw",
    ]
    assert line.split()[:2] == [SURE, "ok"]
    assert [cell.endswith("!") for cell in line.split()[3:]] == [True, True, False, False, False, False, False]
    assert rest[0] == f"{SURE}: not as the golden pose"
    assert rest[-1] == (
        "0 of 1 frames within tolerance (at most: root 0.5, tip 3, shaft 5, roll 3, pitch/yaw 3, jaw 3)"
    )


@pytest.mark.usefixtures("estimates_shared")
def test_golden_poses_are_overwritten_on_request_only(kept: Path, run: Run) -> None:
    before = (kept / "golden.json").read_bytes()
    assert run("record", kept).refusal == (
        f"{kept / 'golden.json'}: expected no file yet, got one; --overwrite replaces it"
    )
    assert (kept / "golden.json").read_bytes() == before
    assert run("record", kept, "--overwrite").code == 0
    assert (kept / "golden.json").read_bytes() != before


@pytest.mark.usefixtures("estimates_shared")
def test_missing_frames_are_named(kept: Path, run: Run) -> None:
    path = kept / "golden.json"
    assert run("check", kept, "--jaw-deg", "-1").refusal == ("--jaw-deg: expected a number of at least 0, got -1")
    golden = read_golden(path).frames[SURE]
    write_golden(path, SessionTruth({SURE: golden, "0009": golden}))
    assert run("check", kept).refusal == f"{path}: frames: expected frames of {kept}, got 0009 too"
    write_golden(path, SessionTruth({}))
    assert run("check", kept).refusal == f"{path}: frames: expected golden poses, got none"
    path.unlink()
    assert run("check", kept).refusal == (f"{path}: no such file; expected the truth of a session (golden.json)")
    assert run("record", kept, "--golden", kept / "camera.yaml" / "golden.json").refusal.startswith(
        f"{kept / 'camera.yaml'}: expected a folder to write to, but"
    )
