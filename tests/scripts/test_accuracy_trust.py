"""The checks of expected errors, mode probabilities and statuses, on outcomes whose figures are known."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest

if TYPE_CHECKING:
    from measure.accuracy.trust import Outcomes

pytestmark = pytest.mark.usefixtures("scripts_on_path")


def outcomes(count: int = 4000, stated: float = 1.0) -> Outcomes:
    """Make outcomes of normal errors with standard deviations of 0.2 to 3 mm, stated ``stated`` times as large."""
    from measure.accuracy.trust import Outcomes

    rng = np.random.default_rng(0)
    sigma, probability = np.exp(rng.uniform(np.log(0.2), np.log(3), count)), rng.uniform(0.5, 1, count)
    error = np.abs(sigma * rng.standard_normal(count))
    return Outcomes(
        expected_mm=stated * sigma,
        mode_probability=probability,
        ok=sigma < 1,
        right_mode=rng.uniform(size=count) < probability,
        tip_mm=error,
        squared={"tip 1": (error / (stated * sigma)) ** 2},
        freedom={"tip 1": 1},
    )


def test_right_covariance_has_its_share_in_intervals() -> None:
    from measure.accuracy.trust import interval_rows

    (row,) = interval_rows(outcomes())
    assert row["held"] == pytest.approx(0.9, abs=0.015)
    assert row["beyond_3_sigma"] == pytest.approx(0.0027, abs=0.002)
    assert row["from"] < row["held"] < row["to"]


def test_small_covariance_is_seen() -> None:
    from measure.accuracy.trust import interval_rows, tip_rows

    (row,) = interval_rows(outcomes(stated=0.5))
    assert row["held"] < 0.65
    assert row["beyond_3_sigma"] > 0.1
    assert all(one["actual_rms"] > 1.5 * one["mean_expected"] for one in tip_rows(outcomes(stated=0.5)))


def test_reliability_of_tips_and_mode_is_on_diagonal() -> None:
    from measure.accuracy.trust import mode_rows, tip_rows

    tips, modes = tip_rows(outcomes()), mode_rows(outcomes())
    assert sum(row["results"] for row in tips) == sum(row["results"] for row in modes) == 4000
    assert all(row["actual_rms"] == pytest.approx(row["mean_expected"], rel=0.15) for row in tips)
    assert all(row["right"] == pytest.approx(row["mean_stated"], abs=0.06) for row in modes)


def test_area_under_roc() -> None:
    from measure.accuracy.trust import area_under_roc

    score, positive = np.array([1.0, 2.0, 3.0, 4.0]), np.array([False, False, True, True])
    assert area_under_roc(score, positive) == 1
    assert area_under_roc(-score, positive) == 0
    assert area_under_roc(np.zeros(4), positive) == 0.5
    assert area_under_roc(score, np.ones(4, dtype=bool)) is None


def test_status_counts_right_mode_within_two_millimetres() -> None:
    from measure.accuracy.trust import Outcomes, status_row

    some = Outcomes(
        expected_mm=np.ones(4),
        mode_probability=np.ones(4),
        ok=np.array([True, True, False, False]),
        right_mode=np.array([True, False, True, True]),
        tip_mm=np.array([0.5, 0.5, 0.5, 3.0]),
        squared={},
        freedom={},
    )
    assert status_row(some) == {"results": 4, "ok": 2, "good": 2, "good_of_ok": 0.5, "ok_of_good": 0.5}
