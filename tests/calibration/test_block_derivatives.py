"""The derivatives of the blocks that predict frames, against differences of what they predict."""

from __future__ import annotations

import numpy as np
from helpers.session_worlds import SMALL

from dvrk_cmaes import Body, EstimateConfig
from dvrk_cmaes.calibration.endoscope import Steered
from dvrk_cmaes.calibration.masks_and_sizes import WholeSize
from dvrk_cmaes.calibration.model import SessionModel
from dvrk_cmaes.geometry import moved


def test_predicted_blocks_have_the_derivatives_of_what_they_predict(bundled_body: Body) -> None:
    """Base, offsets, a steered endoscope and the size of the instrument."""
    rng, config, instrument = np.random.default_rng(75), EstimateConfig(), bundled_body.instrument
    names = ("yaw", "pitch", "insertion", "roll", *instrument.joint_names)
    readings = [dict(zip(names, 0.1 + 0.2 * rng.random(len(names)), strict=True)) for _ in range(6)]
    endoscope = Steered.of(np.repeat([[0.0, 0.1, 0.05, 0.0], [0.2, 0.0, 0.08, 0.3]], 3, axis=0))
    model = SessionModel.of(readings, instrument, config, "classic", endoscope)
    base = moved(np.eye(4), np.array([0.01, 0.05, 0.1, 0.4, -0.3, 0.2]))
    at = model.calibration(base, np.zeros(2 + len(instrument.joint_names)))
    at = at.with_blocks(WholeSize(config, SMALL), size=np.array([0.2]))
    found = model.jacobian(at)
    for number, one in enumerate(1e-6 * np.eye(found.shape[2])):
        ahead, behind = (model.predict(at.changed(step)) for step in (one, -one))
        assert np.allclose(ahead.minus(behind) / 2e-6, found[:, :, number], atol=1e-6)
