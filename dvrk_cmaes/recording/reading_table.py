"""Joint readings in a file beside a recording: any file of readings whose rows have times."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from dvrk_cmaes.errors import InputError
from dvrk_cmaes.joints.interpolation import TimedReadings
from dvrk_cmaes.joints.reading import read_joint_file


def read_timed_joints(path: Path) -> tuple[TimedReadings, ...]:
    """Read readings over time; joints that are read at the same times stay together.

    Raises
    ------
    InputError
        Not a file of readings, or one without times.
    """
    file = read_joint_file(path)
    together: dict[bytes, list[TimedReadings]] = {}
    for one in file.timed:
        together.setdefault(one.times.tobytes(), []).append(one)
    if not together:
        raise InputError(f"{path}: expected joint readings with times (a column time, in seconds), got {file.kind}")
    return tuple(
        TimedReadings(
            str(path),
            tuple(name for one in some for name in one.joints),
            some[0].times,
            np.hstack([one.values for one in some]),
        )
        for some in together.values()
    )
