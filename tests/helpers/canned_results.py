"""Results with poses about a known base, for tests of commands that read results."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from dvrk_cmaes import Result
from dvrk_cmaes.instrument.arm import base_from_root
from dvrk_cmaes.results.result import ExpectedError, Quality
from helpers.files import write_json
from helpers.transforms import moved

BASE = moved(np.eye(4), [0.07, -0.07, 0.055, 0.9, 1.8, -0.4])
"""camera_from_base of every frame."""
EXPECTED_ERROR = ExpectedError({"mean": 1.1}, {}, 1.1, 0.5)
"""A stated error of the tips."""


def canned(frame: str, number: int = 0, **changes: Any) -> Result:
    """Make an ok result of the bundled needle driver whose outer readings are exact; ``number`` varies the pose."""
    outer = {"yaw": 0.1 * number, "pitch": 0.2 - 0.05 * number, "insertion": 0.12 + 0.004 * number, "roll": -0.6}
    pose = BASE @ base_from_root(outer)
    joints = {"wrist_pitch": 0.3 - 0.1 * number, "wrist_yaw": -0.2, "jaw": 0.7}
    result = Result(
        frame=frame,
        status="ok",
        reasons=(),
        instrument="lnd",
        root_link="roll_link",
        camera_from_root=pose,
        joints=joints,
        readings={**outer, "wrist_pitch": 0.25, "wrist_yaw": -0.15, "jaw": 0.8},
        camera_from_base=BASE,
        quality=Quality(0.96, 0.1, {"mse": 0.02}, 0.6, 2.1),
        seconds=0.75,
        version="1.0.0",
    )
    return replace(result, **changes)


def failed(frame: str, reason: str = "mask: empty") -> Result:
    """Make the result of a frame that failed."""
    return Result(frame, "failed", (reason,), "lnd", "roll_link", None, {}, {})


def write_results(out: Path, *results: Result) -> Path:
    """Write results as a batch does; returns the folder."""
    for result in results:
        write_json(out / "frames" / f"{result.frame}.json", result.to_dict())
    return out
