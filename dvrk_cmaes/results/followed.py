"""Frames of a followed recording, read from tracks.jsonl, as results of single frames."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from dvrk_cmaes.results.result import POSE_AXES, Result
from dvrk_cmaes.results.tracked import TRACKS, read_tracks

_SAME = ("frame", "time", "reasons", "remarks", "camera_from_root", "joints", "tips", "seconds")


def read_followed(folder: Path) -> dict[str, Result]:
    """Read the frames of a folder written by `track`, by name, in their order; errors as in ``read_tracks``."""
    path = folder / TRACKS
    return {row["frame"]: result_of_row(f"{path}: frame {row['frame']}", row) for row in read_tracks(path)}


def result_of_row(where: str, row: Mapping[str, Any]) -> Result:
    """Return a line of tracks.jsonl as a result; a lost frame is doubtful, or failed if it has no pose.

    The covariance has the stated standard deviations, without correlations, which tracks.jsonl does not have.

    Raises
    ------
    InputError
        Beginning with ``where``: a field that is missing or wrong.
    """
    known = {name: row[name] for name in _SAME if row.get(name) is not None}
    status = "ok" if row["status"] == "ok" else "doubtful" if row["camera_from_root"] is not None else "failed"
    if (std := row["std"]) is not None:  # of independent errors
        joints = list(row["joints"])
        turned = [*std["rotation_deg"], *(std["joints_deg"][name] for name in joints)]
        matrix = np.diag(np.r_[np.array(std["translation_mm"]) / 1e3, np.radians(turned)] ** 2)
        known["covariance"] = {"axes": [*POSE_AXES, *joints], "matrix": matrix.tolist()}
    return Result.from_dict({"camera_from_root": None, "joints": {}, **known, "status": status}, where=where)
