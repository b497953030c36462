"""scripts/accuracy.py fleet --calibrate-every: the true lag of a recording, and the figures of all calibrations."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from dvrk_cmaes.instrument.arm import OUTER_JOINTS, base_from_root
from dvrk_cmaes.joints.series import ReadingSeries

Float64 = NDArray[np.float64]

pytestmark = pytest.mark.usefixtures("scripts_on_path")

LAG = 2.4
"""Frames, of the recording."""


def outer_at(times: Float64) -> Float64:
    """Outer joints (N, 4) of an arm that moves, at times (N,), s."""
    rates = np.array([2.0, 2.7, 1.6, 3.1])
    return np.array([0.3, 0.1, 0.18, 0.5]) + np.array([0.2, 0.2, 0.02, 0.5]) * np.sin(np.outer(times, rates))


def test_true_lag_is_where_the_readings_place_the_root() -> None:
    from measure.accuracy.fleet_calibrations import true_lag

    times = np.arange(90) / 30
    base = np.eye(4)
    base[:3, 3] = 0.1, 0.0, 0.2
    rows = dict(zip(OUTER_JOINTS, outer_at(times).T, strict=True))
    names = [f"{i:04d}" for i in range(len(times))]
    series = ReadingSeries("s", dict.fromkeys(rows, times), rows, dict(zip(names, times, strict=True)), 1 / 30)
    shown = base @ base_from_root(outer_at(times - LAG / 30))
    truths = {name: {"T_camera_roll_link": pose.tolist()} for name, pose in zip(names, shown, strict=True)}
    assert true_lag(truths, base, series) == pytest.approx(LAG, abs=0.05)


def one(tips: float | None, lag: float | None, std: float | None = 0.1, doubt: str = "no") -> dict[str, Any]:
    return {"tips, mm": tips, "lag": lag, "std": std, "true lag": 3.0, "base / std": 1.0, "doubt": doubt}


def test_pooled_figures_count_lags_and_bad_calibrations() -> None:
    from measure.accuracy.fleet_calibrations import CalibratedRecording, pooled

    rows = [one(0.5, 3.1), one(0.6, 3.5), one(1.5, None, None, "yes"), one(2.0, 2.9), one(None, None, None, "refused")]
    errors = [np.full(3, row["tips, mm"] or 0.0) if row["tips, mm"] else np.zeros(0) for row in rows]
    figures = pooled([CalibratedRecording(*pair) for pair in zip(rows, errors, strict=True)])
    assert figures["recordings"] == 5
    assert figures["worst median"] == 2.0
    assert figures["tips, mm"] == pytest.approx(1.05)
    assert figures["lag told"] == 3
    assert figures["within 0.3 frames or untold"] == 4
    assert figures["95 % holds"] == 2
    assert figures["bad"] == 3
    assert figures["bad that say so"] == 2
    assert figures["base within 3 std"] == 4
