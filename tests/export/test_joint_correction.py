"""Corrections of joints: the table and the formula, carried out as a controller would."""

from __future__ import annotations

import csv
import io
from pathlib import Path

import numpy as np
import pytest
from helpers.commands import main
from helpers.files import write_json
from helpers.page_calibrations import OFFSETS, cables_of, calibration, solved

from dvrk_cmaes import InputError
from dvrk_cmaes.export.frames import FrameNames
from dvrk_cmaes.export.joint_correction import correction_files
from dvrk_cmaes.joints.cables import PARAMETERS, CableModel
from dvrk_cmaes.joints.play import play_of

FRAMES = solved(("a", "b"))
NAMES = FrameNames("PSM1", "camera", "PSM1_base")
DOCUMENT = calibration(FRAMES, cables=cables_of(FRAMES)).to_dict()


def carried_out(formula: str, readings: np.ndarray, joints: tuple[str, ...]) -> np.ndarray:
    """Corrections (N, C) by the lines of the formula, of readings (N, C)."""
    state: dict[str, float] = {}
    for band in ("wide", "narrow"):
        state |= {f"{band}_{name}": float(value) for name, value in zip(joints, readings[0], strict=True)}
    found = []
    for row in readings:
        state |= dict(zip(joints, row.tolist(), strict=True))
        exec(formula, {"min": min, "max": max}, state)
        found.append([state[f"{name}_correction"] for name in joints])
    return np.array(found)


def test_the_formula_follows_the_play_as_the_model_does() -> None:
    cables = cables_of(FRAMES)
    offset = np.array([OFFSETS[name] for name in cables.joints])
    model = CableModel(cables.joints, offset=offset, **{name: np.array(getattr(cables, name)) for name in PARAMETERS})
    readings = np.cumsum(np.random.default_rng(0).normal(0, 0.1, (50, 4)), axis=0)
    expected = model.errors(readings, play_of(readings, model.width))
    formula = correction_files("session.json", DOCUMENT, NAMES)["PSM1-joint-correction.txt"]
    np.testing.assert_allclose(carried_out(formula, readings, cables.joints), expected, atol=1e-4)


def test_the_table_has_what_a_reading_tells_by_itself() -> None:
    rows = list(csv.DictReader(io.StringIO(correction_files("", DOCUMENT, NAMES)["PSM1-joint-correction.csv"])))
    at = next(row for row in rows if (row["wrist_pitch_deg"], row["wrist_yaw_deg"], row["jaw_deg"]) == ("0", "60", "0"))
    expected = np.degrees(OFFSETS["wrist_pitch"]) + 0.25 * 60
    assert float(at["wrist_pitch_correction_deg"]) == pytest.approx(expected, abs=1e-3)
    assert float(at["wrist_yaw_correction_deg"]) == pytest.approx(np.degrees(OFFSETS["wrist_yaw"]), abs=1e-3)


def test_a_session_without_cables_has_the_offsets() -> None:
    files = correction_files("", calibration(FRAMES).to_dict(), NAMES)
    assert "wide" not in files["PSM1-joint-correction.txt"]
    rows = list(csv.DictReader(io.StringIO(files["PSM1-joint-correction.csv"])))
    assert {float(row["jaw_correction_deg"]) for row in rows} == {round(float(np.degrees(OFFSETS["jaw"])), 3)}


def test_tables_of_another_size_are_refused() -> None:
    wrong = DOCUMENT | {"cables": DOCUMENT["cables"] | {"play": [[0.0]]}}
    with pytest.raises(InputError, match=r"^session\.json: cables\.play: expected 4 rows of 4 numbers"):
        correction_files("session.json", wrong, NAMES)


def test_command_writes_both_files(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_json(tmp_path / "session.json", DOCUMENT)
    assert main(["export", str(tmp_path / "session.json"), "--to", "joint-correction", "--out", str(tmp_path)]) == 0
    assert sorted(path.name for path in tmp_path.glob("PSM1-*")) == [
        "PSM1-joint-correction.csv",
        "PSM1-joint-correction.txt",
    ]
    assert "true = reading + correction" in capsys.readouterr().out


def test_results_without_a_calibration_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_json(tmp_path / "a.json", FRAMES[0].to_dict())
    assert main(["export", str(tmp_path / "a.json"), "--to", "joint-correction"]) == 2
    assert "expected a session calibration (session.json), got none" in capsys.readouterr().err
