"""Fits of frames with a session's prior: how far they would move with another prior."""

from __future__ import annotations

import numpy as np
import pytest
from helpers.transforms import lookat_pose

from dvrk_cmaes.calibration.frame_fit import FrameFit
from dvrk_cmaes.geometry import Posed
from dvrk_cmaes.pose.terms.expected import Expected

AT = Posed(lookat_pose(0.5, 1.0, 0.7, 0.11), np.array([0.4, -0.3, 0.5]))
PRECISION = np.diag([1e8] * 3 + [1e4] * 6)  # of a tenth of a millimetre and a hundredth of a radian


def prior(shift: float) -> Expected:
    """Give a prior ``shift`` standard deviations away along the root's x axis."""
    return Expected(AT.moved(np.array([1e-4 * shift, 0, 0, 0, 0, 0, 0, 0, 0])), PRECISION)


def fitted(own: Expected) -> FrameFit:
    """Give the fit of an outline as precise as the prior, at the optimum of both together."""
    slope = -PRECISION @ AT.minus(own.mean)
    return FrameFit(AT, PRECISION, slope, score=0.0)


@pytest.mark.parametrize("shift", [0.0, 2.0])
def test_fit_stays_with_its_own_prior(shift: float) -> None:
    assert fitted(prior(shift)).step_to(prior(shift)) == pytest.approx(0.0, abs=1e-9)


def test_fit_moves_half_the_way_to_an_equally_precise_prior() -> None:
    # half a standard deviation of the prior is 0.71 of the fit's, spread over nine parameters
    assert fitted(prior(0.0)).step_to(prior(1.0)) == pytest.approx(np.sqrt(0.5) / 3, rel=1e-6)


def test_precise_outline_hardly_moves() -> None:
    precise = FrameFit(AT, 1e4 * PRECISION, np.zeros(9), score=0.0)
    assert precise.step_to(prior(1.0)) < 0.01


def test_moved_fit_is_the_optimum_of_outline_and_prior() -> None:
    found = fitted(prior(0.0)).moved_to(prior(1.0))
    assert found.at.minus(AT)[:3] == pytest.approx([0.5e-4, 0, 0], abs=1e-9)
    # where the slopes of outline and prior add up to zero
    slope = PRECISION @ found.at.minus(prior(1.0).mean)
    assert found.slope == pytest.approx(-slope, abs=1e-6 * np.abs(slope).max())
    assert found.step_to(prior(1.0)) == pytest.approx(0.0, abs=1e-6)
