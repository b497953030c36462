"""Readings are refused as those of another arm only where its length explains the frames better, and is more likely."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers.session_worlds import make_frames_in_memory

from dvrk_cmaes import Body, EstimateConfig, InputError
from dvrk_cmaes.calibration import consensus
from dvrk_cmaes.calibration.consensus import ArmModes, Consensus, check_arm, find_consensus
from dvrk_cmaes.calibration.model import SessionModel


@pytest.mark.parametrize("more_likely", [False, True])
def test_small_misfits_alone_are_not_another_arm(
    bundled_body: Body, monkeypatch: pytest.MonkeyPatch, more_likely: bool
) -> None:
    """A hypothesis of an uncertain mode has small misfits in all frames, and is less likely."""
    results = [frame.result for frame in make_frames_in_memory(bundled_body, 6)[2]]
    readings = [result.readings for result in results]
    arm = ArmModes.of_results(SessionModel.of(readings, bundled_body.instrument, EstimateConfig(), "classic"), results)
    found = find_consensus(arm)
    poor = replace(found, misfit=np.full_like(found.misfit, 1.0))

    def of_another_length(_: ArmModes) -> Consensus:
        return replace(found, misfit=np.full_like(found.misfit, 0.1), cost=found.cost + (-1.0 if more_likely else 1.0))

    monkeypatch.setattr(consensus, "find_consensus", of_another_length)
    if more_likely:
        with pytest.raises(InputError, match="the readings fit an arm or tool 51 mm longer"):
            check_arm(arm, poor)
    else:
        check_arm(arm, poor)
