"""A long session: few of its frames lead to the estimates, which are from all of them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import pytest
from helpers.session_worlds import make_frames_in_memory
from helpers.transforms import change_between

from dvrk_cmaes import Body, EstimateConfig, SolvedSession, calibrate_session
from dvrk_cmaes.calibration import linearise
from dvrk_cmaes.calibration.frame_task import fit_task
from dvrk_cmaes.calibration.linearise import few_of, outline_task
from dvrk_cmaes.config import SessionConfig

COUNT, FEW = 12, 5


def solved(body: Body, config: EstimateConfig | None = None) -> tuple[SolvedSession, list[tuple[str, int]]]:
    """Calibrate a session; returns the numbers of frames that were fitted and whose outlines were linearised, too."""
    tasks: list[tuple[str, int]] = []

    def run(function: Callable[[Body, EstimateConfig, Any], Any], of_frames: Sequence[Any]) -> list[Any]:
        if function in (fit_task, outline_task):
            tasks.append((function.__name__, len(of_frames)))
        return [function(body, EstimateConfig(), task) for task in of_frames]

    frames = make_frames_in_memory(body, COUNT, level="clean", seed=11)[2]
    return calibrate_session(frames, body, run=run, config=config), tasks


def test_few_frames_are_those_of_the_whole_recording() -> None:
    few = few_of(600)
    assert few is not None
    assert (len(few), few[0], few[-1]) == (100, 0, 599)
    assert np.diff(few).min() >= 6
    assert few_of(199) is None


def test_few_frames_lead_to_the_same_calibration_as_all(bundled_body: Body, monkeypatch: pytest.MonkeyPatch) -> None:
    by_all, tasks = solved(bundled_body)
    assert tasks[0] == ("fit_task", COUNT)
    assert all(count in (COUNT, FEW) or name == "fit_task" for name, count in tasks)
    monkeypatch.setattr(linearise, "FEW", FEW)
    by_few, tasks = solved(bundled_body)
    fitted = [count for name, count in tasks if name == "fit_task"]
    assert fitted[0] == FEW
    assert fitted[1] <= FEW
    assert fitted[2] == COUNT  # the first round in which predictions are not widened
    linearised = [count for name, count in tasks if name == "outline_task"]
    assert linearised[0] == FEW
    assert linearised[-1] == COUNT
    std = np.sqrt(np.diag(by_all.calibration.covariance))
    off = change_between(by_few.calibration.camera_from_base, by_all.calibration.camera_from_base)
    assert (np.abs(off) < 0.1 * std[:6]).all()
    for name, of_axis in zip(by_all.calibration.offsets, std[6:], strict=True):
        assert by_few.calibration.offsets[name] == pytest.approx(by_all.calibration.offsets[name], abs=0.1 * of_axis)
    np.testing.assert_allclose(np.sqrt(np.diag(by_few.calibration.covariance)), std, rtol=0.25)
    assert [result.status for result in by_few.results.values()] == [
        result.status for result in by_all.results.values()
    ]


def test_all_frames_take_part_in_the_only_round(bundled_body: Body, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(linearise, "FEW", FEW)
    by_few, tasks = solved(bundled_body, EstimateConfig(session=SessionConfig(rounds=1, test_camera=False)))
    assert tasks[0] == ("fit_task", COUNT)
    assert len(by_few.results) == COUNT
