"""Errors that many points of a mask's contour share, and their elimination."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers.frame_terms import view_at
from helpers.transforms import lookat_pose

from dvrk_cmaes import Body, Camera
from dvrk_cmaes.config import OutlineConfig
from dvrk_cmaes.evidence.gather import gather_evidence
from dvrk_cmaes.evidence.outline_noise import OutlineNoise
from dvrk_cmaes.geometry import Posed
from dvrk_cmaes.pose.terms.coverage import Coverage
from dvrk_cmaes.pose.terms.shared_errors import SIDES, shared_errors, without_last
from dvrk_cmaes.pose.terms.sized_view import SizedView
from dvrk_cmaes.pose.terms.term import Quadratic
from dvrk_cmaes.silhouette import OutlinePoints

CAMERA = Camera(320, 240, 440, 440, 160, 120)
TRUE = Posed(lookat_pose(0.5, 1.0, 0.7, 0.11), np.array([0.4, -0.3, 0.5]))
NOISE = OutlineNoise(0.5, 8.0)


def outline_of(body: Body) -> OutlinePoints:
    return SizedView(view_at(body, CAMERA, TRUE), blur=1.2).outlines(Posed.stacked([TRUE]))[0]


def errors_of(
    body: Body, noise: OutlineNoise = NOISE, offsets: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray]:
    return shared_errors(outline_of(body), body.instrument, CAMERA, TRUE, noise, offsets)


def test_nodes_of_a_side_of_the_shaft_add_up_to_the_side(bundled_body: Body) -> None:
    """The error between two nodes is linear; if both are off by a pixel, so is all of the contour between them."""
    outline, (columns, deviations) = outline_of(bundled_body), errors_of(bundled_body)
    sides = columns[:, :SIDES]
    assert set(np.unique(sides)) == {0.0, 1.0}
    np.testing.assert_array_equal(sides.sum(axis=1), outline.link == 0)
    of_shaft = columns[outline.link == 0]
    nodes = of_shaft[:, (deviations == 0.2 * NOISE.sigma)]
    assert nodes.sum(axis=1).max() == pytest.approx(1.0)


def test_noise_over_much_contour_tells_of_shadows(bundled_body: Body) -> None:
    usual, long = (errors_of(bundled_body, OutlineNoise(1.0, length))[1] for length in (15.0, 35.0))
    assert (long >= usual).all()
    assert long.max() > 2 * usual.max()


def test_a_side_whose_mask_is_far_from_the_outline_is_expected_to_err_as_much(bundled_body: Body) -> None:
    """A shadow beside one side of the shaft: that side tells little, and the other one as much as without it."""
    columns, usual = errors_of(bundled_body)
    _, seen = errors_of(bundled_body, offsets=6.0 * columns[:, 0])
    assert seen[0] > 6.0
    assert seen[1] == usual[1]
    assert seen[SIDES] == usual[SIDES]  # the margin of the whole mask
    _, seen = errors_of(bundled_body, offsets=-6.0 * columns[:, 1])
    np.testing.assert_array_equal(seen[:SIDES] > 6.0, [False, True])


def test_shadow_beside_the_shaft_hardly_moves_a_fit_that_sees_it(bundled_body: Body) -> None:
    """At the true pose, the step to a mask whose one side is 5 px too far out is small if the shadow is seen."""
    view = view_at(bundled_body, CAMERA, TRUE)
    aside = np.roll(view.evidence.mask, 5, axis=1)
    shadowed = gather_evidence(view.evidence.mask | aside, CAMERA, bundled_body.instrument, features=False)
    outline = OutlineConfig()
    coverage = Coverage([SizedView(replace(view, evidence=shadowed), blur=outline.blur)], outline)
    steps = []
    for as_seen in (False, True):
        terms = without_last(coverage.near_with_sides(TRUE, [NOISE], as_seen=as_seen), np.eye(SIDES))
        known = terms.information[0] + np.diag([1 / 0.001**2] * 3 + [1 / 0.02**2] * 6)
        steps.append(np.linalg.norm(np.linalg.solve(known, terms.slope[0])[:3]))
    assert steps[1] < 0.5 * steps[0]


def test_elimination_leaves_the_marginal_of_the_pose() -> None:
    rng = np.random.default_rng(0)
    jacobian, residuals = rng.normal(size=(30, 7)), rng.normal(size=30)
    terms = Quadratic((jacobian.T @ jacobian)[None], (jacobian.T @ residuals)[None])
    left = without_last(terms, np.diag([4.0, 1.0, 0.25]))
    whole = terms.information[0] + np.diag([0, 0, 0, 0, 4.0, 1.0, 0.25])
    covariance = np.linalg.inv(whole)
    np.testing.assert_allclose(np.linalg.inv(left.information[0]), covariance[:4, :4])
    best = -covariance @ terms.slope[0]
    np.testing.assert_allclose(-np.linalg.solve(left.information[0], left.slope[0]), best[:4])


@pytest.mark.parametrize(("stride", "as_seen"), [(1, False), (1, True), (3, True)])
def test_terms_are_those_of_columns_that_are_eliminated(bundled_body: Body, stride: int, as_seen: bool) -> None:
    """The shared errors as further unknowns of the outline, eliminated with what is known of them beforehand."""
    view = SizedView(view_at(bundled_body, CAMERA, TRUE), blur=1.2)
    coverage, at = Coverage([view], OutlineConfig()), TRUE.moved(np.full(9, 3e-3))
    (drawn,) = coverage.draw(Posed.stacked([at]))
    outline = OutlinePoints(drawn[0].link, drawn[0].pixels, drawn[0].normals, drawn[0].points).every(stride)
    offsets = view.offsets(outline) if as_seen else None
    shares, deviations = shared_errors(outline, bundled_body.instrument, CAMERA, at, NOISE, offsets)

    def columns(_: int, points: OutlinePoints, by_pose: np.ndarray) -> np.ndarray:
        return shares * np.linalg.norm(points.normals, axis=1)[:, None]

    exact = OutlineNoise(1e-9, 8.0)  # so that the errors are known but for those that last, which are left out
    dense = coverage.near_with_sides(at, [exact], columns, drawn, stride=stride)
    own = dense.dimension - SIDES
    expected = without_last(
        Quadratic(dense.information[:, :own, :own], dense.slope[:, :own]), np.diag(1 / deviations**2)
    )
    sparse = coverage.near_with_sides(at, [NOISE], None, drawn, stride=stride, as_seen=as_seen)
    found = without_last(sparse, np.eye(SIDES))
    np.testing.assert_allclose(found.information, expected.information, rtol=1e-6)
    np.testing.assert_allclose(found.slope, expected.slope, rtol=1e-6)
