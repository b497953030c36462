"""Faults of a whole session: a moved base, a wrong arm or tool, an arm without motion."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers.session_worlds import SEEN, World, make_world
from helpers.transforms import exp_rotation, transform

from dvrk_cmaes import InputError
from dvrk_cmaes.calibration.consensus import Mode, check_arm, find_consensus
from dvrk_cmaes.calibration.endoscope_search import find_pieces


def modes_of(world: World, seed: int = 0) -> list[list[Mode]]:
    return world.modes(np.random.default_rng(seed))


def on_another_base(modes: list[list[Mode]], *, turned: float = 0.2, by: float = 0.02) -> list[list[Mode]]:
    shift = transform(exp_rotation([turned, -turned / 2, turned / 3]), [by, -by, by / 2])
    return [[Mode(mode.at.seen_from(shift), np.diag(SEEN**2)) for mode in own] for own in modes]


def cuts(world: World, modes: list[list[Mode]]) -> list[int]:
    """Return the first frame of each piece of a session but the first."""
    consensus = find_consensus(world.model, modes)
    found = find_pieces(world.model, modes, consensus)
    return [] if found is None else (np.flatnonzero(np.diff(found[0].piece)) + 1).tolist()


# a base or camera that moved


def test_base_moved_by_6_mm_is_found() -> None:
    world = make_world(14, seed=3)
    modes = modes_of(world)
    modes[8:] = on_another_base(modes[8:], turned=0.0, by=0.006)
    assert cuts(world, modes) == [8]


def test_scattered_frames_of_another_base_are_no_move() -> None:
    world = make_world(12, seed=2)
    modes = modes_of(world)
    there = on_another_base(modes)
    for i in (1, 5, 9):
        modes[i] = there[i]
    assert cuts(world, modes) == []


def test_session_with_fixed_base_has_no_move() -> None:
    world = make_world(12)
    modes = modes_of(world)
    assert cuts(world, modes) == []


# a wrong arm or tool, an arm without motion


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"arm": "si"}, "51 mm longer"),
        ({"roll_offset": 0.467}, "51 mm shorter"),
    ],
)
def test_wrong_arm_or_tool_is_found_by_length(wrong: dict[str, object], message: str) -> None:
    world = make_world(10, seed=1)
    model = replace(world.model, **wrong)  # type: ignore[arg-type]
    modes = modes_of(world)
    consensus = find_consensus(model, modes)
    with pytest.raises(InputError, match=r"--arm, or the tool's own roll joint \(--tool\)") as caught:
        check_arm(model, modes, consensus)
    assert message in str(caught.value)
