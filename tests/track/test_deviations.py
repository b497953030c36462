"""Smoothing of frames' deviations from a calibration's predictions, against the dense solution of the same problem."""

from __future__ import annotations

import numpy as np
import pytest

from dvrk_cmaes.track.window import FAST_SECONDS, SLOW_SECONDS, SLOW_SHARE, smoothed_deviations

COUNT, SIZE, CONSTANTS, MASKS = 6, 3, 2, 2
NO_MASKS = np.zeros((3, SIZE, 0))
TIMES = np.array([0.0, 0.1, 0.2, 0.5, 0.6, 1.0])


def spread(values: np.ndarray, times: np.ndarray) -> np.ndarray:
    """Return the covariance (N D, N D) of all deviations together."""
    apart = np.abs(times[:, None] - times)
    correlation = SLOW_SHARE * np.exp(-apart / SLOW_SECONDS) + (1 - SLOW_SHARE) * np.exp(-apart / FAST_SECONDS)
    return np.asarray(np.kron(correlation, values))


def test_result_is_that_of_the_dense_system() -> None:
    rng = np.random.default_rng(0)
    root = rng.standard_normal((SIZE, SIZE))
    prior = root @ root.T + np.eye(SIZE)
    information = np.array([a @ a.T for a in rng.standard_normal((COUNT, SIZE, SIZE))])
    optimum = rng.standard_normal((COUNT, SIZE))
    jacobian, by_masks = rng.standard_normal((COUNT, SIZE, CONSTANTS)), rng.standard_normal((COUNT, SIZE, MASKS))
    stacked = np.tile(prior, (COUNT, 1, 1))
    of_frames = TIMES, stacked, information, optimum, jacobian, by_masks
    found, last = (smoothed_deviations(*of_frames, only_last=kind) for kind in (False, True))
    deviations, covariances, responses = found
    told = np.zeros((COUNT * SIZE, COUNT * SIZE))
    for k in range(COUNT):
        told[k * SIZE : (k + 1) * SIZE, k * SIZE : (k + 1) * SIZE] = information[k]
    covariance = np.linalg.inv(np.linalg.inv(spread(prior, TIMES)) + told)
    for of_last, of_all in zip(last, found, strict=True):
        assert of_last == pytest.approx(of_all[-1:], rel=1e-9, abs=1e-12)
    assert deviations.ravel() == pytest.approx(covariance @ optimum.ravel(), abs=1e-6)
    blocks = [covariance[k * SIZE : (k + 1) * SIZE, k * SIZE : (k + 1) * SIZE] for k in range(COUNT)]
    assert covariances == pytest.approx(np.array(blocks), abs=1e-6)
    moved = jacobian.reshape(-1, CONSTANTS)
    by_calibration, of_masks = np.split(responses.reshape(-1, CONSTANTS + MASKS), [CONSTANTS], axis=1)
    assert by_calibration == pytest.approx(moved - covariance @ told @ moved, abs=1e-6)
    assert of_masks == pytest.approx(covariance @ by_masks.reshape(-1, MASKS), abs=1e-6)


def test_a_frame_without_evidence_takes_what_its_neighbours_show() -> None:
    information = np.tile(1e6 * np.eye(SIZE), (3, 1, 1))
    information[1] = 0
    shown = np.array([0.5, -0.3, 0.1])
    optimum = information @ shown
    prior, jacobian = np.tile(np.eye(SIZE), (3, 1, 1)), np.zeros((3, SIZE, CONSTANTS))
    times = np.array([0.0, 0.01, 0.02])
    deviations, covariances, _ = smoothed_deviations(times, prior, information, optimum, jacobian, NO_MASKS)
    assert deviations[1] == pytest.approx(shown, rel=0.15)
    assert np.trace(covariances[1]) > np.trace(covariances[0])


def test_without_evidence_the_prediction_and_its_prior_remain() -> None:
    prior = np.array([(1 + k) * np.eye(SIZE) for k in range(3)])
    nothing, jacobian = np.zeros((3, SIZE, SIZE)), np.ones((3, SIZE, CONSTANTS))
    found = smoothed_deviations(np.arange(3.0), prior, nothing, np.zeros((3, SIZE)), jacobian, NO_MASKS)
    assert found[0] == pytest.approx(np.zeros((3, SIZE)))
    assert found[1] == pytest.approx(prior, rel=1e-6)
    assert found[2] == pytest.approx(jacobian)
