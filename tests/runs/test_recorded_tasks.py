"""What is sent to processes to fit the frames of a recording: of each block its own frames, not the recording."""

from __future__ import annotations

import pickle
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from dvrk_cmaes import Camera, FrameFiles, Rig
from dvrk_cmaes.geometry import Posed
from dvrk_cmaes.runs import recording
from dvrk_cmaes.track.frame_fits import PredictedFrame

RIG = Rig.of_camera(Camera(640, 480, 880, 880, 330, 250))


def tasks_of(count: int, monkeypatch: pytest.MonkeyPatch) -> list[tuple[PredictedFrame, ...]]:
    """Return the tasks for a recording of so many frames."""
    files = tuple(FrameFiles(f"{k:04d}", Path(f"masks/{k:04d}.png"), readings={"jaw": 0.1}) for k in range(count))
    whole: Any = SimpleNamespace(files=files, rig=RIG)
    changed = tuple(replace(view, camera=replace(view.camera, fx=900.0)) for view in RIG.views)
    session: Any = SimpleNamespace(corrected_views=lambda _: changed, masks=None)
    at = Posed(np.tile(np.eye(4), (count, 1, 1)), np.zeros((count, 3)))
    predicted: Any = SimpleNamespace(at=at, spread=np.tile(np.eye(9), (count, 1, 1)))
    sent: list[tuple[PredictedFrame, ...]] = []

    def run(function: Any, tasks: Any) -> list[list[None]]:
        sent.extend(tasks)
        return [[None] * len(task) for task in tasks]

    fitted = recording.RecordedSolution(whole, session).fits(predicted, run)
    assert len(fitted) == count
    return sent


def test_task_is_as_large_in_a_long_recording_as_in_a_short_one(monkeypatch: pytest.MonkeyPatch) -> None:
    short, long = (tasks_of(count, monkeypatch) for count in (recording.BLOCK, 40 * recording.BLOCK))
    assert len(long) == 40 * len(short)
    assert len(pickle.dumps(long[0])) == len(pickle.dumps(short[0]))


def test_frames_are_read_with_the_cameras_of_the_calibration(monkeypatch: pytest.MonkeyPatch) -> None:
    (task,) = tasks_of(3, monkeypatch)
    frame = pickle.loads(pickle.dumps(task))[2]
    files, rig = frame.read.args
    assert (frame.name, files.name) == ("0002", "0002")
    assert rig.views[0].camera == replace(RIG.views[0].camera, fx=900.0)
