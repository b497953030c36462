"""Readings of a recording's frames before the first and after the last ones, for what is predicted there."""

from __future__ import annotations

import numpy as np

from dvrk_cmaes.runs.recorded import _continued

TIMES = np.arange(12) / 30


def continued(told: np.ndarray, values: np.ndarray) -> np.ndarray:
    known = np.flatnonzero(told)
    nearest = known[np.abs(np.arange(len(told))[:, None] - known).argmin(axis=1)]
    return _continued(values, TIMES, told, nearest)


def test_readings_go_on_at_their_rate_for_some_frames() -> None:
    true = np.column_stack([0.1 + 0.6 * TIMES, np.full(12, 0.3)])
    told = (np.arange(12) >= 2) & (np.arange(12) < 11)
    values = np.where(told[:, None], true, np.nan)
    assert np.allclose(continued(told, values), true)


def test_readings_stand_still_farther_away_and_beside_a_single_one() -> None:
    true = np.column_stack([TIMES])
    told = np.arange(12) >= 9
    found = continued(told, np.where(told[:, None], true, np.nan))[:, 0]
    assert np.allclose(found[:3], TIMES[9])
    assert np.allclose(found[3:], TIMES[3:])
    alone = np.arange(12) == 5
    assert np.allclose(continued(alone, np.where(alone[:, None], true, np.nan)), TIMES[5])
