"""Whether frames fit another instrument better than the one that a session was solved with."""

from __future__ import annotations

from dataclasses import replace

import pytest
from helpers.page_calibrations import calibration, solved

from dvrk_cmaes.calibration.document import SessionCalibration
from dvrk_cmaes.calibration.instrument_test import (
    CandidateFit,
    better_instrument,
    fitting_instruments,
    undetermined_instrument,
)
from dvrk_cmaes.calibration.session_doubts import doubts_of

NAMES = ("0000", "0001", "0002", "0003")
OWN = {name: (0.76 + 0.01 * k, 2.0) for k, name in enumerate(NAMES)}


def by_other(better: float, scatter: float = 0.01) -> dict[str, tuple[float, float]]:
    return {name: (OWN[name][0] + better + scatter * (-1) ** k, 2.0) for k, name in enumerate(NAMES)}


def test_instrument_that_predicts_left_out_frames_better_is_a_doubt() -> None:
    fit = CandidateFit.of("400093", by_other(0.15), OWN)
    assert (fit.frames, fit.is_better, fit.is_worse) == (4, True, False)
    assert (fit.difference, fit.std_difference) == (pytest.approx(0.15), pytest.approx(0.01 / 3**0.5))
    one = replace(calibration(solved(NAMES), iou=0.9, leave_one_out=OWN), instruments=(fit,))
    (text,) = doubts_of(one)
    assert text == "these frames fit 400093 better (leave-one-out 0.93 against 0.78)"
    assert undetermined_instrument([fit], "lnd") == ""


def test_instruments_that_are_not_told_from_the_better_one_are_named_with_it() -> None:
    """As of a ProGrasp that was solved as a needle driver: a dissector with the same shaft predicts it as well."""
    best, nearly = CandidateFit.of("400172", by_other(0.036), OWN), CandidateFit.of("400093", by_other(0.025), OWN)
    assert not nearly.is_better
    text = better_instrument([nearly, best, CandidateFit.of("400194", "refused", OWN)], 0.775)
    assert text == "these frames fit 400172 or 400093 better (leave-one-out 0.81, 0.80 against 0.78)"


def test_refused_session_names_the_instruments_that_it_fits() -> None:
    assert fitting_instruments({"400172": "expected at least 3 frames that agree"}) == ""
    text = fitting_instruments({"400172": OWN, "400183": "refused", "400093": by_other(0.02)})
    assert text == "these frames fit 400093 (leave-one-out 0.79), 400172 (leave-one-out 0.78)"


def test_worse_or_refused_instrument_is_told() -> None:
    worse = CandidateFit.of("400172", by_other(-0.1), OWN)
    refused = CandidateFit.of("400194", "expected at least 3 frames that agree", OWN)
    assert worse.is_worse
    assert refused.is_worse
    assert better_instrument([worse, refused], 0.775) == undetermined_instrument([worse, refused], "400093") == ""


@pytest.mark.parametrize(("better", "scatter"), [(0.02, 0.001), (0.05, 0.1), (-0.05, 0.1)])
def test_instruments_that_predict_alike_are_not_told(better: float, scatter: float) -> None:
    alike = CandidateFit.of("400194", by_other(better, scatter), OWN)
    assert better_instrument([alike], 0.775) == ""
    assert undetermined_instrument([alike], "400093") == "instrument: not told: 400093 or 400194"


def test_tried_instruments_are_read_back() -> None:
    tried = (CandidateFit.of("400093", by_other(0.15), OWN), CandidateFit.of("400194", "refused", OWN))
    before = replace(calibration(solved(NAMES), leave_one_out=OWN), instruments=tried)
    after = SessionCalibration.from_dict(before.to_dict())
    assert [one.instrument for one in after.instruments] == ["400093", "400194"]
    assert after.instruments[0].difference == pytest.approx(0.15)
    assert after.instruments[1].refused == "refused"
