"""The lag between images and readings: search, refinement, standard deviation, and its document."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers.session_worlds import EXPECTED_OFFSETS, NAMES, SEEN, World, make_world

from dvrk_cmaes import InputError, Lag, ReadingSeries
from dvrk_cmaes.calibration.blocks import Calibration
from dvrk_cmaes.calibration.consensus import Mode, find_consensus
from dvrk_cmaes.calibration.lag import POSTURES, Refined, SessionLag, in_common, refine_lag
from dvrk_cmaes.calibration.model import SessionModel
from dvrk_cmaes.calibration.solve import ArmFrames, FrameFits
from dvrk_cmaes.geometry import Posed
from dvrk_cmaes.instrument.arm import OUTER_JOINTS
from dvrk_cmaes.pose.terms.term import Quadratic

ROWS, FPS = 240, 30.0


def moving_world(
    lag: float,
    seed: int,
    *,
    count: int = ROWS,
    every: int = 6,
    noise: float = 0.3,
) -> tuple[World, SessionLag, list[list[Mode]]]:
    """Make a smooth motion read at 30 Hz, and frames at every 6th row whose images are ``lag`` rows late.

    The noise of the readings is in standard deviations of the model's.
    """
    rng = np.random.default_rng(seed)
    blank = make_world(2, seed)
    rows = np.arange(count)
    amplitude = np.array([0.15, 0.15, 0.02, 0.8, 0.4, 0.4, 0.3])
    phase, period = rng.uniform(0, 6.3, 7), rng.uniform(1.5, 4, 7)

    def true_readings(at: np.ndarray) -> np.ndarray:
        middle = np.array([0, 0, 0.14, 0, 0, 0, 0.8])
        return middle + amplitude * np.sin(2 * np.pi * at[:, None] / FPS / period + phase)

    deviations = np.array([*blank.model.deviations.outer, *blank.model.deviations.joints])
    values = true_readings(rows.astype(float)) + noise * deviations * rng.standard_normal((count, 7))
    frames = np.arange(12, count - 24, every, dtype=float)
    series = ReadingSeries(
        "frames",
        dict.fromkeys((*OUTER_JOINTS, *NAMES), rows.astype(float)),
        dict(zip((*OUTER_JOINTS, *NAMES), values.T, strict=True)),
        {f"{int(frame):04d}": float(frame) for frame in frames},
        1.0,
    )
    read_at = frames - lag
    shown = true_readings(read_at)
    at = SessionModel(shown[:, :4], shown[:, 4:], NAMES, blank.model.deviations).predict(blank.truth)
    clock = SessionLag.of(series, list(series.frames), blank.model.deviations.outer)
    read = series.at((*OUTER_JOINTS, *NAMES), frames)
    usual = blank.model.deviations
    model = SessionModel(read[:, :4], read[:, 4:], NAMES, usual, offset_std=EXPECTED_OFFSETS)
    world = World(model, blank.truth, at)
    return world, clock, world.modes(rng)


def refined_near(lag: float, world: World, clock: SessionLag, modes: list[list[Mode]]) -> Refined:
    """Refine a lag from the whole frame nearest to it."""
    start = float(round(lag))
    model = clock.model_at(world.model, start)
    found = find_consensus(model, modes, hypothesis_frames=6)
    frames = ArmFrames(model, fits_of(modes), found.calibration)
    refined = refine_lag([(clock, frames)], start)
    assert refined is not None
    return refined


def found_lag(lag: float, world: World, clock: SessionLag, modes: list[list[Mode]]) -> tuple[float, float]:
    """Search a lag, which must be found to a frame, and refine it."""
    found = clock.searched(world.model, modes)
    assert found.curve is not None
    assert found.curve.lags[found.curve.misfit.argmin()] == pytest.approx(lag, abs=1.0)
    assert found.known is not None
    return found.known


def fits_of(modes: list[list[Mode]]) -> FrameFits:
    information = np.tile(np.diag(SEEN**-2.0), (len(modes), 1, 1))
    return FrameFits(Posed.stacked(own[0].at for own in modes), Quadratic(information, np.zeros((len(modes), 9))))


@pytest.mark.parametrize("lag", [-3.0, 0.0, 0.4, 2.6, 4.0, 11.5])
def test_lag_is_found_to_a_fraction_of_a_frame(lag: float) -> None:
    value, std = found_lag(lag, *moving_world(lag, seed=1))
    assert value == pytest.approx(lag, abs=0.3)
    assert 0 < std < 0.3


def test_noise_of_the_readings_does_not_draw_the_lag_to_the_middle_between_two_rows() -> None:
    found = [refined_near(0.0, *moving_world(0.0, seed, noise=1.5))[0] for seed in range(8)]
    assert np.median(np.abs(found)) < 0.12


def test_stated_standard_deviation_covers_the_error() -> None:
    errors = []
    for seed in range(8):
        value, std = refined_near(1.7, *moving_world(1.7, seed))
        errors.append(abs(value - 1.7) / std)
    assert max(errors) < 2
    # these frames share no errors, which the standard deviation allows for
    assert 0.2 < np.sqrt(np.mean(np.square(errors))) < 0.5


def test_wrong_frames_do_not_change_the_lag() -> None:
    world, clock, modes = moving_world(4.0, seed=2)
    strange = moving_world(4.0, seed=52)[2]
    for i in range(0, len(modes), 4):
        modes[i] = strange[i]
    assert found_lag(4.0, world, clock, modes)[0] == pytest.approx(4.0, abs=0.4)


def test_arm_that_hardly_moves_determines_no_lag() -> None:
    world, clock, _ = moving_world(3.0, seed=3)
    slow = {name: values.mean() + 1e-3 * (values - values.mean()) for name, values in clock.series.values.items()}
    still = SessionLag.of(replace(clock.series, values=slow), list(clock.series.frames), world.model.deviations.outer)
    model = still.model_at(world.model, 0.0)
    held = replace(world, model=model, at=model.predict(world.truth))
    own = held.modes(np.random.default_rng(0))
    found = still.searched(held.model, own)
    assert found.lag is None
    assert found.undetermined


def described(clock: SessionLag, value: float, std: float) -> Lag:
    lag = clock.decided(Refined(value, std))
    assert isinstance(lag, Lag)
    return lag


def test_lag_is_applied_only_if_it_differs_from_zero() -> None:
    _, clock, _ = moving_world(0.0, seed=0)
    assert not described(clock, 0.2, 0.05).applied
    assert not described(clock, 0.5, 0.3).applied
    assert described(clock, 0.5, 0.1).applied
    assert described(clock, -1.0, 0.2).applied
    undetermined = clock.decided(Refined(4.0, 1.5))
    assert undetermined == (
        "standard deviation 1.5 frames; a recording in which the arm moves quickly would determine it"
    )


def test_true_calibration_is_recovered_at_the_lag() -> None:
    world, clock, modes = moving_world(3.0, seed=4)
    right: Calibration = find_consensus(clock.model_at(world.model, 3.0), modes).calibration
    wrong: Calibration = find_consensus(world.model, modes).calibration
    off = [np.linalg.norm(one.camera_from_base[:3, 3] - world.truth.camera_from_base[:3, 3]) for one in (right, wrong)]
    assert off[0] < off[1]


def test_arms_that_agree_share_their_lag_and_others_do_not() -> None:
    _, clock, _ = moving_world(2.0, 1)
    frame = clock.series.interval
    own, near, far = (
        replace(clock, lag=Lag.of(value * frame, std * frame, clock.series.unit, frame, applied=True))
        for value, std in ((2.0, 0.2), (2.3, 0.1), (4.0, 0.1))
    )
    both, other = in_common([own, near])
    assert both.lag is not None
    assert both.lag == other.lag
    assert both.lag.frames == pytest.approx((2.0 / 0.04 + 2.3 / 0.01) / (1 / 0.04 + 1 / 0.01))
    assert both.lag.std_frames == pytest.approx((1 / 0.04 + 1 / 0.01) ** -0.5)
    assert not both.alone
    apart = in_common([own, far])
    assert [lag.lag for lag in apart] == [own.lag, far.lag]
    assert all(lag.alone for lag in apart)
    unknown, _ = in_common([replace(own, lag=None, undetermined="the arm hardly moves"), near])
    assert unknown.lag is not None
    assert unknown.lag.frames == pytest.approx(2.3)


def shuffled(clock: SessionLag) -> ReadingSeries:
    """The rows of a series, and with them its frames, in another order."""
    order = np.random.default_rng(0).permutation(ROWS)
    place = np.argsort(order)
    frames = {name: float(place[int(time)]) for name, time in clock.series.frames.items()}
    values = {name: own[order] for name, own in clock.series.values.items()}
    return replace(clock.series, values=values, frames=frames)


def test_lag_is_found_in_rows_that_move_smoothly_and_not_in_shuffled_ones() -> None:
    world, clock, modes = moving_world(4.0, seed=1)
    names, outer_std = list(clock.series.frames), world.model.deviations.outer
    smooth = SessionLag.of(clock.series, names, outer_std).searched(world.model, modes)
    assert smooth.lag is not None
    assert smooth.lag.frames == pytest.approx(4.0, abs=0.3)
    estimate = SessionLag.of(shuffled(clock), names, outer_std)
    found = estimate.searched(world.model, modes)
    assert (found.lag, found.applied, found.undetermined) == (None, None, POSTURES)
    asked = SessionLag.of(shuffled(clock), names, outer_std, "auto")
    assert asked.searched(world.model, modes).curve is not None


def test_given_lag_is_neither_searched_nor_refined() -> None:
    world, clock, modes = moving_world(4.0, seed=1)
    names, outer_std = list(clock.series.frames), world.model.deviations.outer
    for text, frames in (("0", 0.0), ("3.5frames", 3.5)):
        given = SessionLag.of(clock.series, names, outer_std, Lag.parse("--lag", text))
        found = given.searched(world.model, modes)
        assert found is given
        assert found.lag == Lag(frames, 0.0, applied=frames != 0)
    assert SessionLag.of(None, names, outer_std, Lag.parse("--lag", "0")).applied is None
    with pytest.raises(InputError, match="expected readings of numbered frames"):
        SessionLag.of(None, names, outer_std, Lag(2.0))


def test_counted_frames_whose_readings_jump_have_no_known_times() -> None:
    world, clock, _ = moving_world(0.0, 1)
    names, outer_std = list(clock.series.frames), world.model.deviations.outer
    followed = SessionLag.of(clock.series, names, outer_std)
    assert followed.seconds() is not None
    far = np.random.default_rng(0).permutation(ROWS)
    picked = replace(clock.series, values={name: values[far] for name, values in clock.series.values.items()})
    estimate = SessionLag.of(picked, names, outer_std)
    assert estimate.seconds() is None
    assert estimate.play(NAMES, world.model.joints, np.full(len(NAMES), 0.1)) is None
    timed = SessionLag.of(replace(picked, unit="s"), names, outer_std)
    assert timed.seconds() is not None
