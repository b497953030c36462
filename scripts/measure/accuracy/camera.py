"""Test of the camera file: sessions with the right focal length, and with files whose focal length is 10 % off.

The frames are estimated with the camera of the file, and their results are solved together. A session names its camera
if the calibration states that the frames contradict the file.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, Final

import numpy as np

from measure.accuracy.sessions import Outcome, original_trials, solve
from measure.cases import ORIGINAL, Case, Measurement

_OFF: Final = {"focal length 10 % short": 1 / 1.1, "focal length 10 % long": 1.1}
"""Factor of the file's focal length on the true one, by kind."""


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
