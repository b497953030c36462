"""Probability of the mode, and the covariance that includes modes near by."""

from __future__ import annotations

import numpy as np
import pytest
from helpers.transforms import moved

from dvrk_cmaes.evidence.outline_noise import OutlineNoise
from dvrk_cmaes.geometry import Posed
from dvrk_cmaes.pose.covariance import pose_covariance, rough_covariance
from dvrk_cmaes.pose.probability import mode_probability
from dvrk_cmaes.pose.refine.gauss_newton import Fit
from dvrk_cmaes.results.result import Quality

POSE, JOINTS = np.eye(4), np.zeros(3)
GOOD = Quality(0.97, 0.1, {}, 0.5, 1.5, distal_px=0.8)


def mode(turn_deg: float, score: float, shift: float = 0.0) -> Fit:
    change = np.array([shift, 0, 0, 0, 0, np.deg2rad(turn_deg)])
    at = Posed(moved(POSE, change), JOINTS)
    return Fit(at, score, score, np.eye(9) * 1e6, None, at)


def test_only_mode_of_accurate_pose_is_certain() -> None:
    assert mode_probability([mode(0, 5.0)], 0.3) == pytest.approx(1, abs=1e-3)


def test_expected_error_lowers_probability() -> None:
    assert mode_probability([mode(0, 0.0)], 10.0) == pytest.approx(0.5)


def test_covariance_reaches_live_mode_near_by_but_not_twin() -> None:
    alone = pose_covariance([mode(0, 0.0)], GOOD)
    near = pose_covariance([mode(0, 0.0), mode(20, 0.0, shift=0.01)], GOOD)
    twin = pose_covariance([mode(0, 0.0), mode(180, 0.0, shift=0.01)], GOOD)
    assert np.sqrt(near[0, 0]) > 0.005
    np.testing.assert_array_equal(twin, alone)


def test_contour_far_off_at_jaws_widens_covariance() -> None:
    off = Quality(0.9, 0.1, {}, 0.5, 6.0, distal_px=4.4)
    np.testing.assert_allclose(pose_covariance([mode(0, 0.0)], off), 4 * pose_covariance([mode(0, 0.0)], GOOD))


def test_rough_contour_widens_covariance_of_session_frame() -> None:
    covariance = np.eye(9)
    smooth, rough = (rough_covariance(covariance, OutlineNoise(sigma, 20.0), GOOD, 1.0) for sigma in (0.25, 1.7))
    assert 1 < smooth[0, 0] < 1.1
    assert 2.5 < rough[0, 0] < 3.5


def test_equal_twin_has_half_of_probability() -> None:
    assert mode_probability([mode(0, 5.0), mode(180, 5.0)], 0.3) == pytest.approx(0.5, abs=1e-3)


def test_probability_falls_with_gap() -> None:
    gaps = [mode_probability([mode(0, 0.0), mode(180, gap)], 0.3) for gap in (0, 1, 2, 4, 12)]
    assert gaps == sorted(gaps)
    assert gaps[1:3] == pytest.approx([0.65, 0.77], abs=0.02)  # scores are tempered: less than exp(1) and exp(2)
    assert gaps[-1] > 0.999
