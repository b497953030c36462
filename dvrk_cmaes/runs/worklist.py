"""Which frames of a session are to be done: those a pattern names, and of these a shard's part."""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from pathlib import Path

from dvrk_cmaes.errors import InputError, nearest_first
from dvrk_cmaes.frames.frame import FrameFiles
from dvrk_cmaes.io.short_text import listed, shown
from dvrk_cmaes.results.paths import check_output, result_path

_LONGEST_NAME = 255  # bytes, on nearly all file systems


@dataclass(frozen=True)
class Shard:
    """Part ``index`` (from 1) of ``count`` parts of a session, each for a machine of its own."""

    index: int
    count: int

    @staticmethod
    def parse(text: str) -> Shard:
        """Read ``2/8``; InputError for anything else."""
        match = re.fullmatch(r"(\d{1,6})/(\d{1,6})", text)
        if match is None or not 1 <= int(match[1]) <= int(match[2]):
            raise InputError(f"--shard: expected I/N with I from 1 to N, e.g. 2/8, got {shown(text)}")
        return Shard(int(match[1]), int(match[2]))

    def folder(self, out: Path) -> Path:
        """Where the shard's results lie until they are merged."""
        return shards_folder(out) / f"{self.index}-of-{self.count}"

    def part(self, frames: Sequence[FrameFiles]) -> tuple[FrameFiles, ...]:
        """Every ``count``-th frame, beginning with the ``index``-th, so that slow stretches are shared out."""
        return tuple(frames[self.index - 1 :: self.count])


def shards_folder(out: Path) -> Path:
    """Folder of the shards that are not merged yet."""
    return out / "shards"


def shard_of(folder: Path) -> Shard | None:
    """Shard that a folder is named after."""
    match = re.fullmatch(r"(\d+)-of-(\d+)", folder.name)
    return None if match is None else Shard(int(match[1]), int(match[2]))


def chosen_frames(frames: Sequence[FrameFiles], pattern: str | None) -> tuple[FrameFiles, ...]:
    """Choose the frames whose names match a shell's pattern (``*``, ``?``, ``[..]``), or all; sorted by name.

    Raises
    ------
    InputError
        No frame matches.
    """
    chosen = tuple(sorted((f for f in frames if pattern is None or fnmatchcase(f.name, pattern)), key=lambda f: f.name))
    if not chosen:
        near = listed(nearest_first(str(pattern), [frame.name for frame in frames[:1000]]))
        raise InputError(f"--frames: expected a pattern of some of the {len(frames)} frames ({near}), got {pattern!r}")
    return chosen


def check_names(out: Path, frames: Sequence[FrameFiles]) -> None:
    """Refuse, before any work is done, names and folders that results cannot be written to.

    Raises
    ------
    InputError
        As ``check_output``; a name that is too long for a file with its extension.
    """
    for frame in frames:
        check_output(out, frame.name)
        name = result_path(out, frame.name).name
        if len(os.fsencode(name)) > _LONGEST_NAME:
            raise InputError(
                f"frame: expected a name of at most {_LONGEST_NAME} bytes with .json, got {shown(frame.name)}"
            )
