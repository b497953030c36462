"""scripts/accuracy.py lag: shares of lags that are found, told and claimed, checked against known answers."""

from __future__ import annotations

import pytest

from dvrk_cmaes.joints.lag import Lag

pytestmark = pytest.mark.usefixtures("scripts_on_path")


def test_shares_count_errors_intervals_and_false_claims() -> None:
    from measure.accuracy.lag import LagTrial, lag_report

    trials = [
        LagTrial("hard1", "hard", 4.0, Lag(4.1, 0.1)),
        LagTrial("hard2", "hard", 4.0, Lag(4.5, 0.1)),
        LagTrial("hard3", "hard", 2.0, None),
        LagTrial("hard4", "hard", 0.0, Lag(0.1, 0.1, applied=False)),
        LagTrial("hard5", "hard", 0.0, Lag(0.5, 0.2)),
    ]
    report = lag_report(trials)
    (row,) = report["lags found"]
    assert row == {
        "level": "hard",
        "late": 3,
        "within 0.3 frame or untold": 2,
        "untold": 1,
        "95 % interval holds": "2 of 4",
        "without lag": 2,
        "claimed there": 1,
    }
    assert report["recordings"][1] == {
        "session": "hard2",
        "lag": 4.0,
        "found": 4.5,
        "std": 0.1,
        "error": 0.5,
        "in std": pytest.approx(5.0),
        "claimed": True,
    }
    assert report["recordings"][2] == {"session": "hard3", "lag": 2.0}
