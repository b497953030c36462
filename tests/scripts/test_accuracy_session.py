"""Evaluation of calibrated sessions: errors in standard deviations, intervals, and the naming of false inputs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from dvrk_cmaes.calibration.calibrate import SolvedSession
from dvrk_cmaes.calibration.document import SessionCalibration
from dvrk_cmaes.calibration.model import BASE_AXES
from dvrk_cmaes.geometry import moved
from dvrk_cmaes.joints.lag import Lag
from dvrk_cmaes.results.result import Result

BASE = moved(np.eye(4), [0.01, 0.02, 0.15, 0.9, 1.8, -0.4])
SPREAD = np.array([1e-4, 2e-4, 3e-4, 0.001, 0.002, 0.003])

pytestmark = pytest.mark.usefixtures("scripts_on_path")

if TYPE_CHECKING:
    from measure.accuracy.sessions import Outcome
    from measure.cases import Case


@pytest.fixture(name="cases")
def ten_cases(cases: list[Case]) -> list[Case]:
    return [replace(cases[k % len(cases)], frame=f"{k:04d}") for k in range(10)]


def outcome(cases: Sequence[Case], off: np.ndarray, kind: str = "honest", **fields: Any) -> Outcome:
    """Make a session whose base deviates by a small change ``off`` (6,), in its own axes, from the true one."""
    from measure.accuracy.sessions import Outcome, Trial
    from measure.cases import Run

    runs = [Run(case, Result.failed("", "", {}, instrument="lnd", root_link="roll_link")) for case in cases]
    calibration = SessionCalibration(
        instrument="lnd",
        camera_from_base=BASE,
        offsets={},
        axes=BASE_AXES,
        covariance=np.diag(SPREAD**2),
        covariance_given_camera=np.diag(SPREAD**2),
        spreads={},
        **fields,
    )
    return Outcome(Trial("s", "easy", kind, runs, moved(BASE, off)), SolvedSession(calibration, {}, {}))


def test_errors_are_in_standard_deviations(cases: list[Case]) -> None:
    from measure.accuracy.sessions import base_error, deviations

    one = outcome(cases, np.array([0, 4e-4, 0, 0, 0, 0]))
    assert deviations(one) == pytest.approx([0, 2, 0, 0, 0, 0, 4, 0], abs=1e-9)
    assert base_error(one) == pytest.approx((0, 0.4), abs=1e-5)
    one = outcome(cases, np.array([0, 0, 0, 0, 0, 0.009]))
    assert deviations(one) == pytest.approx([0, 0, 0, 0, 0, 3, 0, 9], abs=1e-9)
    assert base_error(one) == pytest.approx((np.degrees(0.009), 0), abs=1e-5)


def test_intervals_are_counted_by_quantity(cases: list[Case]) -> None:
    from measure.accuracy.sessions import interval_rows

    outcomes = [outcome(cases, SPREAD * times) for times in (0.5, 1.0, 1.5, 3.0)]
    rows = {row["quantity"]: row for row in interval_rows(outcomes)}
    assert list(rows) == [*BASE_AXES, "origin", "rotation"]
    assert rows["tx"]["held"] == 0.75
    assert rows["rotation"]["held"] == 0.75
    assert rows["origin"]["rms_z"] == pytest.approx(np.sqrt(np.mean([0.25, 1, 2.25, 9])), rel=0.01)
    mixed = [replace(one, trial=replace(one.trial, level=level)) for one, level in zip(outcomes, "aabb", strict=True)]
    assert [row["level"] for row in interval_rows(mixed)] == ["a"] * 8 + ["b"] * 8 + ["all"] * 8


def test_false_inputs_change_stated_part(cases: list[Case]) -> None:
    from measure.accuracy.session_lies import FOREIGN_MASKS, LATE, falsified_session_cases

    other = replace(cases[0].recording, session=replace(cases[0].recording.session, folder=Path("other")))
    others = [replace(case.with_mask(~case.mask), recording=other) for case in cases]
    made = [case for case in falsified_session_cases({"demo": cases, "other": others}) if case.session == "demo"]
    strange = [case for case in made if case.kind == FOREIGN_MASKS]
    assert [case.frame for case in strange] == ["0001", "0005", "0008"]
    for case in strange:
        own = cases[int(case.frame)]
        np.testing.assert_array_equal(case.mask, others[int(case.frame)].mask)
        assert case.readings == own.readings
    late = [case for case in made if case.kind == LATE]
    assert [case.frame for case in late] == [f"{k:04d}" for k in range(2, 10)]
    for case in late:
        assert case.readings == cases[int(case.frame) - 2].readings
        assert case.mask is cases[int(case.frame)].mask


def test_false_input_counts_as_named_by_its_own_message_only(cases: list[Case]) -> None:
    from measure.accuracy.session_lies import FOREIGN_MASKS, LATE, MOVED, WRONG_ARM, falsified_report, named

    still, said = (
        np.zeros(6),
        "the arm's base or the camera moved between frames 0004 and 0005: 2 bases, and all else is shared",
    )
    right = [
        outcome(cases, still, FOREIGN_MASKS, left_out={"0001": "", "0005": "", "0008": ""}),
        outcome(cases, still, LATE, lag=Lag(-2.1, 0.1)),
        outcome(cases, still, MOVED, remarks=(said,)),
        replace(outcome(cases, still, WRONG_ARM), solved=None, refusal="session: the readings fit an arm 51 mm longer"),
    ]
    wrong = [
        outcome(cases, still, FOREIGN_MASKS, left_out={"0001": "", "0005": ""}),
        outcome(cases, still, LATE, lag=Lag(-1.0, 0.1)),
        outcome(cases, still, MOVED, remarks=(said.replace("0004", "0003"),)),
        outcome(cases, still, WRONG_ARM),
    ]
    assert [named(one) for one in right] == [True] * 4
    assert [named(one) for one in wrong] == [False] * 4
    counts = falsified_report(right + wrong)["lies named"]
    assert [(one["kind"], one["named"]) for one in counts] == [
        (kind, 0.5) for kind in (FOREIGN_MASKS, LATE, MOVED, WRONG_ARM)
    ]
