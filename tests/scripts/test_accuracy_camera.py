"""Evaluation of the test of camera files: wrong files, and the count of sessions that name them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
import pytest

from dvrk_cmaes.calibration.calibrate import SolvedSession
from dvrk_cmaes.calibration.document import SessionCalibration
from dvrk_cmaes.calibration.model import BASE_AXES
from dvrk_cmaes.calibration.session_camera import SessionCamera
from dvrk_cmaes.results.result import Result

pytestmark = pytest.mark.usefixtures("scripts_on_path")

if TYPE_CHECKING:
    from measure.accuracy.sessions import Outcome
    from measure.cases import Case


def outcome(cases: Sequence[Case], focal_scale: float | None, *, contradicts: bool) -> Outcome:
    """Make a calibrated session that states a factor on the focal length, or none."""
    from measure.accuracy.sessions import Outcome, Trial
    from measure.cases import Run

    camera = None
    if focal_scale is not None:
        camera = SessionCamera(
            focal_scale, 0.01, (0.0, 0.0), (5.0, 5.0), contradicts=contradicts, applied=False, width=640
        )
    calibration = SessionCalibration(
        instrument="lnd",
        camera_from_base=np.eye(4),
        offsets={},
        axes=BASE_AXES,
        covariance=np.eye(6),
        covariance_given_camera=np.eye(6),
        spreads={},
        camera=camera,
    )
    trial = Trial(
        cases[0].session,
        "demo",
        cases[0].kind,
        [Run(case, Result.failed("", "", {}, instrument="lnd", root_link="roll_link")) for case in cases],
        np.eye(4),
    )
    return Outcome(trial, SolvedSession(calibration, {}, {}))


def test_wrong_file_changes_focal_lengths_alone(cases: list[Case]) -> None:
    from measure.accuracy.camera import wrong_camera_cases

    wrong = wrong_camera_cases(cases)
    assert len(wrong) == len(cases)
    for before, after in zip(cases, wrong, strict=True):
        assert after.camera.fx == pytest.approx(before.camera.fx / 1.1)
        assert after.camera.fy == pytest.approx(before.camera.fy / 1.1)
        assert (after.camera.cx, after.camera.cy) == (before.camera.cx, before.camera.cy)
        assert after.mask is before.mask
        assert after.kind == "focal length 10 % short"


def test_named_sessions_are_counted_by_kind(cases: list[Case]) -> None:
    from measure.accuracy.camera import camera_report, wrong_camera_cases

    wrong = wrong_camera_cases(cases)
    report = camera_report(
        [
            outcome(cases, 1.002, contradicts=False),
            outcome(cases, None, contradicts=False),
            outcome(wrong, 1.089, contradicts=True),
        ]
    )
    right, short = report["camera files named as contradicted"]
    assert right == {"kind": "honest", "sessions": 2, "named": 0, "untold": 1}
    assert short == {"kind": "focal length 10 % short", "sessions": 1, "named": 1, "untold": 0}
    assert report["sessions"][0]["focal off"] == pytest.approx(0.2)
    assert report["sessions"][2]["focal off"] == pytest.approx(-1.0)
