"""Time-stamped joint readings from a file given in addition to a recording."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from dvrk_cmaes.errors import InputError
from dvrk_cmaes.joints.interpolation import TimedReadings
from dvrk_cmaes.joints.reading import JointFile, ReadAs, read_joint_file
from dvrk_cmaes.recording.pose_table import PoseTable


def read_timed_joints(path: Path | PoseTable | JointFile, arm: str | None = None) -> tuple[TimedReadings, ...]:
    """Read a file of readings whose rows have times; joints with the same times are in one time series.

    Of a table of poses, the joints are found by inverse kinematics. ``arm`` is the one of a file with those of several.

    Raises
    ------
    InputError
        The file is not one of readings, or its rows have no times.
    """
    if isinstance(path, PoseTable):
        return path.read()
    file = path if isinstance(path, JointFile) else read_joint_file(path, read_as=ReadAs(arm))
    groups: dict[bytes, list[TimedReadings]] = {}
    for series in file.timed:
        groups.setdefault(series.times.tobytes(), []).append(series)
    if not groups:
        raise InputError(
            f"{file.path}: expected joint readings with times (a column time, in seconds), got {file.kind}"
        )
    return tuple(
        TimedReadings(
            tuple(name for series in group for name in series.joints),
            group[0].times,
            np.hstack([series.values for series in group]),
            file.path,
        )
        for group in groups.values()
    )
