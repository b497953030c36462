"""Reading of one session's poses for the measures of agreement.

A set is a folder of results (of any program, with ``camera_from_root`` and ``joints``), or a published.csv: the paper's
poses as a table of axis-angle vectors and translations.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from dvrk_cmaes.errors import InputError
from dvrk_cmaes.frames.paired_names import named_as
from dvrk_cmaes.frames.session_folder import read_session
from dvrk_cmaes.frames.truth import read_published_poses
from dvrk_cmaes.geometry import Float64
from dvrk_cmaes.instrument.arm import Arm, stated_kinematics
from dvrk_cmaes.joints.reading import read_joint_table
from dvrk_cmaes.results.folder import ALONE, read_results

Readings = Mapping[str, Mapping[str, float]]

ONE_BY_ONE = "one by one"
TOGETHER = "together"


@dataclass(frozen=True, eq=False)
class ResultSet:
    """Frames of one session that have a pose.

    name : path of the folder or file.
    frames : names of the N frames. camera_from_root : (N, 4, 4).
    solved : ``one by one``, ``together``, or "k of N together".
    readings : by frame and joint, rad and m, as far as known.
    failed : names of further frames, without a pose. doubtful : names of the frames whose status is doubtful.
    arm, roll_offset : the arm, and the DH parameter d of the tool's roll joint, m; None if the results state none.
    alone : folder of the same frames solved one by one, if frames were solved together and that folder exists.
    """

    name: str
    frames: tuple[str, ...]
    camera_from_root: Float64
    solved: str = ONE_BY_ONE
    readings: Readings = field(default_factory=dict)
    failed: tuple[str, ...] = ()
    doubtful: tuple[str, ...] = ()
    arm: Arm | None = None
    roll_offset: float | None = None
    alone: str | None = None

    @property
    def by_construction(self) -> bool:
        """Whether frames were solved together, in which case their agreement does not measure their accuracy."""
        return self.solved != ONE_BY_ONE

    def outer(self, *joints: str) -> Float64 | None:
        """Return the readings (N, K) of K outer joints, or None unless all of them are known in every frame."""
        rows = [self.readings.get(frame, {}) for frame in self.frames]
        if any(joint not in row for row in rows for joint in joints):
            return None
        return np.array([[row[joint] for joint in joints] for row in rows], dtype=np.float64)


def read_result_set(path: Path, readings_from: Path | None = None) -> ResultSet:
    """Read a set of results.

    Parameters
    ----------
    path
        A folder of results, or a published.csv.
    readings_from
        A session folder or a joints.csv whose readings are used. By default the readings are those in the results, or
        for a published.csv those of a joints.csv in its folder.

    Raises
    ------
    InputError
        A file that is missing or cannot be read (the message names it); no frame with a pose.
    """
    given = None if readings_from is None else read_readings(readings_from)
    if path.suffix.lower() == ".csv":
        table = read_published_poses(path)
        own = path.with_name("joints.csv")
        if given is None and own.exists():
            given = read_joint_table(own)
        poses = np.stack([camera_from_root for camera_from_root, _ in table.values()])
        return ResultSet(str(path), tuple(table), poses, readings=given or {})
    results = read_results(path).frames
    posed = {name: result.camera_from_root for name, result in results.items() if result.camera_from_root is not None}
    if not posed:
        raise InputError(f"{path}: camera_from_root: expected a pose in at least one frame, got none")
    arm, roll_offset = stated_kinematics(results[name].config for name in posed) or (None, None)
    together = sum(results[name].source == "session" for name in posed)
    solved = f"{together} of {len(posed)} {TOGETHER}"
    if together in (0, len(posed)):
        solved = TOGETHER if together else ONE_BY_ONE
    by_frame = {name: result.readings for name, result in results.items()}
    readings = by_frame if given is None else named_as(results, given)
    failed = tuple(name for name in results if name not in posed)
    doubtful = tuple(name for name in posed if results[name].status == "doubtful")
    alone = str(path / ALONE) if together and (path / ALONE / "frames").is_dir() else None
    frames, poses = tuple(posed), np.stack(list(posed.values()))
    return ResultSet(str(path), frames, poses, solved, readings, failed, doubtful, arm, roll_offset, alone)


def read_readings(path: Path) -> Readings:
    """Read the joint readings of a session folder or a joints.csv, by frame; errors as in their readers."""
    if path.is_dir() and not (path / "joints.csv").exists():
        return {frame.name: frame.readings for frame in read_session(path).frames}
    return read_joint_table(path / "joints.csv" if path.is_dir() else path)
