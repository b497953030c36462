"""Paths of the output of a frame: ``OUT/frames/<frame>.json`` and ``OUT/overlays/<frame>.jpg``.

A mask segmented from the image is written to ``OUT/masks/<frame>.png``; the overlay of the pose that the other frames
of a calibrated session predict, to ``OUT/overlays_left_out/<frame>.jpg``.
"""

from __future__ import annotations

import os
from pathlib import Path

from dvrk_cmaes.errors import InputError
from dvrk_cmaes.io.short_text import shown


def result_path(out: Path, frame: str) -> Path:
    """Return the path of a frame's result."""
    return out / "frames" / f"{frame}.json"


def overlay_path(out: Path, frame: str) -> Path:
    """Return the path of a frame's overlay."""
    return out / "overlays" / f"{frame}.jpg"


def left_out_path(out: Path, frame: str) -> Path:
    """Return the path of the overlay of the pose that the session's other frames predict."""
    return out / "overlays_left_out" / f"{frame}.jpg"


def mask_path(out: Path, frame: str, view: str = "") -> Path:
    """Return the path of the mask that was found in the image of a frame, or in that of one of its views."""
    return out / "masks" / view / f"{frame}.png"


def check_frame_name(frame: str) -> None:
    """Raise an InputError for the name of a frame that is not valid as the name of a file."""
    if not frame or "/" in frame or os.sep in frame or frame.startswith(".") or not frame.isprintable():
        raise InputError(f"frame: expected a name that can be a file's (no slash, no leading dot), got {shown(frame)}")


def found_masks(out: Path, frame: str) -> list[Path]:
    """Return the paths of the masks in a folder that were found in the images of a frame, of all its views."""
    masks = mask_path(out, frame).parent
    views = sorted(path for path in masks.iterdir() if path.is_dir()) if masks.is_dir() else []
    return [path for folder in (masks, *views) if (path := folder / f"{frame}.png").exists()]


def check_output(out: Path, frame: str) -> None:
    """Check that the files of a frame can be written, before they are computed.

    Raises
    ------
    InputError
        The name is not valid for a file, a file has the path of the folder, or the folder is not writable.
    """
    check_frame_name(frame)
    for folder in (result_path(out, frame).parent, overlay_path(out, frame).parent):
        check_writable(folder, named=out)


def check_writable(folder: Path, *, named: Path | None = None) -> None:
    """Raise an InputError for a folder that cannot be created or written to; ``named`` is its path in messages."""
    name = folder if named is None else named
    there = next(path for path in (folder, *folder.absolute().parents) if os.path.exists(path))
    if not there.is_dir():
        raise InputError(f"{name}: expected a folder to write to, but {there} is a file")
    if not os.access(there, os.W_OK | os.X_OK):
        raise InputError(f"{name}: expected a folder to write to, but {there} may not be written to")
