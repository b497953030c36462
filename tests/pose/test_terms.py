"""All terms of a frame: their derivatives are those of their sums of squares."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pytest
from helpers.frame_terms import cost_of, local_of, readings_of, view_at
from helpers.transforms import exp_rotation, lookat_pose, transform

from dvrk_cmaes import Body, Camera
from dvrk_cmaes.config import OutlineConfig
from dvrk_cmaes.geometry import Posed
from dvrk_cmaes.pose.refine import DERIVATIVES
from dvrk_cmaes.pose.search.objective import project_tips
from dvrk_cmaes.pose.terms.coverage import Coverage
from dvrk_cmaes.pose.terms.sized_view import OutlineTerm, SizedView
from dvrk_cmaes.pose.terms.term import Term
from dvrk_cmaes.pose.terms.tips_term import Expected, ReadingsTerm, TipsTerm

CAMERA = Camera(640, 480, 880, 880, 330, 250, (-0.2, 0.05, 0.001, 0.0, 0.0))
RIGHT_FROM_LEFT = transform(exp_rotation([0.01, -0.02, 0.01]), [-0.005, 0.0, 0.0003])
TRUE = Posed(lookat_pose(0.5, 1.0, 0.7, 0.11), np.array([0.4, -0.3, 0.5]))
OFF = np.array([2e-4, -2e-4, 6e-4, 0.006, -0.008, 0.02, 0.02, -0.03, 0.02])
STEPS = np.array([2e-5] * 3 + [5e-4] * 2 + [2e-3] * 4)  # of the central differences
SPREAD = np.array([6e-4] * 3 + [0.02] * 2 + [0.09] * 4)  # of the changes for which derivatives count alike


def readings(body: Body) -> Term:
    low_jaw = readings_of(body, np.array([0.3, np.nan, 0.4]))
    low_jaw.high[2] = 0.45  # the jaw is beyond it
    return ReadingsTerm(low_jaw)


def tips(body: Body) -> Term:
    given = project_tips(body.instrument, CAMERA, TRUE.seen_from(RIGHT_FROM_LEFT)[None])[0, ::-1] + [3.0, -2.0]
    view = view_at(body, CAMERA, TRUE, RIGHT_FROM_LEFT, tips=given)
    (term,) = TipsTerm.of_views([view_at(body, CAMERA, TRUE), view], OutlineConfig())
    return term


def expected(body: Body) -> Term:
    root = np.random.default_rng(0).normal(size=(9, 9)) / SPREAD
    return Expected(TRUE, root.T @ root)


def coverage(body: Body) -> OutlineTerm[object]:
    views = [view_at(body, CAMERA, TRUE), view_at(body, CAMERA, TRUE, RIGHT_FROM_LEFT)]
    return Coverage([SizedView(view, blur=1.2) for view in views], OutlineConfig(cauchy=10.0), correlations=[8, 12])


@dataclass(frozen=True)
class Case:
    """A term, and how exact its approximation is beside that of its largest derivative."""

    make: Callable[[Body], Term | OutlineTerm[object]]
    tolerance: float
    squares_only: bool = True


CASES = {
    "readings": Case(readings, 1e-6),
    "tips": Case(tips, 2e-3),
    "expected": Case(expected, 0.02),
    "coverage": Case(coverage, 0.12),
}


@pytest.mark.parametrize("name", CASES)
def test_local_is_the_derivative_of_cost(bundled_body: Body, name: str) -> None:
    case = CASES[name]
    term, at = case.make(bundled_body), TRUE.moved(OFF)
    information, slope = (part[0] for part in local_of(term, at[None]).normal_equations(np.zeros((1, 9))))
    changes = np.diag(STEPS)
    ahead, behind = (cost_of(term, Posed.stacked([at.moved(sign * change) for change in changes])) for sign in (1, -1))
    # of half the sum of squares, in units in which the unknowns count alike
    gradient = (ahead - behind) / (4 * STEPS) * SPREAD
    np.testing.assert_allclose(slope * SPREAD, gradient, atol=case.tolerance * np.abs(gradient).max())
    np.testing.assert_allclose(information, information.T, rtol=1e-5, atol=1e-9 * np.abs(information).max())
    assert np.linalg.eigvalsh(information * np.outer(SPREAD, SPREAD)).min() > -1e-6 * np.abs(information).max()


@pytest.mark.parametrize("name", CASES)
def test_information_tells_how_fast_the_slope_changes(bundled_body: Body, name: str) -> None:
    term = CASES[name].make(bundled_body)
    change = OFF / 20
    slopes = [local_of(term, at[None]).normal_equations(np.zeros((1, 9)))[1][0] for at in (TRUE, TRUE.moved(change))]
    information = local_of(term, TRUE[None]).normal_equations(np.zeros((1, 9)))[0][0]
    expected_change = information @ change * SPREAD
    np.testing.assert_allclose(
        (slopes[1] - slopes[0]) * SPREAD, expected_change, atol=0.25 * np.abs(expected_change).max() + 1e-9
    )


@pytest.mark.parametrize("shrink", [1, 2])
def test_differences_of_outlines_are_the_derivatives_in_closed_form(bundled_body: Body, shrink: int) -> None:
    views = [view_at(bundled_body, CAMERA, TRUE), view_at(bundled_body, CAMERA, TRUE, RIGHT_FROM_LEFT)]
    term = Coverage([SizedView(view, blur=1.2, shrink=shrink) for view in views], OutlineConfig())
    at = Posed.stacked([TRUE.moved(OFF), TRUE.moved(-OFF)])
    (closed, differences) = (term.draw(at, derivatives=name) for name in DERIVATIVES)
    for one, other in zip(closed, differences, strict=True):
        for exact, found in zip(one, other, strict=True):
            assert found.differenced
            assert not exact.differenced
            np.testing.assert_array_equal(exact.pixels, found.pixels)
            moved = exact.jacobian * SPREAD, found.jacobian * SPREAD
            off = np.abs(moved[0] - moved[1]).max(axis=1)
            assert np.median(off) < 0.02 * np.abs(moved[0]).max()
            assert (off > 0.15 * np.abs(moved[0]).max()).mean() < 0.05
    (of_closed, of_differences) = (
        term.near(drawn, at).normal_equations(np.zeros((2, 9))) for drawn in (closed, differences)
    )
    for exact, found, units in zip(of_closed, of_differences, (np.outer(SPREAD, SPREAD), SPREAD), strict=True):
        np.testing.assert_allclose(found * units, exact * units, atol=0.08 * np.abs(exact * units).max())


def test_terms_of_several_poses_are_those_of_each(bundled_body: Body) -> None:
    poses = Posed.stacked([TRUE, TRUE.moved(OFF), TRUE.moved(-OFF)])
    for name, case in CASES.items():
        term = case.make(bundled_body)
        alone = np.concatenate([cost_of(term, poses[k][None]) for k in range(3)])
        np.testing.assert_allclose(cost_of(term, poses), alone, rtol=1e-4, err_msg=name)
