"""Fits of cables to recordings of an arm."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from dvrk_cmaes.joints.cable_prior import cable_prior, measured_cables
from dvrk_cmaes.joints.play import play_of

pytestmark = pytest.mark.usefixtures("scripts_on_path")

NAMES = ("roll", "wrist_pitch", "wrist_yaw")


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording whose errors follow the model exactly, up to noise of a tenth of a degree."""
    rng = np.random.default_rng(1)
    time = 0.4 * np.arange(1200)
    phases = rng.uniform(0, 2 * np.pi, 3)
    waves = 0.7 * np.sin(2 * np.pi * time[:, None] / [23.0, 17.0, 13.0] + phases)
    waves += 0.3 * np.sin(2 * np.pi * time[:, None] / [5.0, 7.0, 3.0])
    truth = measured_cables(NAMES)[0]
    errors = truth.errors(waves, play_of(waves, truth.width)) + np.deg2rad(0.1) * rng.standard_normal(waves.shape)
    commanded = np.concatenate([np.zeros((len(time), 3)), waves], axis=1)
    measured = commanded + np.concatenate([np.zeros((len(time), 3)), errors], axis=1)
    measured[100] = 0.0  # not measured
    path = tmp_path_factory.mktemp("recording") / "made.npz"
    np.savez(path, time=time, commanded=commanded, measured=measured)
    return path


def test_the_whole_model_predicts_the_second_half_to_the_noise(recording: Path) -> None:
    import cables

    rows, model = cables.report(cables.Recording.read(recording))
    errors = {row["model"]: max(row[f"{name}, deg"] for name in NAMES) for row in rows}
    assert errors["+ drag"] < 0.4 < errors["+ coupling"] < errors["offset"]
    # coupling takes up a part of a joint's play where both move the errors alike
    np.testing.assert_allclose(model.width[1:], measured_cables(NAMES)[0].width[1:], rtol=0.3)


def test_poses_without_a_measurement_do_not_count(recording: Path) -> None:
    import cables

    assert cables.Recording.read(recording).has.sum() == 1199
    assert cables.Recording.read(recording, every_pose=True).has.sum() == 1200


@pytest.mark.parametrize("name", ["random", "peg_transfer"])
def test_the_committed_fits_predict_the_recordings_that_they_are_of(shared: Path, name: str) -> None:
    import cables

    recording = cables.Recording.read(shared / "cables" / f"{name}.npz")
    model = measured_cables(NAMES)[["peg_transfer", "random"].index(name)]
    has = recording.has
    left = np.degrees(np.sqrt(np.mean(cables.residuals(recording, model)[has] ** 2, axis=0)))
    before = np.degrees(np.std(recording.errors[has], axis=0))
    assert (left[1:] < 0.4 * before[1:]).all()


def test_a_joint_that_was_not_measured_has_the_play_of_the_wrist_and_an_unknown_coupling() -> None:
    prior = cable_prior((*NAMES, "jaw"))
    own = np.diag(prior.model.play)
    assert own[3] == pytest.approx(own[1:3].mean())
    assert prior.model.coupling[3].tolist() == [0.0] * 4
    assert prior.spread[3, :4].min() > 0.1
