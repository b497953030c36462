"""Rigs that are calibrated wrongly, recognised by all frames of a session."""

from __future__ import annotations

import numpy as np

from dvrk_cmaes import Result
from dvrk_cmaes.calibration.session_camera import pooled_rotation
from dvrk_cmaes.results.parts import Quality, ViewCheck
from dvrk_cmaes.runs.summary import rig_doubts

SPREAD = np.diag([0.03, 0.03, 0.1]) ** 2
QUALITY = Quality(0.95, 0.1, {}, 1.0, 2.0)


def results(rotation: np.ndarray, count: int, seed: int = 0) -> list[Result]:
    """Give the results of frames whose right view is turned by a rotation (3,), deg, with errors of ``SPREAD``."""
    rng = np.random.default_rng(seed)
    found = []
    for k in range(count):
        seen = rotation + rng.multivariate_normal(np.zeros(3), SPREAD)
        checks = ViewCheck("left", QUALITY, np.zeros(3), np.zeros((3, 3))), ViewCheck("right", QUALITY, seen, SPREAD)
        found.append(Result(f"{k:04d}", "ok", (), "lnd", "roll_link", np.eye(4), {}, {}, view_fits=checks))
    return found


def test_rotation_that_no_single_frame_tells_is_named() -> None:
    turned = results(np.array([0.0, 0.0, 0.25]), 12)
    assert all(one.view_fits[1].significance < 4 for one in turned)
    (text,) = rig_doubts(turned)
    assert text.startswith("views disagree in 12 frames together: right fits the first view only if turned by 0.2")


def test_right_rigs_are_not_named() -> None:
    assert [rig_doubts(results(np.zeros(3), 12, seed)) for seed in range(50)] == [[]] * 50


def test_mean_is_weighted_and_widens_with_scatter() -> None:
    precise, rough = 0.01 * np.eye(3), np.eye(3)
    mean, covariance = pooled_rotation([(np.array([0.1, 0, 0]), precise), (np.array([1.0, 0, 0]), rough)])
    np.testing.assert_allclose(mean, [(10 + 1) / 101, 0, 0], rtol=0.02)
    np.testing.assert_allclose(covariance, np.eye(3) / 101, rtol=0.02)
    scattered = [(np.array([x, 0.0, 0.0]), precise) for x in (-1.0, 1.0)]
    assert np.diag(pooled_rotation(scattered)[1]).min() > 0.3
