"""Prediction of a frame's pose and joints from base, offsets and readings, with its covariance."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers.session_worlds import NAMES, OFFSETS, make_world
from helpers.transforms import change_between
from hypothesis import given
from hypothesis import strategies as st

from dvrk_cmaes.calibration.model import Correction, SessionModel


def test_exact_readings_predict_truth() -> None:
    world = make_world(noise=0)
    at = world.model.predict(world.truth)
    np.testing.assert_allclose(at.pose, world.at.pose, atol=1e-12)
    np.testing.assert_allclose(at.joints, world.at.joints, atol=1e-12)


@given(st.integers(0, 10_000))
def test_jacobian_agrees_with_finite_differences(seed: int) -> None:
    world = make_world(3, seed)
    rate, step = world.model.jacobian(world.truth), 1e-6
    at = world.model.predict(world.truth)
    assert rate.shape == (3, 9, len(world.truth.axes))
    for k in range(len(world.truth.axes)):
        change = np.zeros(len(world.truth.axes))
        change[k] = step
        moved_by = world.model.predict(world.truth.changed(change)).minus(at) / step
        np.testing.assert_allclose(rate[:, :, k], moved_by, atol=1e-5)


def test_covariance_agrees_with_simulation() -> None:
    rng = np.random.default_rng(0)
    one = make_world(1)
    count = 20_000
    spreads = one.model.deviations
    outer = one.model.outer + rng.standard_normal((count, 4)) * spreads.outer
    joints = one.model.joints + rng.standard_normal((count, 3)) * spreads.joints
    off = replace(one.model, outer=outer, joints=joints).predict(one.truth).minus(one.model.predict(one.truth))
    stated = one.model.covariance(one.truth)[0]
    slack = np.diag([*spreads.slack**2, 0, 0, 0])
    scale = np.sqrt(np.diag(stated))
    seen = (off.T @ off / count + slack) / np.outer(scale, scale)
    np.testing.assert_allclose(seen, stated / np.outer(scale, scale), atol=0.03)


def test_roll_offset_and_base_are_confounded_without_rotation() -> None:
    def told(turning: float) -> float:
        rate = make_world(8, turning=turning).model.jacobian(make_world(8).truth)[:, :6, :8]
        scale = np.array([1e-3] * 3 + [0.01] * 3 + [1e-3, 0.01])
        return float(np.linalg.svd((rate * scale).reshape(-1, 8))[1][-1])

    assert told(0.0) < 1e-9
    assert told(0.02) < 0.3 * told(0.25)


def test_correction_moves_the_prediction_and_widens_its_covariance() -> None:
    world = make_world(2)
    values, variances = np.zeros((2, 4)), np.zeros((2, 4))
    values[1], variances[1] = [0.1, 0.02, 0.03, 0.04], np.square([0.05, 0.06, 0.07, 0.08])
    corrected = replace(world.model, correction=Correction(values, variances))
    change = corrected.predict(world.truth).minus(world.model.predict(world.truth))
    np.testing.assert_allclose(change[:, 5:], values, atol=1e-9)
    plain, wide = (np.einsum("nii->ni", m.covariance(world.truth)) for m in (world.model, corrected))
    np.testing.assert_allclose((wide - plain)[:, 5:], variances, atol=1e-12)


def test_si_arm_wrist_lies_50_8_mm_farther() -> None:
    classic = make_world(1).model
    si = SessionModel(classic.outer, classic.joints, NAMES, classic.deviations, arm="si")
    apart = change_between(classic.base_from_root(OFFSETS), si.base_from_root(OFFSETS))
    assert np.abs(apart[0, 2]) == pytest.approx(0.0508, abs=1e-6)
