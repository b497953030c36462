"""scripts/bench.py steps: the time of each step of a running tracker."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from helpers.commands import Ran
from helpers.moving_worlds import SMALL

from dvrk_cmaes.calibration.document import SessionCalibration
from dvrk_cmaes.calibration.model import BASE_AXES, OUTER_OFFSETS
from dvrk_cmaes.frames.session_folder import read_session
from dvrk_cmaes.geometry import inverse
from dvrk_cmaes.instrument.arm import OUTER_JOINTS, base_from_root
from dvrk_cmaes.io.atomic import write_json
from dvrk_cmaes.silhouette.prepare import prepare
from dvrk_cmaes.synth.levels import LEVELS
from dvrk_cmaes.synth.recording import write_recording
from dvrk_cmaes.synth.session import SessionPlan
from dvrk_cmaes.track.unknown_base import STEP_OF_SEARCH

FRAMES = 14


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("recorded") / "session"
    write_recording(folder, SessionPlan(prepare("lnd"), SMALL, LEVELS["clean"], "video", FRAMES, 2, {}))
    return folder


def calibration_of(folder: Path) -> SessionCalibration:
    """Return a calibration by the truth of a recording's first frame, whose readings are exact."""
    instrument = prepare("lnd").instrument
    session = read_session(folder, known=instrument.joint_names)
    first = session.frames[0]
    outer = base_from_root(dict(first.readings), roll_offset=instrument.roll_offset)
    names = (*OUTER_OFFSETS, *instrument.joint_names)
    spreads = (*OUTER_JOINTS, *instrument.joint_names, "slack_translation", "slack_rotation")
    covariance = 1e-6 * np.eye(len(BASE_AXES) + len(names))
    return SessionCalibration(
        instrument=instrument.name,
        camera_from_base=session.truth.frames[first.name].camera_from_root @ inverse(outer),
        offsets=dict.fromkeys(names, 0.0),
        axes=(*BASE_AXES, *names),
        covariance=covariance,
        covariance_given_camera=covariance,
        spreads=dict.fromkeys(spreads, 1e-3),
        roll_offset=instrument.roll_offset,
    )


def test_by_a_given_calibration_no_step_searches(recorded: Path, tmp_path: Path, run_here: Callable[..., Ran]) -> None:
    given = tmp_path / "session.json"
    write_json(given, calibration_of(recorded).to_dict())
    options = ("--instrument", "lnd", "--sessions", recorded, "--calibration", given, "--slowest", FRAMES, "--json")
    done = run_here("bench", "steps", *options)
    assert done.code == 0, done.err
    steps = done.result["the slowest"]
    assert len(steps) == FRAMES
    assert all(step["calibrated"] for step in steps)
    assert not any("searching" in step["reasons"] for step in steps)


def test_longest_steps_are_listed(recorded: Path, run_here: Callable[..., Ran]) -> None:
    options = ("--instrument", "lnd", "--sessions", recorded, "--slowest", "3", "--repeats", "2", "--json")
    done = run_here("bench", "steps", *options)
    assert done.code == 0, done.err
    one, every = done.result["processor time of a step, ms"]
    assert (one.pop("session"), every.pop("session")) == ("session", "all")
    assert one == every
    assert one["steps"] == FRAMES
    assert 0 < one["median"] <= one["95 %"] <= one["worst"]
    assert 0 < one["most rows"] <= 3 * STEP_OF_SEARCH + 16 * SMALL.height + 100
    slowest = done.result["the slowest"]
    assert [row["ms"] for row in slowest] == sorted((row["ms"] for row in slowest), reverse=True)
    assert slowest[0]["ms"] == one["worst"]
    assert any("searching" in row["reasons"] for row in slowest)
