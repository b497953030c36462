"""The base on which most frames agree, with up to a third of the frames in a wrong mode, on another base or noisy."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers.session_worlds import OFFSETS, SEEN, make_world
from helpers.transforms import exp_rotation, moved

from dvrk_cmaes import Body, Instrument
from dvrk_cmaes.calibration.consensus import Mode, choose_modes, find_consensus, find_consensus_at_any_roll
from dvrk_cmaes.geometry import Posed
from dvrk_cmaes.pose.search.modes import twin_of

COVARIANCE = np.diag(SEEN**2)


def with_twin(instrument: Instrument, mode: Mode) -> list[Mode]:
    return [mode, Mode(twin_of(instrument, mode.at), COVARIANCE)]


@pytest.mark.parametrize("seed", range(4))
def test_true_modes_are_chosen(seed: int, bundled_body: Body) -> None:
    world = make_world(9, seed)
    modes = [with_twin(bundled_body.instrument, own[0]) for own in world.modes(np.random.default_rng(seed))]
    for i in (0, 3, 6):
        modes[i].reverse()
    found = find_consensus(world.model, modes)
    assert found.agree.all()
    chosen = choose_modes(world.model, modes, found.calibration)
    assert [own.index(mode) for own, mode in zip(modes, chosen, strict=True)] == [1, 0, 0, 1, 0, 0, 1, 0, 0]


@pytest.mark.parametrize("wrong", ["anywhere", "all on another base", "turned about their shafts"])
def test_frames_on_another_base_disagree(wrong: str) -> None:
    world, rng = make_world(12, seed=8), np.random.default_rng(1)
    modes = world.modes(rng)
    bad = [2, 5, 6, 11]
    for k, i in enumerate(bad):
        pose = modes[i][0].at.pose
        if wrong == "anywhere":
            change = np.concatenate([rng.uniform(0.02, 0.05, 3), rng.uniform(0.5, 2, 3)])
            pose = moved(pose, change)
        elif wrong == "all on another base":
            shift = np.eye(4)
            shift[:3, :3], shift[:3, 3] = exp_rotation([0.2, 0.4, 0.1]), [0.02, 0.03, -0.02]
            pose = shift @ pose
        else:
            pose = moved(pose, np.array([0, 0, 0, 0, 0, (2.4, -2.5, 2.8, -3.0)[k]]))
        modes[i] = [Mode(Posed(pose, modes[i][0].at.joints), COVARIANCE)]
    found = find_consensus(world.model, modes)
    assert np.flatnonzero(~found.agree).tolist() == bad


@pytest.mark.parametrize("seed", range(2))
def test_frames_agree_although_the_offset_of_roll_is_not_known(seed: int) -> None:
    world = make_world(9, seed, offsets=OFFSETS + np.array([0, np.deg2rad(14), 0, 0, 0]))
    found = find_consensus(world.model, world.modes(np.random.default_rng(seed)))
    assert found.agree.all()
    assert found.mean_misfit < 2


def test_frame_without_wrist_readings_agrees_by_pose() -> None:
    world = make_world(6)
    modes = world.modes(np.random.default_rng(0))
    joints = world.model.joints.copy()
    joints[2:4] = np.nan
    found = find_consensus(replace(world.model, outer=world.model.outer, joints=joints), modes)
    assert found.agree.all()
    assert np.isfinite(found.calibration.offsets).all()


@pytest.mark.parametrize("off_deg", [-75.0, 60.0])
def test_frames_agree_at_any_offset_of_roll_and_with_rolls_that_scatter(off_deg: float) -> None:
    """As of a tool that was not homed, whose masks hardly tell the rotation about the shaft."""
    world, rng = (
        make_world(9, 3, offsets=OFFSETS + np.array([0, np.deg2rad(off_deg), 0, 0, 0])),
        np.random.default_rng(2),
    )
    modes = [
        [Mode(Posed(moved(own.at.pose, np.array([0, 0, 0, 0, 0, turn])), own.at.joints), own.covariance)]
        for (own,), turn in zip(world.modes(rng), rng.normal(scale=np.deg2rad(12), size=9), strict=True)
    ]
    assert find_consensus(world.model, modes).agree.mean() < 0.5
    found = find_consensus_at_any_roll(world.model, modes)
    assert found.agree.all()
    assert np.degrees(found.calibration.offsets[1]) == pytest.approx(off_deg + 6, abs=15)
    base, true = found.calibration.camera_from_base, world.truth.camera_from_base
    assert np.linalg.norm(base[:3, 3] - true[:3, 3]) < 0.01
