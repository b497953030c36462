"""The comparison of the bases of a session's halves."""

from __future__ import annotations

import numpy as np
import pytest

from dvrk_cmaes.calibration.calibrate import SolvedSession
from dvrk_cmaes.calibration.document import SessionCalibration
from dvrk_cmaes.calibration.model import BASE_AXES
from dvrk_cmaes.geometry import moved

pytestmark = pytest.mark.usefixtures("scripts_on_path")

STD = np.array([1e-4, 1e-4, 2e-4, 1e-3, 1e-3, 2e-3])


def outcome(off: np.ndarray, name: str = "easy1", frames: int = 4) -> object:
    from measure.accuracy.sessions import Outcome, Trial
    from measure.cases import Run

    calibration = SessionCalibration(
        instrument="lnd",
        camera_from_base=moved(np.eye(4), off),
        offsets={},
        axes=BASE_AXES,
        covariance=np.diag(STD**2),
        covariance_given_camera=np.diag(STD**2),
        spreads={},
    )
    runs = [Run(None, None)] * frames  # type: ignore[arg-type]
    return Outcome(Trial(name, "easy", "original", runs, np.eye(4)), SolvedSession(calibration, {}, {}))


def test_difference_is_in_standard_deviations_of_each_axis() -> None:
    from measure.accuracy.halves import halves_report

    off = np.zeros(6)
    off[2] = 4e-4
    report = halves_report([outcome(np.zeros(6)), outcome(off)])  # type: ignore[list-item]
    summary, rows = report.values()
    assert rows[0]["axes"] == "0.0 0.0 1.4 0.0 0.0 0.0"
    assert rows[0]["mm"] == pytest.approx(0.4)
    assert rows[0]["frames"] == 8
    assert summary[0]["largest"] == pytest.approx(2**0.5)
    assert summary[0]["rms"] == pytest.approx((2 / 6) ** 0.5)


def test_halves_are_the_first_and_the_last_frames() -> None:
    from measure.accuracy.halves import halved

    whole = outcome(np.zeros(6), frames=5)
    first, second = halved([whole.trial])  # type: ignore[attr-defined]
    assert (len(first.runs), len(second.runs)) == (2, 3)


def test_refused_half_is_reported() -> None:
    from measure.accuracy.halves import halves_report
    from measure.accuracy.sessions import Outcome

    good = outcome(np.zeros(6))
    bad = Outcome(good.trial, None, "session: too few frames")  # type: ignore[attr-defined]
    summary, rows = halves_report([good, bad]).values()  # type: ignore[list-item]
    assert summary == []
    assert rows[0]["refused"] == "session: too few frames"
