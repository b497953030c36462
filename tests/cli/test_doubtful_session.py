"""A calibration that predicts frames badly is refused by --session, unless the user says otherwise."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest
from helpers.commands import run_command
from helpers.damage import frame
from helpers.page_calibrations import calibration, solved

from dvrk_cmaes.calibration.session_doubts import doubts_of

FRAMES = ("0000", "0001", "0002")
BADLY = {"0000": (0.62, 9.0), "0001": (0.66, 8.0)}


@pytest.fixture
def doubtful(tmp_path: Path) -> Path:
    path = tmp_path / "session.json"
    found = calibration(solved(FRAMES), iou=0.95, leave_one_out=BADLY)
    path.write_text(json.dumps(replace(found, doubts=doubts_of(found)).to_dict()))
    return path


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


def test_result_with_a_doubtful_calibration_is_doubtful_for_its_reason(
    capsys: pytest.CaptureFixture[str], doubtful: Path
) -> None:
    ran = run_command(capsys, *frame(), "--session", doubtful, "--doubtful-session", "--json")
    result = json.loads(ran.out)
    assert (ran.code, result["status"]) == (3, "doubtful")
    assert result["reasons"][0].startswith("session: this calibration predicts frames badly")
