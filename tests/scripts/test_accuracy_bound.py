"""Lower bounds of the errors from the masks' noise, and the spreads that follow from given errors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import cv2
import numpy as np
import pytest

from dvrk_cmaes.config import EstimateConfig
from dvrk_cmaes.evidence.outline_noise import signed_distance
from dvrk_cmaes.geometry import moved, transform
from dvrk_cmaes.instrument.arm import base_from_root
from dvrk_cmaes.results.result import Result
from dvrk_cmaes.silhouette import Body, Renderer

if TYPE_CHECKING:
    from measure.cases import Case, Run


pytestmark = pytest.mark.usefixtures("scripts_on_path")


def with_mask(body: Body, case: Case, *, wave: float) -> Case:
    """Give a case with its true silhouette as mask, the outline moved by ``wave`` px with a correlation of 20 px."""
    true = case.true(body.instrument)
    drawn = Renderer(body, case.camera, threads=1).masks(true.pose[None], true.joints[None])[0]
    noise = cv2.GaussianBlur(np.random.default_rng(2).standard_normal(drawn.shape), (0, 0), 6)
    return case.with_mask(signed_distance(drawn) < wave * noise / noise.std())


def runs_at(cases: Sequence[Case], poses: Sequence[np.ndarray], spread: float = 1e-3) -> list[Run]:
    """Make runs that ended at poses, with one standard deviation for all of [t, r, joints]."""
    from measure.cases import Run

    result = Result.failed("", "", {}, instrument="lnd", root_link="roll_link")
    found = replace(result, status="ok", covariance=np.eye(9) * spread**2)
    return [
        Run(case, replace(found, camera_from_root=pose, joints=dict(case.truth.joints)))
        for case, pose in zip(cases, poses, strict=True)
        if case.truth is not None
    ]


def test_bound_grows_with_noise_of_mask(bundled_body: Body, cases: list[Case]) -> None:
    from measure.accuracy.spread_bound import MODELS, mask_bound

    bounds = [mask_bound(bundled_body, with_mask(bundled_body, cases[0], wave=w), EstimateConfig()) for w in (0, 1, 2)]
    assert bounds[0].noise.sigma == pytest.approx(0.3, abs=0.1)
    assert [bound.noise.sigma for bound in bounds[1:]] == pytest.approx([1, 2], rel=0.25)
    for model in MODELS:
        exact, rough, rougher = (np.sqrt(np.diag(bound.covariances[model])[:6]) for bound in bounds)
        assert (exact < rough).all()
        assert (rough < rougher).all()


def test_exact_mask_bound_is_that_of_pixel_grid(bundled_body: Body, cases: list[Case]) -> None:
    from measure.accuracy.bound import least_covariance
    from measure.accuracy.spread_bound import mask_bound

    case = with_mask(bundled_body, cases[0], wave=0)
    grid = np.sqrt(np.diag(least_covariance(bundled_body, case, EstimateConfig())))
    for covariance in mask_bound(bundled_body, case, EstimateConfig()).covariances.values():
        assert np.sqrt(np.diag(covariance)) == pytest.approx(grid, rel=0.6)


def test_modelled_correlation_lowers_bound(bundled_body: Body, cases: list[Case]) -> None:
    from measure.accuracy.spread_bound import mask_bound

    bound = mask_bound(bundled_body, with_mask(bundled_body, cases[0], wave=1), EstimateConfig())
    ratio = np.sqrt(np.diag(bound.covariances["smooth"]) / np.diag(bound.covariances["blocks"]))
    assert (ratio[:6] < 0.8).all()


def test_spreads_agree_with_simulated_errors() -> None:
    from measure.accuracy.spread_bound import drawn_spreads, spreads, with_common_rcm

    rng = np.random.default_rng(1)
    base = transform(np.eye(3), [0.01, 0.02, 0.2])
    outer = np.c_[rng.uniform(-0.4, 0.4, (40, 2)), rng.uniform(0.1, 0.2, 40), rng.uniform(-1, 1, 40)]
    poses, insertion = base @ base_from_root(outer), outer[:, 2]
    assert spreads(poses, insertion) == pytest.approx({"sigma_mm": 0, "rcm_mm": 0}, abs=1e-9)

    off = np.zeros(9)
    off[:3], off[3:] = 1e-3, 1e-9
    drawn = drawn_spreads(poses, insertion, np.stack([np.diag(off**2)] * 40))
    assert np.sqrt((drawn["rcm_mm"] ** 2).mean()) == pytest.approx(np.sqrt(3 * 39 / 40), rel=0.02)
    # the length of a two-dimensional Gaussian vector has a standard deviation of 0.655 of that of its components
    assert drawn["sigma_mm"].mean() == pytest.approx(0.655, rel=0.05)

    wrong = moved(poses, 0.01 * rng.standard_normal((40, 6)))
    assert spreads(wrong, insertion)["rcm_mm"] > 1
    assert spreads(with_common_rcm(wrong, insertion), insertion) == pytest.approx(
        {"sigma_mm": 0, "rcm_mm": 0}, abs=1e-9
    )


def test_wrong_mode_counts_in_spread_of_all_frames_only(bundled_body: Body, cases: list[Case]) -> None:
    from measure.accuracy.spread_bound import mask_report

    truth = [case.truth.camera_from_root for case in cases if case.truth is not None]
    true = mask_report(bundled_body, runs_at(cases[1:], truth[1:]), EstimateConfig())
    half_turn = np.array([0, 0, 0.02, 0, 0, np.pi])
    report = mask_report(bundled_body, runs_at(cases, [moved(truth[0], half_turn), *truth[1:]]), EstimateConfig())
    for name, rows in report.items():
        assert [row["frames"] for row in rows] == [len(cases) - 1] * 2, name
    spread, tips = report.values()
    alone = next(iter(true.values()))
    for row, without in zip(spread, alone, strict=True):
        assert row["rcm_mm"] == pytest.approx(without["rcm_mm"])
        assert row["rcm_mm"] == pytest.approx(row["rcm_mm_read"])
        assert row["rcm_mm_all"] > 5 * row["rcm_mm"]
        assert row["rcm_mm_expected"] > row["rcm_mm_read"]
    assert all(row["tip_mm_rms"] == pytest.approx(0, abs=1e-9) for row in tips)


def test_results_without_truth_use_their_covariances(bundled_body: Body, cases: list[Case]) -> None:
    from measure.accuracy.spread_bound import mask_report

    truth = [case.truth.camera_from_root for case in cases if case.truth is not None]
    off = moved(np.stack(truth), 1e-3 * np.random.default_rng(3).standard_normal((len(truth), 6)))
    rows = []
    for spread in (1e-3, 2e-3):
        blind = [replace(run, case=replace(run.case, truth=None)) for run in runs_at(cases, list(off), spread)]
        (row,), tips = mask_report(bundled_body, blind, EstimateConfig()).values()
        rows.append(row)
    assert [row["expected of"] for row in rows] == ["results' own"] * 2
    assert 0.5 < rows[0]["rcm_ratio"] < 2
    assert rows[1]["rcm_mm"] == rows[0]["rcm_mm"]
    assert rows[1]["rcm_mm_expected"] == pytest.approx(2 * rows[0]["rcm_mm_expected"], rel=0.02)
    assert "outline_px" not in row
    assert tips == []


def test_session_without_insertion_has_no_spread(bundled_body: Body, cases: list[Case]) -> None:
    from measure.accuracy.spread_bound import mask_report

    bare = [
        replace(case, readings={k: v for k, v in case.readings.items() if k != "insertion"})
        for case in cases
        if case.truth is not None
    ]
    runs = runs_at(bare, [case.truth.camera_from_root for case in bare if case.truth is not None])
    spread, tips = mask_report(bundled_body, runs, EstimateConfig()).values()
    assert spread == []
    assert [row["least of"] for row in tips] == ["blocks", "smooth"]
