"""Test of the camera file: sessions with the right focal length, with files that are 10 % off, and without a file.

The frames are estimated with the camera of the file, and their results are solved together. A session names its camera
if the calibration states that the frames contradict the file. Without a file, the frames are estimated with a guess of
the camera, which is refined beside the base.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, Final

import numpy as np

from dvrk_cmaes.camera.guess import CameraGuess
from measure.accuracy.errors import error_of
from measure.accuracy.sessions import Outcome, original_trials, solve
from measure.cases import ORIGINAL, Case, Measurement

_OFF: Final = {"focal length 10 % short": 1 / 1.1, "focal length 10 % long": 1.1}
"""Factor of the file's focal length on the true one, by kind."""

_STATED: Final = 3.0  # standard deviations within which the truth is looked for


def wrong_camera_cases(cases: Sequence[Case]) -> list[Case]:
    """Return the cases with the camera of a wrong file, too short in every other session and too long in the rest."""
    kinds = list(_OFF)
    sessions = list(dict.fromkeys(case.session for case in cases))
    found = []
    for case in cases:
        kind = kinds[sessions.index(case.session) % len(kinds)]
        wrong = case.with_camera(case.camera.changed(_OFF[kind], (0.0, 0.0)))
        found.append(replace(wrong, kind=kind, truth=None))
    return found


def measure_camera(given: Measurement) -> dict[str, list[dict[str, Any]]]:
    """Report how many sessions contradict their camera file, right and with a focal length that is 10 % off."""
    cases = given.cases(base=True)
    runs = given.runs([*cases, *wrong_camera_cases(cases)], "frames with right and wrong cameras")
    trials = original_trials(runs[: len(cases)]) + original_trials(runs[len(cases) :])
    return camera_report(solve(given, trials))


def camera_report(outcomes: Sequence[Outcome]) -> dict[str, list[dict[str, Any]]]:
    """Report how many sessions name their camera by kind, and a row for each session."""
    rows = [_row(one) for one in outcomes]
    kinds = list(dict.fromkeys(row["kind"] for row in rows))
    summary = [
        {
            "kind": kind,
            "sessions": len(own := [row for row in rows if row["kind"] == kind]),
            "named": sum(row["named"] for row in own),
            "untold": sum(row["focal off"] is None for row in own),
        }
        for kind in kinds
    ]
    return {"camera files named as contradicted": summary, "sessions": rows}


def measure_no_camera(given: Measurement) -> dict[str, list[dict[str, Any]]]:
    """Report the focal length that sessions without a camera file tell, and the tips of their frames."""
    cases = given.cases(base=True)
    guessed = []
    for case in cases:
        size = case.camera.width, case.camera.height
        guess = case.with_camera(CameraGuess().file(size).camera)
        guessed.append(replace(guess, kind="no camera file"))
    trials = original_trials(given.runs(guessed, "frames with a guess of the camera", truth=False))
    cameras = {case.session: case.camera.fx for case in cases}
    rows = [_found_row(given, one, cameras[one.trial.session]) for one in solve(given, trials, refine_camera=True)]
    told = [row for row in rows if row["focal px"] is not None]
    tips = [off for row in told for off in row.pop("tips")]
    summary = {
        "sessions": len(rows),
        "told": len(told),
        "focal length within 3 std": sum(abs(row["off"]) < _STATED * row["std"] for row in told),
        "largest off, std": max((abs(row["off"]) / row["std"] for row in told), default=None),
        "ok frames": len(tips),
        "tips within 3 std": float(np.mean(np.array(tips) < _STATED)) if tips else None,
    }
    return {"sessions without a camera file": [summary], "sessions": rows}


def _found_row(given: Measurement, outcome: Outcome, true: float) -> dict[str, Any]:
    """Return the focal length that a session tells, its error and standard deviation, %, and its tips.

    ``tips`` are the errors of the tips of ok frames in their stated standard deviations.
    """
    solved, trial = outcome.solved, outcome.trial
    row: dict[str, Any] = {"session": trial.session, "true px": round(true, 1), "focal px": None}
    if solved is None or solved.calibration.camera is None:
        return row | {"refused": outcome.refusal}
    found = solved.calibration.camera
    focal = found.focal_scale * trial.runs[0].case.camera.fx
    tips = []
    for result, run in zip(solved.results.values(), trial.runs, strict=True):
        error = error_of(given.instrument, result, run.case.truth)
        if result.status == "ok" and error is not None and error.tip_mm is not None and result.expected_error:
            tips.append(error.tip_mm / result.expected_error.of_tips_mm)
    return row | {
        "focal px": round(focal, 1),
        "off": round(100 * (focal / true - 1), 2),
        "std": round(100 * found.std_focal_scale, 2),
        "ok": len(tips),
        "tips": tips,
    }


def _row(outcome: Outcome) -> dict[str, Any]:
    """Return what a session tells about its camera; ``focal off`` is the error of the stated focal length, %."""
    trial = outcome.trial
    row: dict[str, Any] = {"session": trial.session, "kind": trial.kind, "named": False, "focal off": None}
    found = None if outcome.solved is None else outcome.solved.calibration.camera
    if found is None:
        return row | {"std": None, "insertion mm": None}
    true = 1 / _OFF[trial.kind] if trial.kind != ORIGINAL else 1.0
    readings = [run.case.readings["insertion"] for run in trial.runs]
    return row | {
        "named": found.contradicts,
        "focal off": round(100 * (found.focal_scale / true - 1), 2),
        "std": round(100 * found.std_focal_scale, 2),
        "insertion mm": round(1e3 * float(np.ptp(readings)), 1),
    }
