"""Errors that frames share: the covariance of a calibration with them, and their size as a session tells it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers.session_worlds import NAMES, SEEN, World, make_world
from helpers.transforms import change_between

from dvrk_cmaes.calibration.frame_fit import FrameFit
from dvrk_cmaes.calibration.lasting_errors import (
    USUAL_SIZE,
    CommonErrors,
    LastingSize,
    without_lasting,
)
from dvrk_cmaes.calibration.solve import FrameFits, solve
from dvrk_cmaes.calibration.variances import LastingEstimate, estimate_lasting
from dvrk_cmaes.pose.terms.term import Quadratic

SIZE = 6 + len(NAMES)
NEARER = np.array([0.0, 0.0, 2e-3, *np.zeros(SIZE - 3)])
"""Change of a frame's outline by a standard deviation of an error that lasts, as of a shaft that looks wider."""


def outlines(world: World, rng: np.random.Generator, size: LastingSize, times: np.ndarray) -> list[Quadratic]:
    """Sample outlines about the truth, whose errors are those of `SEEN` and errors that last."""
    root = np.linalg.cholesky(size.correlation(times))
    lasting = size.scale * root @ rng.standard_normal(len(times))
    jacobian, weight = np.column_stack([np.eye(SIZE), NEARER]), np.diag(SEEN**-2.0)
    terms = []
    for error in lasting:
        seen = rng.standard_normal(SIZE) * SEEN + NEARER * error
        terms.append(Quadratic((jacobian.T @ weight @ jacobian)[None], (-jacobian.T @ weight @ seen)[None]))
    return terms


def test_correlation_falls_with_time_and_is_zero_where_times_are_unknown() -> None:
    found = LastingSize(1.0, 0.2).correlation(np.array([0.0, 0.2, 0.6, np.nan]))
    np.testing.assert_allclose(found[0], [1.0, np.exp(-1), np.exp(-3), 0.0])
    np.testing.assert_allclose(np.diag(found), 1.0)
    np.testing.assert_allclose(found, found.T)


def test_stated_deviations_hold_for_errors_that_last() -> None:
    """Of a recording whose errors last for eight frames: without their correlation, the base is stated too well."""
    world, size = make_world(40, noise=0.0, turning=0.02), LastingSize(1.0, 0.4)
    times = 0.05 * np.arange(40)
    deviations = {True: [], False: []}
    for seed in range(60):
        terms = outlines(world, np.random.default_rng(seed), size, times)
        for known in deviations:
            common = CommonErrors(size, times if known else np.full(40, np.nan), np.zeros((40, SIZE)))
            fits = FrameFits.with_lasting(world.at, terms, common)
            solution = solve(world.model, fits, world.truth)
            off = change_between(world.truth.camera_from_base, solution.calibration.camera_from_base)
            inverse = np.linalg.inv(solution.information)
            covariance = inverse + inverse @ solution.lasting.between_frames @ inverse
            deviations[known].append(off / np.sqrt(np.diag(covariance)[:6]))
    rms = {known: np.sqrt(np.mean(np.square(values), axis=0)).max() for known, values in deviations.items()}
    assert rms[True] < 1.2
    assert rms[False] > rms[True] + 0.1


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


def estimated(size: LastingSize, frames: int, spacing: float) -> LastingEstimate:
    """Estimate the size of the errors that last from a made recording in which they have another one."""
    world, times = make_world(frames), spacing * np.arange(frames)
    terms = outlines(world, np.random.default_rng(3), size, times)
    fits = []
    for at, of_frame in zip(world.at, terms, strict=True):
        left = without_lasting(of_frame, 1, USUAL_SIZE)
        fits.append(FrameFit(at, left.information[0], left.slope[0], 0.0, lasting=of_frame, side_px=0.5))
    common = CommonErrors(USUAL_SIZE, times, np.zeros((frames, SIZE)))
    solution = solve(world.model, FrameFits.with_lasting(world.at, terms, common), world.truth)
    return estimate_lasting(world.model, fits, solution, times)


def test_size_is_found() -> None:
    large, small = (estimated(LastingSize(scale, 0.4), 150, 0.1) for scale in (1.2, 0.1))
    assert large.size.scale == pytest.approx(1.2, rel=0.35)
    assert large.size.seconds == pytest.approx(0.4, rel=0.5)
    assert large.side_px == pytest.approx(0.5 * large.size.scale)
    assert small.size.scale < USUAL_SIZE.scale / 1.5
    assert large.log_std_seconds < small.log_std_seconds


def seen_consecutively(frames: int, seed: int) -> tuple[World, list[Quadratic], np.ndarray]:
    """Sample outlines of a recording of 30 images a second, all of whose errors last for a third of a second."""
    times = np.arange(frames) / 30
    world, rng = make_world(frames, noise=0.0), np.random.default_rng(seed)
    jacobian, weight = np.column_stack([np.eye(SIZE), np.zeros(SIZE)]), np.diag(SEEN**-2.0)
    errors = np.linalg.cholesky(LastingSize(1.0, 0.3).correlation(times)) @ rng.standard_normal((frames, SIZE)) * SEEN
    terms = [Quadratic((jacobian.T @ weight @ jacobian)[None], (-jacobian.T @ weight @ seen)[None]) for seen in errors]
    return world, terms, times


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
            common = CommonErrors(USUAL_SIZE, own, np.zeros((len(index), SIZE)), alike_seconds=1.0)
            fits = FrameFits.with_lasting(world.at[index], [terms[k] for k in index], common)
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
