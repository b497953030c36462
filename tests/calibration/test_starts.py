"""The starts of a frame's fits: one where it agrees with its session, several where it does not, none if settled."""

from __future__ import annotations

import numpy as np
import pytest

from dvrk_cmaes.calibration.consensus import Mode
from dvrk_cmaes.calibration.frame_fit import FrameFit
from dvrk_cmaes.calibration.starts import first_starts, next_starts
from dvrk_cmaes.geometry import Posed, change_between, moved
from dvrk_cmaes.pose.search.starts import lookat_pose
from dvrk_cmaes.pose.terms.expected import Expected

POSE, JOINTS = lookat_pose(0.5, 1.0, 0.7, 0.11), np.array([0.4, -0.3, 0.5])
PRECISION = np.diag([1e8] * 3 + [1e4] * 6)  # of a tenth of a millimetre and a hundredth of a radian
TURN = 0.35
MODE, TWIN = (
    Mode(Posed(moved(POSE, [0, 0, 0, 0, 0, angle]), JOINTS), np.linalg.inv(PRECISION)) for angle in (0.0, np.pi)
)
AGREES, DISAGREES = 0.5, 20.0


def prior(shift: float) -> Expected:
    """Give a prior ``shift`` tenths of a millimetre away along the root's x axis."""
    return Expected(Posed(moved(POSE, np.array([1e-4 * shift, 0, 0, 0, 0, 0])), JOINTS), PRECISION)


def fitted() -> FrameFit:
    """Give the fit of an outline as precise as the prior, at its own optimum and at the mean of ``prior(0)``."""
    return FrameFit(Posed(POSE, JOINTS), PRECISION, np.zeros(9), score=0.0)


def turns(starts: tuple[Posed, ...]) -> list[float]:
    """Give the angles about the shaft from `POSE` to the starts, rad."""
    return [float(change_between(POSE, start.pose)[5]) for start in starts]


def test_agreeing_frame_starts_from_its_chosen_mode_only() -> None:
    (start,) = first_starts([TWIN, MODE], MODE, AGREES, prior(1.0), TURN)
    assert start is MODE.at


def test_disagreeing_frame_starts_from_all_modes_and_around_what_is_expected() -> None:
    found = first_starts([MODE, TWIN], MODE, DISAGREES, prior(0.0), TURN)
    assert np.abs(turns(found)) == pytest.approx([0, np.pi, 0, TURN, TURN], abs=1e-6)
    assert turns(found)[3] == pytest.approx(-turns(found)[4])


def test_fit_that_would_not_move_is_settled() -> None:
    assert next_starts(fitted(), AGREES, prior(0.0), TURN, last=True) == ()


def test_frame_that_nearly_agrees_starts_from_its_chosen_mode_only() -> None:
    assert len(first_starts([MODE, TWIN], TWIN, 3.0, prior(1.0), TURN)) == 1


def test_small_move_only_counts_in_the_last_round() -> None:
    # the posterior of both moves by half the way, 0.71 of its standard deviations, in one of nine parameters: 0.24 each
    assert next_starts(fitted(), AGREES, prior(0.5), None, last=True) == ()
    assert next_starts(fitted(), AGREES, prior(1.0), None, last=False) == ()
    (start,) = next_starts(fitted(), AGREES, prior(1.0), None, last=True)
    assert change_between(POSE, start.pose)[:3] == pytest.approx([0.5e-4, 0, 0], abs=1e-9)
    assert start.joints == pytest.approx(JOINTS)


def test_far_move_and_disagreement_start_from_both_sides() -> None:
    assert len(next_starts(fitted(), AGREES, prior(30.0), None, last=False)) == 2
    assert len(next_starts(fitted(), DISAGREES, prior(0.0), TURN, last=False)) == 4
    assert next_starts(fitted(), DISAGREES, prior(0.0), None, last=False) == ()


def test_changed_camera_fits_every_frame_again() -> None:
    new = prior(5.0).mean
    assert next_starts(fitted(), AGREES, prior(0.0), None, last=True, changed=new) == (new,)
    assert len(next_starts(fitted(), DISAGREES, prior(0.0), None, last=True, changed=new)) == 2
