"""A calibration that predicts frames badly is refused by --session, unless the user says otherwise."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from helpers.commands import run_command
from helpers.damage import frame
from helpers.page_calibrations import calibration, solved

FRAMES = ("0000", "0001", "0002")
BADLY = {"0000": (0.62, 9.0), "0001": (0.66, 8.0)}
WELL = {"0000": (0.90, 1.0), "0001": (0.92, 1.0)}


@pytest.fixture
def doubtful(tmp_path: Path) -> Path:
    path = tmp_path / "session.json"
    path.write_text(json.dumps(calibration(solved(FRAMES), iou=0.95, leave_one_out=BADLY).to_dict()))
    return path


def test_calibration_is_doubtful_by_its_predictions_alone() -> None:
    bad = calibration(solved(FRAMES), iou=0.95, leave_one_out=BADLY, warnings=())
    assert bad.doubt.startswith("this calibration predicts frames badly that it has not seen: IoU 0.64 by the other ")
    assert bad.status == "doubtful"
    for leave_one_out in (WELL, {}):
        good = calibration(solved(FRAMES), iou=0.95, leave_one_out=leave_one_out, warnings=())
        assert (good.doubt, good.status) == ("", "ok")


def test_doubtful_calibration_is_refused(capsys: pytest.CaptureFixture[str], doubtful: Path) -> None:
    refusal = run_command(capsys, *frame(), "--session", doubtful).refusal
    assert refusal.startswith(f"{doubtful}: this calibration predicts frames badly")
    assert refusal.endswith("; --doubtful-session uses it all the same")


def test_doubtful_calibration_is_used_with_a_warning_where_told(
    capsys: pytest.CaptureFixture[str], doubtful: Path
) -> None:
    ran = run_command(capsys, *frame(), "--session", doubtful, "--doubtful-session")
    assert ran.code in (0, 3)
    assert f"warning: {doubtful}: this calibration predicts frames badly" in ran.err
