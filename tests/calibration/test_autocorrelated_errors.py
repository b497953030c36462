"""Errors that frames share: the covariance of a calibration with them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers.session_worlds import NAMES, SEEN, World, make_world
from helpers.transforms import change_between

from dvrk_cmaes.calibration.autocorrelated_errors import CommonErrors
from dvrk_cmaes.calibration.solve import FrameFits, solve
from dvrk_cmaes.pose.terms.term import Quadratic

SIZE = 6 + len(NAMES)


def test_error_of_the_lag_widens_the_covariance_along_what_it_changes() -> None:
    """A lag that moves all predictions by the same change of the base cannot be told from that change."""
    world, rng = make_world(12), np.random.default_rng(0)
    fits = world.fits(rng)
    along = np.array([0.0, 0.0, 0.0, 0.0, 0.01, 0.0, *np.zeros(5)])
    by_lag = world.model.jacobian(world.truth) @ along
    without = solve(world.model, fits, world.truth).covariance
    with_lag = solve(world.model, replace(fits, by_lag=by_lag), world.truth).covariance
    assert with_lag[4, 4] - without[4, 4] == pytest.approx(0.01**2, rel=0.05)
    assert with_lag[0, 0] == pytest.approx(without[0, 0], rel=0.3)


def seen_consecutively(frames: int, seed: int) -> tuple[World, Quadratic, np.ndarray]:
    """Sample outlines of a recording of 30 images a second, whose errors are autocorrelated over 0.3 s."""
    times = np.arange(frames) / 30
    world, rng = make_world(frames, noise=0.0), np.random.default_rng(seed)
    weight = np.diag(SEEN**-2.0)
    errors = (
        np.linalg.cholesky(np.exp(-np.abs(times[:, None] - times) / 0.3)) @ rng.standard_normal((frames, SIZE)) * SEEN
    )
    return world, Quadratic(np.tile(weight, (frames, 1, 1)), -errors @ weight), times


def test_more_consecutive_frames_tell_no_more_than_every_fourth_of_them() -> None:
    """What frames near each other in time share is counted as shared; taken for independent, they are trusted."""
    rms: dict[tuple[int, bool], list[np.ndarray]] = {}
    stds: dict[int, np.ndarray] = {}
    apart = []
    for seed in range(12):
        world, terms, times = seen_consecutively(240, seed)
        steps = {}
        for every, known in ((1, True), (4, True), (1, False)):
            index = np.arange(0, 240, every)
            own = times[index] if known else np.full(len(index), np.nan)
            common = CommonErrors(own, np.zeros((len(index), SIZE)), alike_seconds=1.0)
            fits = FrameFits.sharing(world.at[index], terms.select(index.tolist()), common, {})
            solution = solve(world.model.subset(index), fits, world.truth)
            found = solution.calibration
            base = change_between(world.truth.camera_from_base, found.camera_from_base)
            step = np.concatenate([base, found.offsets - world.truth.offsets])
            std = np.sqrt(np.diag(np.linalg.inv(solution.information)))
            rms.setdefault((every, known), []).append(step / std)
            if known:
                steps[every], stds[every] = step, std
        apart.append((steps[1] - steps[4]) / stds[4])
    size = {case: np.sqrt(np.mean(np.square(values))) for case, values in rms.items()}
    assert max(size[1, True], size[4, True]) < 1.2
    assert size[1, False] > 1.5
    np.testing.assert_allclose(stds[1], stds[4], rtol=0.15)
    assert np.sqrt(np.mean(np.square(apart))) < 0.5
