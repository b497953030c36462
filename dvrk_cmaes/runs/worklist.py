"""Selection of the frames of a batch: those whose names match a pattern."""

from __future__ import annotations

import os
from collections.abc import Sequence
from fnmatch import fnmatchcase
from pathlib import Path

from dvrk_cmaes.errors import InputError, nearest_first
from dvrk_cmaes.frames.frame import FrameFiles
from dvrk_cmaes.io.short_text import listed, natural, shown
from dvrk_cmaes.results.paths import check_output, result_path

_LONGEST_NAME = 255  # bytes, the limit of nearly all file systems


def chosen_frames(frames: Sequence[FrameFiles], pattern: str | None) -> tuple[FrameFiles, ...]:
    """Return the frames whose names match a shell pattern (``*``, ``?``, ``[..]``), or all frames, in order.

    The name of a frame, with brackets in it, too, is a pattern of this frame alone.

    Raises
    ------
    InputError
        No frame matches.
    """
    named = [frame for frame in frames if frame.name == pattern]
    matching = named or [frame for frame in frames if pattern is None or fnmatchcase(frame.name, pattern)]
    chosen = tuple(sorted(matching, key=lambda frame: natural(frame.name)))
    if not chosen:
        near = listed(nearest_first(str(pattern), [frame.name for frame in frames[:1000]]))
        raise InputError(f"--frames: expected a pattern of some of the {len(frames)} frames ({near}), got {pattern!r}")
    return chosen


def check_names(out: Path, frames: Sequence[FrameFiles]) -> None:
    """Check that the results of all frames can be written to a folder.

    Raises
    ------
    InputError
        As `check_output`; or a file name would be too long.
    """
    for frame in frames:
        check_output(out, frame.name)
        name = result_path(out, frame.name).name
        if len(os.fsencode(name)) > _LONGEST_NAME:
            raise InputError(
                f"frame: expected a name of at most {_LONGEST_NAME} bytes with .json, got {shown(frame.name)}"
            )
