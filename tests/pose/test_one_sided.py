"""Masks that take a shadow for the instrument, or whose edge is cut: hypotheses of one-sided errors, and the pose."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from helpers.frame_terms import readings_of, view_of
from scipy.stats import truncnorm

from dvrk_cmaes.camera import Camera
from dvrk_cmaes.evidence.outline_noise import signed_distance
from dvrk_cmaes.geometry import Posed, apply
from dvrk_cmaes.pose.refine.gauss_newton import Steps, refine
from dvrk_cmaes.pose.refine.information import ViewAtFullSize, information_of_views
from dvrk_cmaes.pose.refine.one_sided_fit import OneSidedFit, _positive, fit_one_sided
from dvrk_cmaes.pose.search.starts import lookat_pose
from dvrk_cmaes.pose.terms.contour import CorrelatedContour
from dvrk_cmaes.pose.terms.one_sided import one_sided_errors
from dvrk_cmaes.pose.terms.readings_term import ReadingsTerm
from dvrk_cmaes.pose.terms.sized_view import SizedView
from dvrk_cmaes.pose.views import FrameView
from dvrk_cmaes.silhouette import Body, Renderer

CAMERA = Camera(640, 480, 1026, 1026, 320, 240)
TRUE = Posed(lookat_pose(0.2, 0.3, 1.0, 0.13), np.array([0.4, -0.3, 0.5]))
SHADOW_PX, REACH_PX = 7.0, 75.0


def silhouette(body: Body) -> np.ndarray:
    return Renderer(body, CAMERA).masks(TRUE.pose[None], TRUE.joints[None])[0]


def rough(exact: np.ndarray, seed: int) -> np.ndarray:
    """Give a mask whose contour has smooth errors of 0.8 px and a correlation length of about 20 px."""
    waves = cv2.GaussianBlur(np.random.default_rng(seed).standard_normal(exact.shape), (0, 0), 6.0)
    return signed_distance(exact) < 0.8 * waves / waves.std()


def near_wrist(body: Body, reach: float = REACH_PX) -> np.ndarray:
    """Give the pixels near the end of the shaft."""
    shaft = body.instrument.shaft
    assert shaft is not None
    (u, v), *_ = CAMERA.project(apply(TRUE.pose, (shaft.distal_end - 0.003) * shaft.direction[None]))
    columns, rows = np.meshgrid(np.arange(CAMERA.width), np.arange(CAMERA.height))
    return np.hypot(columns - u, rows - v) < reach


def with_shadow(body: Body, mask: np.ndarray, across: float) -> np.ndarray:
    """Give a mask with the shadow of the tool, which lies on one side of the shaft or on the other: -1 or 1."""
    axis = TRUE.pose[:2, 2] / np.linalg.norm(TRUE.pose[:2, 2])
    du, dv = SHADOW_PX * across * np.array([-axis[1], axis[0]])
    moved = cv2.warpAffine(mask.astype(np.uint8), np.array([[1, 0, du], [0, 1, dv]]), mask.shape[::-1]) > 0
    return mask | (moved & near_wrist(body))


def seen(body: Body, mask: np.ndarray) -> FrameView:
    return view_of(body, CAMERA, mask)


def fitted(body: Body, mask: np.ndarray) -> tuple[Posed, OneSidedFit]:
    """Give the pose that fits the contour best, and what hypotheses of one-sided errors say there."""
    view = SizedView(seen(body, mask), blur=1.2)
    terms = [ReadingsTerm(readings_of(body, TRUE.joints))]
    steps = Steps(10, tolerance=0.01, tested="none", largest=6.0)
    (fit,) = refine(CorrelatedContour([view]), terms, TRUE[None], steps)
    found = fit_one_sided([view], terms, fit.at)
    assert found is not None
    return fit.at, found


def depth_error(at: Posed) -> float:
    """Give how much too near a pose is, mm."""
    return float(1e3 * (TRUE.pose[2, 3] - at.pose[2, 3]))


def test_shadow_moves_the_outline_outwards_where_it_faces_it_near_the_wrist(bundled_body: Body) -> None:
    view = SizedView(seen(bundled_body, silhouette(bundled_body)), blur=1.2)
    (outline,) = view.outlines(TRUE[None])
    errors = view.one_sided_errors(outline, TRUE)
    shadows = errors.columns[:, (errors.columns >= 0).all(axis=0)]
    normals = outline.normals / np.linalg.norm(outline.normals, axis=1)[:, None]
    assert shadows.shape[1] == 16 * 3
    assert shadows.max() <= 1
    angles = 2 * np.pi * (np.arange(48) // 3) / 16
    facing = normals @ np.stack([np.cos(angles), np.sin(angles)])
    assert (shadows <= np.maximum(facing, 0) + 1e-12).all()
    assert (shadows[:, 2::3].max(axis=0) > 0.5).all()
    centre = apply(TRUE.pose, np.array([[0.0, 0.0, -0.012]]))
    far = np.linalg.norm(outline.pixels - view.camera.project(centre), axis=1) > 130
    assert far.any()
    assert (shadows[far] == 0).all()


def test_cut_moves_one_side_of_the_shaft_inwards_and_nothing_else(bundled_body: Body) -> None:
    view = SizedView(seen(bundled_body, silhouette(bundled_body)), blur=1.2)
    (outline,) = view.outlines(TRUE[None])
    errors = view.one_sided_errors(outline, TRUE)
    cuts = errors.columns[:, (errors.columns < 0).any(axis=0)]
    assert (cuts <= 0).all()
    assert (cuts[outline.link != 0] == 0).all()
    assert errors.probabilities.sum() == pytest.approx(0.6)


def test_instrument_without_a_shaft_has_no_hypotheses(bundled_body: Body) -> None:
    view = SizedView(seen(bundled_body, silhouette(bundled_body)), blur=1.2)
    (outline,) = view.outlines(TRUE[None])
    without = replace(bundled_body.instrument, shaft=None)
    assert one_sided_errors(outline, without, view.camera, TRUE).columns.shape == (len(outline.pixels), 0)


@pytest.mark.parametrize("across", [-1.0, 1.0])
def test_shadow_beside_the_shaft_does_not_make_it_look_closer(bundled_body: Body, across: float) -> None:
    """The contour alone puts the tool too near; the hypothesis of a shadow takes most of it back, and is probable."""
    plain, mean = [], []
    for seed in range(3):
        at, found = fitted(bundled_body, with_shadow(bundled_body, rough(silhouette(bundled_body), seed), across))
        assert found.plain_probability < 0.05
        assert sum(sizes.sum() for sizes in found.sizes) > SHADOW_PX / 3
        plain.append(depth_error(at.moved(found.plain)))
        mean.append(depth_error(at.moved(found.plain + found.shift)))
    assert np.mean(plain) > 1.0
    assert abs(np.mean(mean)) < 0.5 * np.mean(plain)


def test_rough_mask_without_a_shadow_hardly_moves(bundled_body: Body) -> None:
    for seed in range(4):
        at, found = fitted(bundled_body, rough(silhouette(bundled_body), seed))
        assert found.plain_probability > 0.3
        assert abs(depth_error(at.moved(found.plain)) - depth_error(at.moved(found.plain + found.shift))) < 0.4


def test_side_that_is_cut_is_not_taken_for_a_shadow_on_the_other_side(bundled_body: Body) -> None:
    mask = rough(silhouette(bundled_body), 3)
    axis = TRUE.pose[:2, 2] / np.linalg.norm(TRUE.pose[:2, 2])
    du, dv = 4.0 * np.array([-axis[1], axis[0]])
    moved = cv2.warpAffine(mask.astype(np.uint8), np.array([[1, 0, du], [0, 1, dv]]), mask.shape[::-1]) > 0
    cut = mask & (moved | ~near_wrist(bundled_body, 55.0))
    at, found = fitted(bundled_body, cut)
    (sizes,) = found.sizes
    assert sizes[-10:].sum() > sizes[:-10].sum()
    assert abs(depth_error(at.moved(found.plain + found.shift))) < 2.0


def test_spread_of_the_hypotheses_is_along_the_optical_axis(bundled_body: Body) -> None:
    """Whether there is a shadow is in doubt for a depth, not for a place in the image."""
    at, found = fitted(bundled_body, with_shadow(bundled_body, rough(silhouette(bundled_body), 1), 1.0))
    spread = at.pose[:3, :3] @ found.spread[:3, :3] @ at.pose[:3, :3].T
    assert (np.linalg.eigvalsh(found.spread) > -1e-12).all()
    assert spread[2, 2] > 0.8 * np.trace(spread)


def test_explained_errors_are_not_noise(bundled_body: Body) -> None:
    """With its shadow explained, a mask tells of the pose nearly as much as without it."""
    body, terms = bundled_body, [ReadingsTerm(readings_of(bundled_body, TRUE.joints))]
    exact = rough(silhouette(body), 2)
    shadowed = with_shadow(body, exact, 1.0)
    at, found = fitted(body, shadowed)

    def depth_std(mask: np.ndarray, sizes: tuple[np.ndarray, ...] = ()) -> float:
        view = seen(body, mask)
        pose = at.moved(found.plain + found.shift)
        both = ViewAtFullSize(view, SizedView(view, blur=1.2))
        (information,) = information_of_views([both], terms, pose, sizes)
        along = pose.pose[2, :3]
        return float(1e3 * np.sqrt(along @ np.linalg.inv(information)[:3, :3] @ along))

    without, explained, unexplained = depth_std(exact), depth_std(shadowed, found.sizes), depth_std(shadowed)
    assert explained < 0.8 * unexplained
    assert explained == pytest.approx(without, rel=0.4)


def test_exact_mask_has_nothing_to_explain(bundled_body: Body) -> None:
    view = SizedView(seen(bundled_body, silhouette(bundled_body)), blur=1.2)
    assert fit_one_sided([view], [ReadingsTerm(readings_of(bundled_body, TRUE.joints))], TRUE) is None


def test_positive_part_of_normal_distributions() -> None:
    mean, deviation = np.array([-30.0, -9.0, -2.0, 0.0, 1.0, 8.0]), np.array([1.0, 1.0, 2.0, 3.0, 0.5, 1.0])
    first, variance, mass = _positive(mean, deviation)
    expected = truncnorm(-mean / deviation, np.inf, mean, deviation)
    np.testing.assert_allclose(first, expected.mean(), rtol=0.02)
    np.testing.assert_allclose(variance, expected.var(), rtol=0.2)
    np.testing.assert_allclose(mass[2:], np.log([0.158655, 0.5, 0.977250, 1.0]), atol=1e-4)
