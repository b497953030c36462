"""An endoscope that moves in a session: its derivatives, the camera in its tip, pieces without readings, documents."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest
from helpers.session_worlds import BASE, NAMES, SEEN, make_world
from helpers.transforms import change_between, moved

from dvrk_cmaes import InputError, SessionCalibration
from dvrk_cmaes.calibration.blocks import BASE_AXES, OUTER_OFFSETS
from dvrk_cmaes.calibration.consensus import Mode, find_consensus
from dvrk_cmaes.calibration.endoscope import (
    Endoscope,
    EndoscopeValues,
    Pieces,
    Steered,
    in_tip,
)
from dvrk_cmaes.calibration.endoscope_search import find_hand_eye, find_pieces
from dvrk_cmaes.calibration.model import SessionModel
from dvrk_cmaes.calibration.session_endoscope import SessionEndoscope
from dvrk_cmaes.calibration.solve import Solved, solve_with_modes
from dvrk_cmaes.geometry import Posed
from dvrk_cmaes.joints.names import ECM_JOINTS
from dvrk_cmaes.synth.steering import Steering

FRAMES = 40
NAMES_OF_FRAMES = [f"{k:04d}" for k in range(FRAMES)]


@dataclass(frozen=True, eq=False)
class Steered40:
    """A session of 40 frames without images: readings, modes, and the true base of each frame."""

    steering: Steering
    model: SessionModel
    modes: list[list[Mode]]
    read: np.ndarray
    bases: np.ndarray


def steered_world(seed: int, *, still: bool = False, frames: int = FRAMES) -> Steered40:
    """Move arm and endoscope; each frame has a mode near the truth and one far away."""
    rng, world, steering = np.random.default_rng(seed), make_world(frames, seed), Steering.draw(seed, frames)
    relative = np.tile(np.eye(4), (frames, 1, 1)) if still else steering.camera_from_first
    bases = relative @ BASE
    seen = Posed(relative @ world.at.pose, world.at.joints)
    modes = []
    for at in (seen[k] for k in range(frames)):
        near = at.moved(SEEN * rng.standard_normal(9))
        far = at.moved(np.concatenate([rng.normal(0, 0.01, 3), rng.normal(0, 1, 3), np.zeros(3)]))
        modes.append([Mode(one, np.diag(SEEN**2)) for one in ((near, far) if rng.random() < 0.7 else (far, near))])
    read = np.stack([steering.late(0.0)[name] for name in ECM_JOINTS], axis=1)
    return Steered40(steering, world.model, modes, read, bases)


def solved(world: Steered40, endoscope: Endoscope, index: np.ndarray | None = None) -> tuple[SessionModel, Solved]:
    """Solve a session whose endoscope is given, from the consensus of some frames."""
    model = replace(world.model, endoscope=endoscope)
    some = np.arange(FRAMES) if index is None else index
    consensus = find_consensus(model.subset(some), [world.modes[i] for i in some])
    return model, solve_with_modes(model, world.modes, consensus.calibration)


@pytest.fixture(scope="module")
def world() -> Steered40:
    return steered_world(2)


@pytest.fixture(scope="module")
def found(world: Steered40) -> tuple[SessionModel, Solved]:
    steered = Steered.of(world.read)
    assert steered is not None
    return solved(world, find_hand_eye(world.model, world.modes, steered))


def an_endoscope(kind: str) -> tuple[Endoscope, EndoscopeValues]:
    rng = np.random.default_rng(0)
    if kind == "pieces":
        pieces = Pieces.of(np.repeat([0, 2, 1], 4), moved(np.eye(4), rng.normal(0, 0.1, (2, 6))))
        return pieces, pieces.start
    read = np.repeat([[0.1, 0.05, 0.12, 0.2], [0.2, -0.05, 0.13, 0.1], [0.0, 0.1, 0.1, 0.4]], 4, axis=0)
    read[5] += 0.02  # in motion
    steered = Steered.of(read)
    assert steered is not None
    return steered, steered.start.changed(0.05 * rng.standard_normal(len(steered.start.std)))


def test_camera_in_the_tip_is_found_within_its_deviation(world: Steered40, found: tuple[SessionModel, Solved]) -> None:
    model, solution = found
    values = solution.calibration.endoscope
    true = world.steering
    std = np.sqrt(np.diag(np.linalg.inv(solution.information)))[11:]
    off = in_tip(values.tip_from_camera) @ change_between(values.tip_from_camera, true.tip_from_camera)
    assert (np.abs(off) < 3 * std[:6]).all()
    assert (np.abs(true.offsets - values.offsets) < 3 * std[6:10]).all()
    assert np.degrees(std[3:5]).max() < 1.5  # of 4 deg beforehand
    apart = change_between(model.camera_from_base(solution.calibration), world.bases)
    stands = model.endoscope is not None and model.endoscope.place >= 0
    assert np.median(np.linalg.norm(apart[stands, :3], axis=1)) < 1e-3


def test_readings_of_an_endoscope_that_stands_change_nothing() -> None:
    rng = np.random.default_rng(3)
    read = np.array([0.1, 0.2, 0.1, 0.3]) + 1e-5 * rng.standard_normal((30, 4))
    assert Steered.of(read) is None
    assert Steered.of(np.full((30, 4), np.nan)) is None


@pytest.mark.parametrize("seed", [1, 5])
def test_a_session_without_readings_is_cut_where_the_camera_moved(seed: int) -> None:
    world = steered_world(seed)
    consensus = find_consensus(world.model, world.modes)
    found = find_pieces(world.model, world.modes, consensus)
    assert found is not None
    pieces, agree = found
    cuts = np.flatnonzero(np.diff(pieces.piece)) + 1
    assert len(cuts) == 3
    np.testing.assert_allclose(cuts, [9.75, 19.5, 29.25], atol=3)
    model, solution = solved(world, pieces, agree)
    apart = change_between(model.camera_from_base(solution.calibration), world.bases)[[3, 14, 25, 36]]
    assert np.linalg.norm(apart[:, :3], axis=1).max() < 4e-3


def test_frames_that_err_alike_make_no_pieces_of_their_own() -> None:
    """The modes of a hundred frames err as masks do: those near each other by nearly as much.

    Runs of them by themselves tell more bases than there are, as they tell other offsets, too. With shared offsets they
    do not, however many frames are taken to err alike.
    """
    world, rng = steered_world(1, frames=100), np.random.default_rng(1)
    error, modes = np.zeros(9), []
    for of_frame in world.modes:
        error = 0.9 * error + np.sqrt(1 - 0.9**2) * rng.standard_normal(9)
        modes.append([replace(mode, at=mode.at.moved(2 * SEEN * error)) for mode in of_frame])
    consensus = find_consensus(world.model, modes)
    for alike in (1.0, 5.0):
        found = find_pieces(world.model, modes, consensus, alike=alike)
        assert found is not None
        pieces, _ = found
        counts = np.bincount(pieces.piece, minlength=len(pieces.start.poses) + 1)
        assert len(counts) == len(pieces.start.poses) + 1
        assert counts.min() > 0
        assert counts[0] == counts.max()
        assert len(counts) == 4
        np.testing.assert_allclose(np.flatnonzero(np.diff(pieces.piece)) + 1, [25, 50, 75], atol=3)


def test_a_session_whose_camera_stands_still_is_not_cut() -> None:
    world = steered_world(1, still=True)
    consensus = find_consensus(world.model, world.modes)
    assert find_pieces(world.model, world.modes, consensus) is None


def as_document(model: SessionModel, solution: Solved) -> SessionCalibration:
    """Make a session's calibration of a solution."""
    calibration, covariance = solution.calibration, np.linalg.inv(solution.information)
    names = (*OUTER_OFFSETS, *NAMES)
    times = [0.1 * k for k in range(FRAMES)]
    spreads = dict.fromkeys(("yaw", "pitch", "insertion", "roll", *NAMES, "slack_translation", "slack_rotation"), 1e-3)
    return SessionCalibration(
        instrument="lnd",
        camera_from_base=calibration.camera_from_base,
        offsets=dict(zip(names, calibration.offsets.tolist(), strict=True)),
        axes=(*BASE_AXES, *names),
        covariance=covariance[:11, :11],
        covariance_given_camera=covariance[:11, :11],
        spreads=spreads,
        endoscope=SessionEndoscope.of(model, calibration, covariance, NAMES_OF_FRAMES, times),
    )


def test_document_gives_each_frame_its_base(world: Steered40, found: tuple[SessionModel, Solved]) -> None:
    session = SessionCalibration.from_dict(as_document(*found).to_dict())
    assert session.endoscope is not None
    assert session.endoscope.ecm_from_base is not None
    expected = found[0].camera_from_base(found[1].calibration)
    for k in (2, 14, 37):
        there = session.at(dict(zip(ECM_JOINTS, world.read[k].tolist(), strict=True)))
        assert isinstance(there, SessionCalibration)
        assert there.endoscope is None
        np.testing.assert_allclose(there.camera_from_base, expected[k], atol=1e-6)
    moving = session.at(dict(zip(ECM_JOINTS, (world.read[2] + 0.03).tolist(), strict=True)))
    assert isinstance(moving, SessionCalibration)
    std, still = (np.sqrt(np.diag(one.covariance)[3:6]).max() for one in (moving, session))
    assert std > still
    assert "no reading of ecm_yaw" in str(session.at({"yaw": 0.1}))
    assert any("ecm_yaw" in text for text in session.endoscope.undetermined)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"covariance": [[1.0]]}, "endoscope: covariance: expected"),
        ({"offsets": {"ecm_yaw": 0.1}}, "endoscope: offsets: expected those of ecm_yaw"),
        ({"tip_from_camera": None}, "endoscope: places: expected"),
    ],
)
def test_wrong_documents_are_refused(found: tuple[SessionModel, Solved], change: dict[str, Any], message: str) -> None:
    document = as_document(*found).to_dict()
    document["endoscope"] |= change
    with pytest.raises(InputError, match=message):
        SessionCalibration.from_dict(document)
