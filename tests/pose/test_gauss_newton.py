"""Refinement on the coverage: convergence from nearby starts, and finite results from distant ones."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from helpers.frame_terms import Terms, readings_of, view_at
from helpers.transforms import lookat_pose, rotation_angle

from dvrk_cmaes import Body, Camera
from dvrk_cmaes.geometry import Posed
from dvrk_cmaes.pose.refine.gauss_newton import Steps, refine
from dvrk_cmaes.pose.refine.selection import Selection
from dvrk_cmaes.pose.terms.outline_term import OutlineTerm
from dvrk_cmaes.pose.terms.term import Quadratic

CAMERA = Camera(640, 480, 880, 880, 330, 250)
TRUE = Posed(lookat_pose(0.5, 1.0, 0.7, 0.11), np.array([0.4, -0.3, 0.5]))
NEAR = np.array([3e-4, -3e-4, 5e-4, 0.01, -0.01, 0.05, 0.05, 0.05, 0.05])


def terms(
    body: Body, read: np.ndarray = TRUE.joints, shrink: int = 1, ignore: np.ndarray | None = None, **settings: float
) -> Terms:
    return Terms([view_at(body, CAMERA, TRUE, ignore=ignore)], readings_of(body, read), shrink, **settings)


@pytest.mark.parametrize("shrink", [1, 2, 4])
def test_nearby_start_converges_to_truth(bundled_body: Body, shrink: int) -> None:
    (fit,) = terms(bundled_body, shrink=shrink).refined(TRUE.moved(NEAR))
    # The tolerance grows with the pixel size.
    assert np.linalg.norm(fit.at.pose[:3, 3] - TRUE.pose[:3, 3]) < 1.5e-4 * shrink
    assert rotation_angle(fit.at.pose, TRUE.pose) < np.deg2rad(0.8) * shrink
    np.testing.assert_allclose(fit.at.joints, TRUE.joints, atol=np.deg2rad(0.8) * shrink)


def test_batch_agrees_with_single_refinements(bundled_body: Body) -> None:
    at = terms(bundled_body, shrink=4)
    starts = [TRUE.moved(np.array([0, 0, 0, 0.01 * i, 0, 0.05 * i, 0, 0, 0])) for i in range(4)]
    for start, fit in zip(starts, at.refined(*starts), strict=True):
        assert at.refined(start)[0].score == pytest.approx(fit.score, abs=0.5)


class Valley(OutlineTerm[Posed]):
    """A sum of squares with a minimum at the true pose, and a narrow valley in which shift and turn about z trade."""

    views = ()

    def __init__(self) -> None:
        scale = 1 / np.array([1e-5] * 3 + [1e-3] * 6)
        tight = np.eye(9)
        tight[2, 5] = tight[5, 2] = 0.9995
        self.information = tight * np.outer(scale, scale)

    def draw(self, at: Posed, *, derivatives: bool = True) -> list[Posed]:
        return [at[k] for k in range(len(at))]

    def cost_of(self, drawn: Posed) -> float:
        off = drawn.minus(TRUE)
        return float(off @ self.information @ off)

    def near(self, drawn: Sequence[Posed], at: Posed) -> Quadratic:
        information = np.broadcast_to(self.information, (len(drawn), 9, 9))
        return Quadratic(information, at.minus(TRUE) @ self.information)


def test_damping_falls_after_good_steps() -> None:
    """With a constant damping, eight steps would cover a quarter of the way along the valley."""
    start = TRUE.moved(np.array([0, 0, 1e-3, 0, 0, -0.1, 0, 0, 0]))
    (fit,) = refine(Valley(), [], start[None], Steps(8, tolerance=1e-3))
    assert abs(fit.at.minus(TRUE)[5]) < 2e-3


def test_steps_that_are_not_tested_are_not_damped_but_limited() -> None:
    start = TRUE.moved(np.array([0, 0, 1e-5, 0, 0, 1e-3, 0, 0, 0]))  # across the valley, 2 standard deviations
    (whole,), (short,) = (
        refine(Valley(), [], start[None], Steps(1, tested="none", largest=largest)) for largest in (6.0, 0.5)
    )
    np.testing.assert_allclose(whole.at.minus(TRUE), 0.0, atol=1e-7)
    distances = [np.sqrt(Valley().cost(at[None])[0]) for at in (start, short.at)]
    assert distances[0] - distances[1] == pytest.approx(0.5, rel=0.01)


@pytest.mark.parametrize("shrink", [1, 2])
def test_border_of_ignored_pixels_is_no_edge(bundled_body: Body, shrink: int) -> None:
    ignore = np.zeros((CAMERA.height, CAMERA.width), dtype=bool)
    wrist = CAMERA.project(TRUE.pose[None, :3, 3])[0].astype(int)
    ignore[wrist[1] - 25 : wrist[1] + 25, wrist[0] - 25 : wrist[0] + 25] = True  # across the instrument
    at = Posed.stacked([TRUE])
    whole, hidden = (terms(bundled_body, shrink=shrink, ignore=each).coverage.cost(at)[0] for each in (None, ignore))
    assert hidden < whole  # the mask ends at the border of the ignored pixels, the silhouette does not


def test_weight_of_readings_follows_correlation(bundled_body: Body) -> None:
    off = TRUE.joints + np.array([0.2, 0, 0])
    weak, strong = (
        terms(bundled_body, off, 4, correlation=length).refined(TRUE)[0].at.joints[0] for length in (1.0, 1e5)
    )
    assert abs(weak - TRUE.joints[0]) < 0.25 * abs(strong - TRUE.joints[0])


def test_silhouette_outside_window_gives_finite_score(bundled_body: Body) -> None:
    away = Posed(TRUE.pose.copy(), TRUE.joints)
    away.pose[:3, 3] += [0.5, 0.3, 0.0]
    lost, fit = terms(bundled_body).refined(away, TRUE)
    assert np.isfinite(lost.score)
    assert fit.score < lost.score


def test_pose_is_drawn_once(bundled_body: Body) -> None:
    at = terms(bundled_body).coverage
    pair = Posed.stacked([TRUE, TRUE.moved(NEAR)])
    at.draw(pair[:1], derivatives=None)
    assert at.silhouettes == 1
    first, second = at.draw(pair)  # the outline of the first one is asked for now
    assert at.silhouettes == 3
    assert first[0].outlined
    for again in (at.draw(pair), at.with_width(0.03).draw(pair), at.with_correlations([20.0]).draw(pair)):
        assert at.silhouettes == 3
        assert again == [first, second]
    moved = at.draw(pair[1:].moved(np.full((1, 9), 1e-6)))
    assert at.silhouettes == 4
    assert moved[0][0].losses != second[0].losses
    at.with_cameras([replace(CAMERA, cx=CAMERA.cx + 3)]).draw(pair)
    assert at.draw(pair) == [first, second]


def test_oldest_drawings_are_forgotten(bundled_body: Body, monkeypatch: pytest.MonkeyPatch) -> None:
    at = terms(bundled_body).coverage
    monkeypatch.setattr("dvrk_cmaes.pose.terms.sized_view.REMEMBERED", 2)
    for step in (0.0, 1e-4, 2e-4, 0.0):
        at.draw(Posed.stacked([TRUE.moved(np.full(9, step))]), derivatives=None)
    assert at.silhouettes == 4


def test_short_steps_need_no_silhouette_if_only_long_ones_are_tested(bundled_body: Body) -> None:
    at = terms(bundled_body)
    (there,) = at.refined(TRUE.moved(NEAR))
    for _ in range(3):
        (there,) = at.refined(there.at)
    counts, fits = [], []
    for tested in ("all", "long"):
        anew = terms(bundled_body)  # which has drawn nothing yet
        fits += refine(anew.coverage, anew.others, Posed.stacked([there.at]), Steps(20, 6, 0.05, tested))
        counts.append(anew.coverage.silhouettes)
    assert counts[0] - counts[1] == 1  # the last step
    spread = np.sqrt(np.diag(np.linalg.inv(fits[0].information)))
    assert (np.abs(fits[1].at.minus(fits[0].at)) < 0.15 * spread).all()


@pytest.mark.parametrize("shrink", [1, 2, 4])
def test_refinement_of_a_frame_ends_without_drawing_its_last_step(bundled_body: Body, shrink: int) -> None:
    at = terms(bundled_body, shrink=shrink)
    (there,) = at.refined(TRUE.moved(NEAR))
    for _ in range(3):
        (there,) = at.refined(there.at)
    anew = terms(bundled_body, shrink=shrink)
    anew.refined(there.at)
    assert anew.coverage.silhouettes == 1


def test_poses_of_several_approximations_move_as_alone() -> None:
    """Poses that were approximated in different iterations, and in another order, take the steps of each alone."""
    starts = [TRUE.moved(np.array([0, 0, 1e-4 * k, 0, 0, -0.01 * k, 0, 0, 0])) for k in (3, 1, 2)]
    steps = Steps(5, tolerance=1e-6)
    together = refine(Valley(), [], Posed.stacked(starts), steps, Selection(share=0.7))
    alone = [refine(Valley(), [], start[None], steps)[0] for start in starts]
    settled = [k for k in range(3) if np.allclose(together[k].at.pose, alone[k].at.pose, atol=1e-9)]
    assert 1 in settled  # the nearest one continues to the end
    assert len(settled) < 3
