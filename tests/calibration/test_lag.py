"""The lag between images and readings: search, refinement, standard deviation, and its document."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers.session_worlds import EXPECTED_OFFSETS, NAMES, PRIOR, SEEN, World, make_world

from dvrk_cmaes.calibration.consensus import Mode, find_consensus
from dvrk_cmaes.calibration.lag import Clock, Lag, LagDocument, describe_lag, refine_lag, search_lag
from dvrk_cmaes.calibration.model import Calibration, SessionModel
from dvrk_cmaes.calibration.solve import FrameFits
from dvrk_cmaes.instrument.arm import OUTER_JOINTS
from dvrk_cmaes.joints.series import ReadingSeries

ROWS, FPS = 240, 30.0


def moving_world(lag: float, seed: int, *, every: int = 6) -> tuple[World, Clock, list[list[Mode]]]:
    """Make a smooth motion read at 30 Hz, and frames at every 6th row whose images are ``lag`` rows late."""
    rng = np.random.default_rng(seed)
    blank = make_world(2, seed)
    rows = np.arange(ROWS)
    amplitude = np.array([0.15, 0.15, 0.02, 0.8, 0.4, 0.4, 0.3])
    phase, period = rng.uniform(0, 6.3, 7), rng.uniform(1.5, 4, 7)

    def true_readings(at: np.ndarray) -> np.ndarray:
        middle = np.array([0, 0, 0.14, 0, 0, 0, 0.8])
        return middle + amplitude * np.sin(2 * np.pi * at[:, None] / FPS / period + phase)

    noise = np.array([*blank.model.deviations.outer, *blank.model.deviations.joints])
    values = true_readings(rows.astype(float)) + 0.3 * noise * rng.standard_normal((ROWS, 7))
    frames = np.arange(12, ROWS - 24, every, dtype=float)
    series = ReadingSeries(
        "frames",
        dict.fromkeys((*OUTER_JOINTS, *NAMES), rows.astype(float)),
        dict(zip((*OUTER_JOINTS, *NAMES), values.T, strict=True)),
        {f"{int(frame):04d}": float(frame) for frame in frames},
        1.0,
    )
    shown = true_readings(frames - lag)
    poses, joints = SessionModel(shown[:, :4], shown[:, 4:], NAMES, blank.model.deviations).predict(blank.truth)
    clock = Clock.of(series, list(series.frames), blank.model.deviations.outer)
    read = series.at((*OUTER_JOINTS, *NAMES), frames)
    world = World(SessionModel(read[:, :4], read[:, 4:], NAMES, blank.model.deviations), blank.truth, poses, joints)
    return world, clock, world.modes(rng)


def found_lag(world: World, clock: Clock, modes: list[list[Mode]]) -> tuple[float, float] | None:
    coarse = search_lag(clock, world.model, modes, EXPECTED_OFFSETS)
    if coarse is None:
        return None
    lag, calibration = coarse
    return refine_lag(clock, clock.model_at(world.model, lag), fits_of(modes), calibration, PRIOR, lag)


def fits_of(modes: list[list[Mode]]) -> FrameFits:
    poses = np.array([own[0].camera_from_root for own in modes])
    joints = np.array([own[0].joints for own in modes])
    information = np.tile(np.diag(SEEN**-2.0), (len(modes), 1, 1))
    return FrameFits(poses, joints, information, np.zeros((*joints.shape[:1], 6 + joints.shape[1])))


@pytest.mark.parametrize("lag", [-3.0, 0.0, 0.4, 2.6, 4.0, 11.5])
def test_lag_is_found_to_a_fraction_of_a_frame(lag: float) -> None:
    found = found_lag(*moving_world(lag, seed=1))
    assert found is not None
    value, std = found
    assert value == pytest.approx(lag, abs=0.3)
    assert 0 < std < 0.3


def test_stated_standard_deviation_covers_the_error() -> None:
    errors = []
    for seed in range(12):
        found = found_lag(*moving_world(1.7, seed))
        assert found is not None
        errors.append(abs(found[0] - 1.7) / found[1])
    assert sum(error < 2 for error in errors) >= 11
    assert max(errors) > 0.1


def test_wrong_frames_do_not_change_the_lag() -> None:
    world, clock, modes = moving_world(4.0, seed=2)
    strange = moving_world(4.0, seed=52)[2]
    for i in range(0, len(modes), 4):
        modes[i] = strange[i]
    found = found_lag(world, clock, modes)
    assert found is not None
    assert found[0] == pytest.approx(4.0, abs=0.4)


def test_arm_that_hardly_moves_determines_no_lag() -> None:
    world, clock, modes = moving_world(3.0, seed=3)
    slow = {name: values.mean() + 1e-3 * (values - values.mean()) for name, values in clock.series.values.items()}
    still = Clock.of(replace(clock.series, values=slow), list(clock.series.frames), world.model.deviations.outer)
    model = still.model_at(world.model, 0.0)
    poses, joints = model.predict(world.truth)
    held = replace(world, model=model, poses=poses, joints=joints)
    found = found_lag(held, still, held.modes(np.random.default_rng(0)))
    assert found is None or describe_lag(still, *found) is None or not described(still, found).applied
    assert modes


def described(clock: Clock, found: tuple[float, float]) -> Lag:
    lag = describe_lag(clock, *found)
    assert lag is not None
    return lag


def test_lag_is_applied_only_if_it_differs_from_zero() -> None:
    _, clock, _ = moving_world(0.0, seed=0)
    assert not described(clock, (0.2, 0.05)).applied
    assert not described(clock, (0.5, 0.3)).applied
    assert described(clock, (0.5, 0.1)).applied
    assert described(clock, (-1.0, 0.2)).applied
    assert describe_lag(clock, 4.0, 1.5) is None


def test_few_frames_are_not_searched() -> None:
    world, clock, modes = moving_world(3.0, seed=1)
    few = list(range(0, 25, 5))
    model, chosen = world.model.subset(few), [modes[i] for i in few]
    assert search_lag(clock.subset(few), model, chosen, EXPECTED_OFFSETS) is None


def test_model_at_a_lag_has_the_readings_of_that_time() -> None:
    world, clock, _ = moving_world(0.0, seed=0)
    model = clock.model_at(world.model, 2.5)
    times = np.array(list(clock.series.frames.values())) - 2.5
    np.testing.assert_array_equal(model.outer, clock.series.at(OUTER_JOINTS, times))
    assert clock.has_readings(2.5).all()
    assert not clock.has_readings(300.0).any()


def test_document_states_lag_in_frames_and_seconds_with_its_sign() -> None:
    lag = Lag.of(0.134, 0.01, "s", 1 / 30, applied=True)
    assert lag.to_dict() == {
        "frames": 4.02,
        "std_frames": 0.3,
        "seconds": 0.134,
        "std_seconds": 0.01,
        "sign": "images late",
        "applied": True,
    }
    assert lag.describe() == "images are 4.02 frames (0.134 s) later than the readings, std 0.30 frames"
    early = Lag.of(-2.0, 0.1, "frames", 1.0, applied=True)
    assert early.describe() == "images are 2.00 frames earlier than the readings, std 0.10 frames"
    assert Lag.from_document(LagDocument(4.02, 0.134, 0.3, 0.01, "images late", True)) == replace(lag, frames=4.02)


def test_document_without_sign_counts_late_readings_as_positive() -> None:
    old = Lag.from_document(LagDocument(frames=2.0, seconds=0.066667))
    assert old is not None
    assert (old.frames, old.seconds, old.std_frames, old.applied) == (-2.0, -0.066667, None, True)
    assert Lag.from_document(None) is None


def test_true_calibration_is_recovered_at_the_lag() -> None:
    world, clock, modes = moving_world(3.0, seed=4)
    right: Calibration = find_consensus(clock.model_at(world.model, 3.0), modes, EXPECTED_OFFSETS).calibration
    wrong: Calibration = find_consensus(world.model, modes, EXPECTED_OFFSETS).calibration
    off = [np.linalg.norm(one.camera_from_base[:3, 3] - world.truth.camera_from_base[:3, 3]) for one in (right, wrong)]
    assert off[0] < off[1]
