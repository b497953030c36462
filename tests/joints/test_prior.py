"""Readings of one frame and joint limits as a prior."""

from __future__ import annotations

import numpy as np

from dvrk_cmaes import Body
from dvrk_cmaes.joints.prior import LIMIT_SIGMA, Readings


def test_without_readings_only_limits_count(bundled_body: Body) -> None:
    instrument = bundled_body.instrument
    readings = Readings.none(instrument)
    within = instrument.limits.mean(axis=1)
    assert readings.cost(within) == 0
    assert np.isclose(readings.cost(np.where(np.arange(3) == 0, readings.high + 2 * LIMIT_SIGMA, within)), 4)


def test_jaws_do_not_pass_through_each_other(bundled_body: Body) -> None:
    jaw = bundled_body.instrument.joint_index("jaw")
    assert Readings.none(bundled_body.instrument).low[jaw] == 0
