"""Filter and smoother of the cables, against the same estimate with all poses at once."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import block_diag

from dvrk_cmaes.joints.cable_inference import Assumed, Filtered, Observations, leave_one_out, run_filters

POSES, JOINTS, COEFFICIENTS = 7, 2, 3
SIZE = POSES * JOINTS


class Dense:
    """The same problem with the covariance of all errors, (N C, N C)."""

    def __init__(self) -> None:
        rng = np.random.default_rng(0)
        self.terms = rng.standard_normal((POSES, JOINTS, COEFFICIENTS))
        root = rng.standard_normal((POSES, JOINTS, JOINTS))
        information = root @ np.swapaxes(root, 1, 2)
        information[2] = 0.0  # a pose that is not seen
        vector = np.einsum("nij,nj->ni", information, rng.standard_normal((POSES, JOINTS)))
        times = np.cumsum(rng.random(POSES))
        self.given = Observations(times, self.terms, information, vector)
        mean = rng.standard_normal(COEFFICIENTS)
        std, wander, seconds = np.array([1.0, 0.5, 2.0]), np.array([0.7, 1.1]), np.array([1.0, 2.0])
        self.assumed = Assumed(mean, std, wander, seconds, np.array([0.3, 0.2]))
        flat = self.terms.reshape(SIZE, COEFFICIENTS)
        correlated = np.zeros((POSES, JOINTS, POSES, JOINTS))
        for c in range(JOINTS):
            apart = np.abs(times[:, None] - times)
            correlated[:, c, :, c] = wander[c] ** 2 * np.exp(-apart / seconds[c])
        self.structured = flat @ np.diag(std**2) @ flat.T + correlated.reshape(SIZE, SIZE)
        self.whole = self.structured + np.kron(np.eye(POSES), np.diag(self.assumed.noise**2))
        self.expected = flat @ mean

    def without(self, pose: int) -> tuple[np.ndarray, np.ndarray]:
        """Mean and covariance of a pose's error without its own observation."""
        information, vector = self.given.information.copy(), self.given.vector.copy()
        information[pose], vector[pose] = 0.0, 0.0
        precision = block_diag(*information)
        solved = np.linalg.inv(np.eye(SIZE) + precision @ self.whole)
        mean = self.expected + self.structured @ solved @ (vector.ravel() - precision @ self.expected)
        covariance = self.structured - self.structured @ solved @ precision @ self.structured
        at = slice(pose * JOINTS, (pose + 1) * JOINTS)
        return mean[at], covariance[at, at]

    def log_likelihood(self) -> float:
        """Logarithm of the mean of the likelihood over the errors' distribution."""
        precision, vector = block_diag(*self.given.information), self.given.vector.ravel()
        widened = np.eye(SIZE) + self.whole @ precision
        off = vector - precision @ self.expected
        known = self.expected @ vector - self.expected @ precision @ self.expected / 2
        return float(known + off @ np.linalg.solve(widened, self.whole @ off) / 2 - np.linalg.slogdet(widened)[1] / 2)


@pytest.fixture(scope="module")
def dense() -> Dense:
    return Dense()


@pytest.fixture(scope="module")
def filtered(dense: Dense) -> Filtered:
    """The second of two assumptions that are filtered together."""
    other = replace(dense.assumed, noise=2 * dense.assumed.noise, seconds=3 * dense.assumed.seconds)
    return run_filters(dense.given, [other, dense.assumed])[1]


def test_the_likelihood_is_that_of_all_poses_at_once(dense: Dense, filtered: Filtered) -> None:
    assert filtered.log_likelihood == pytest.approx(dense.log_likelihood(), rel=1e-9)


def test_each_pose_is_predicted_by_all_others_before_and_after_it(dense: Dense, filtered: Filtered) -> None:
    means, covariances = leave_one_out(filtered)
    for pose in range(POSES):
        mean, covariance = dense.without(pose)
        np.testing.assert_allclose(means[pose], mean, rtol=1e-8, atol=1e-10)
        np.testing.assert_allclose(covariances[pose], covariance, rtol=1e-8, atol=1e-10)


def test_coefficients_without_observations_stay_as_expected(dense: Dense) -> None:
    blind = Observations(dense.given.times, dense.terms, np.zeros((POSES, 2, 2)), np.zeros((POSES, 2)))
    found = run_filters(blind, [dense.assumed])[0]
    np.testing.assert_allclose(found.mean, dense.assumed.mean)
    np.testing.assert_allclose(found.covariance, np.diag(dense.assumed.std**2), atol=1e-15)
    assert found.log_likelihood == pytest.approx(0.0, abs=1e-12)
