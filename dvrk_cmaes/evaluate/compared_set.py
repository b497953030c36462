"""Reading of the sets of poses that ``compare`` takes: results, followed recordings, published poses, and the truth."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from dvrk_cmaes.errors import InputError
from dvrk_cmaes.frames.paired_names import named_as
from dvrk_cmaes.frames.truth import read_golden, read_published_poses
from dvrk_cmaes.geometry import Float64
from dvrk_cmaes.io.short_text import no_folder
from dvrk_cmaes.results.folder import read_results
from dvrk_cmaes.results.followed import result_of_row
from dvrk_cmaes.results.result import Result
from dvrk_cmaes.results.tracked import TRACKS, read_tracks

Kind = Literal["results", "followed recording", "published poses", "truth"]

GOLDEN = "golden.json"


@dataclass(frozen=True, eq=False)
class ComparedFrame:
    """What is compared of a frame.

    camera_from_root : (4, 4), m; None without a pose. joints : by name, rad.
    tips : (K, 3), m in the camera; None if they are not stated.
    status : as stated; empty for poses that have none. iou, tip_90_mm, seconds : as in `Result`, None if not stated.
    tip_std_mm : stated standard deviation of the tips together, the norm over three axes, mm.
    """

    camera_from_root: Float64 | None
    joints: Mapping[str, float]
    tips: Float64 | None = None
    status: str = ""
    iou: float | None = None
    tip_90_mm: float | None = None
    seconds: float | None = None
    tip_std_mm: float | None = None


@dataclass(frozen=True, eq=False)
class ComparedSet:
    """A set of frames by name, read from ``path``, where frames that are named as others have ``own_names``."""

    path: Path
    kind: Kind
    frames: Mapping[str, ComparedFrame]
    own_names: Mapping[str, str] = field(default_factory=dict)

    def as_of(self, frames: Iterable[str]) -> ComparedSet:
        """Return the set with the names of other frames, those of equal numbers, as in a session."""
        own = named_as(frames, {name: name for name in self.frames})
        changed = {name: before for name, before in own.items() if name != before}
        return replace(self, frames={name: self.frames[before] for name, before in own.items()}, own_names=changed)


def read_compared_set(path: Path) -> ComparedSet:
    """Read a folder of results or of a followed recording, a published.csv, a golden.json or a session that has one.

    Raises
    ------
    InputError
        A file that is missing or cannot be read; the message names it.
    """
    if path.suffix.lower() == ".csv":
        poses = read_published_poses(path).items()
        return ComparedSet(path, "published poses", {name: ComparedFrame(*pose) for name, pose in poses})
    if path.suffix.lower() == ".json":
        return _truth(path)
    if not path.is_dir():
        raise InputError(f"{path}: {no_folder(path)}; expected results, a golden.json, or a published.csv")
    if (path / TRACKS).is_file():
        rows = read_tracks(path / TRACKS)
        frames = {str(row["frame"]): _followed(f"{path / TRACKS}: frame {row['frame']}", row) for row in rows}
        return ComparedSet(path, "followed recording", frames)
    if os.path.lexists(path / GOLDEN) and not (path / "frames").is_dir():
        return _truth(path / GOLDEN)
    return ComparedSet(
        path, "results", {name: _of_result(result) for name, result in read_results(path).frames.items()}
    )


def _truth(path: Path) -> ComparedSet:
    frames = read_golden(path).frames
    if not frames:
        raise InputError(f"{path}: frames: expected the pose of at least one frame, got none")
    return ComparedSet(
        path,
        "truth",
        {name: ComparedFrame(truth.camera_from_root, truth.joints, truth.tips) for name, truth in frames.items()},
    )


def _followed(where: str, row: Mapping[str, Any]) -> ComparedFrame:
    """Return what a line of tracks.jsonl states."""
    std = row["std"] or {}
    return replace(_of_result(result_of_row(where, row)), status=str(row["status"]), tip_std_mm=std.get("tip_mm"))


def _of_result(result: Result) -> ComparedFrame:
    return ComparedFrame(
        result.camera_from_root,
        result.joints,
        np.stack(result.tips) if result.tips else None,
        result.status,
        None if result.quality is None else result.quality.iou,
        None if result.expected_error is None else result.expected_error.tip_90_mm,
        result.seconds or None,
        None if result.expected_error is None else result.expected_error.of_tips_mm,
    )
