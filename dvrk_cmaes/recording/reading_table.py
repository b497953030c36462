"""Time-stamped joint readings from a file given in addition to a recording."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from dvrk_cmaes.errors import InputError
from dvrk_cmaes.joints.interpolation import TimedReadings
from dvrk_cmaes.joints.reading import read_joint_file


def read_timed_joints(path: Path) -> tuple[TimedReadings, ...]:
    """Read a file of readings whose rows have times; joints with the same times are in series time series.

    Raises
    ------
    InputError
        The file is not one of readings, or its rows have no times.
    """
    file = read_joint_file(path)
    groups: dict[bytes, list[TimedReadings]] = {}
    for series in file.timed:
        groups.setdefault(series.times.tobytes(), []).append(series)
    if not groups:
        raise InputError(f"{path}: expected joint readings with times (a column time, in seconds), got {file.kind}")
    return tuple(
        TimedReadings(
            tuple(name for series in group for name in series.joints),
            group[0].times,
            np.hstack([series.values for series in group]),
            str(path),
        )
        for group in groups.values()
    )
