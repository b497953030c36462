"""What can be wrong with a whole session is named, each in one line, and never averaged over."""

from __future__ import annotations

import numpy as np
import pytest
from session_worlds import EXPECTED_OFFSETS, SEEN, World, make_world

from dvrk_cmaes.calibration.consensus import Mode, find_consensus
from dvrk_cmaes.calibration.faults import check_arm, check_motion, find_lag, find_move, shifted
from dvrk_cmaes.calibration.model import SessionModel
from dvrk_cmaes.errors import InputError
from dvrk_cmaes.geometry import exp_rotation, transform


def modes_of(world: World, seed: int = 0) -> list[list[Mode]]:
    return world.modes(np.random.default_rng(seed))


def on_another_base(modes: list[list[Mode]], *, turned: float = 0.2, by: float = 0.02) -> list[list[Mode]]:
    shift = transform(exp_rotation([turned, -turned / 2, turned / 3]), [by, -by, by / 2])
    return [[Mode(shift @ mode.camera_from_root, mode.joints, np.diag(SEEN**2)) for mode in own] for own in modes]


# readings that come late


@pytest.mark.parametrize("lag", [-2, -1, 1, 2, 3])
@pytest.mark.parametrize("seed", [0, 1])
def test_a_constant_lag_of_readings_is_found_in_frames(lag: int, seed: int) -> None:
    world = make_world(14, seed)
    # A frame's own reading is that of the frame ``lag`` places before it.
    model, kept = shifted(world.model, -lag)
    modes = [modes_of(world)[i] for i in kept]
    assert find_lag(model, modes, EXPECTED_OFFSETS) == lag


@pytest.mark.parametrize("seed", range(3))
def test_a_lag_is_found_where_half_of_the_frames_are_in_wrong_modes_for_it(seed: int) -> None:
    world = make_world(10, seed)
    model, kept = shifted(world.model, -2)
    modes = [modes_of(world)[i] for i in kept]
    strange = modes_of(make_world(10, seed + 50))
    for i in (2, 4, 5, 7):
        modes[i] = strange[i]
    assert find_lag(model, modes, EXPECTED_OFFSETS) == 2


@pytest.mark.parametrize("seed", range(3))
def test_readings_in_time_have_no_lag(seed: int) -> None:
    world = make_world(10, seed)
    assert find_lag(world.model, modes_of(world, seed), EXPECTED_OFFSETS) == 0


def test_bad_frames_are_no_lag() -> None:
    world = make_world(12, seed=5)
    modes = modes_of(world)
    others = modes_of(make_world(12, seed=6))
    for i in (0, 4, 8, 9):
        modes[i] = others[i]
    assert find_lag(world.model, modes, EXPECTED_OFFSETS) == 0


def test_few_frames_are_not_searched_for_a_lag() -> None:
    model, kept = shifted(make_world(5).model, 1)
    modes = [modes_of(make_world(5))[i] for i in kept]
    assert find_lag(model, modes, EXPECTED_OFFSETS) == 0


def test_taking_out_a_lag_drops_the_frames_that_have_no_readings_left() -> None:
    world = make_world(6)
    late, kept = shifted(world.model, 2)
    assert kept == [0, 1, 2, 3]
    np.testing.assert_array_equal(late.outer, world.model.outer[2:])
    early, kept = shifted(world.model, -2)
    assert kept == [2, 3, 4, 5]
    np.testing.assert_array_equal(early.outer, world.model.outer[:4])


# a base or a camera that moved


@pytest.mark.parametrize(("frames", "at"), [(12, 7), (12, 4), (20, 10)])
def test_a_base_that_moved_is_told_by_the_frames_between_which_it_did(frames: int, at: int) -> None:
    world = make_world(frames, seed=1)
    modes = modes_of(world)
    modes[at:] = on_another_base(modes[at:])
    consensus = find_consensus(world.model, modes, EXPECTED_OFFSETS)
    move = find_move(world.model, modes, EXPECTED_OFFSETS, consensus)
    assert move is not None
    assert move.between == (at - 1, at)
    assert move.side == ("first" if at >= frames / 2 and consensus.agree[0] else "last")
    kept = range(at) if move.side == "first" else range(at, frames)
    assert set(move.others) == set(range(frames)) - set(kept)


def test_a_few_millimetres_suffice() -> None:
    world = make_world(14, seed=3)
    modes = modes_of(world)
    modes[8:] = on_another_base(modes[8:], turned=0.0, by=0.006)
    consensus = find_consensus(world.model, modes, EXPECTED_OFFSETS)
    move = find_move(world.model, modes, EXPECTED_OFFSETS, consensus)
    assert move is not None
    assert move.between == (7, 8)


def test_frames_of_another_base_here_and_there_are_no_move() -> None:
    world = make_world(12, seed=2)
    modes = modes_of(world)
    there = on_another_base(modes)
    for i in (1, 5, 9):
        modes[i] = there[i]
    consensus = find_consensus(world.model, modes, EXPECTED_OFFSETS)
    assert find_move(world.model, modes, EXPECTED_OFFSETS, consensus) is None


def test_bad_frames_at_the_end_that_agree_on_nothing_are_no_move() -> None:
    world = make_world(12, seed=2)
    modes = modes_of(world)
    modes[8:] = modes_of(make_world(12, seed=9))[8:]
    consensus = find_consensus(world.model, modes, EXPECTED_OFFSETS)
    assert find_move(world.model, modes, EXPECTED_OFFSETS, consensus) is None


def test_a_steady_session_has_not_moved() -> None:
    world = make_world(12)
    modes = modes_of(world)
    consensus = find_consensus(world.model, modes, EXPECTED_OFFSETS)
    assert find_move(world.model, modes, EXPECTED_OFFSETS, consensus) is None


# the wrong arm or tool, an arm that stands still


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"arm": "si"}, "51 mm longer"),
        ({"roll_offset": 0.467}, "51 mm shorter"),
    ],
)
def test_the_wrong_arm_or_tool_is_told_by_its_length(wrong: dict[str, object], message: str) -> None:
    world = make_world(10, seed=1)
    model = SessionModel(world.model.outer, world.model.joints, world.model.names, world.model.spreads, **wrong)  # type: ignore[arg-type]
    modes = modes_of(world)
    consensus = find_consensus(model, modes, EXPECTED_OFFSETS)
    with pytest.raises(InputError, match=r"--arm, or the tool's own roll joint \(--tool\)") as caught:
        check_arm(model, modes, EXPECTED_OFFSETS, consensus)
    assert message in str(caught.value)


def test_the_right_arm_passes() -> None:
    world = make_world(10, seed=1)
    modes = modes_of(world)
    check_arm(world.model, modes, EXPECTED_OFFSETS, find_consensus(world.model, modes, EXPECTED_OFFSETS))


def test_an_arm_that_stands_still_is_refused_by_name() -> None:
    world = make_world(6)
    still = world.model.of_readings(np.tile(world.model.outer[:1], (6, 1)), world.model.joints)
    with pytest.raises(InputError) as caught:
        check_motion(still)
    assert str(caught.value) == (
        "session: yaw, pitch, insertion, roll: expected readings of an arm that moves, got the same in all frames"
    )
    check_motion(world.model)
