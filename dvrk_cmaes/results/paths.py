"""Where the results of a frame go: ``OUT/frames/<frame>.json`` and ``OUT/overlays/<frame>.jpg``.

A mask that was found in an image goes to ``OUT/masks/<frame>.png``; what the other frames of a calibrated session
predict for a frame, to ``OUT/overlays_left_out/<frame>.jpg``.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.errors import InputError
from dvrk_cmaes.io.atomic import write_bytes, write_image, write_json
from dvrk_cmaes.io.short_text import shown
from dvrk_cmaes.results.result import Result


def result_path(out: Path, frame: str) -> Path:
    """Path of a frame's result."""
    return out / "frames" / f"{frame}.json"


def overlay_path(out: Path, frame: str) -> Path:
    """Path of a frame's overlay."""
    return out / "overlays" / f"{frame}.jpg"


def left_out_path(out: Path, frame: str) -> Path:
    """Path of the picture of what a session's other frames predict for a frame."""
    return out / "overlays_left_out" / f"{frame}.jpg"


def mask_path(out: Path, frame: str) -> Path:
    """Path of the mask of a frame that had none, found in its image."""
    return out / "masks" / f"{frame}.png"


@dataclass(frozen=True)
class FramePictures:
    """Pictures of a session's frame, each the bytes of a JPEG: a thousand frames have room in memory.

    ``overlay`` is that of the frame's result; ``left_out`` shows what the other frames predict.
    """

    overlay: bytes
    left_out: bytes

    def write(self, out: Path, frame: str) -> None:
        """Write both, as ``dvrk_cmaes.io.atomic.write_bytes``."""
        write_bytes(overlay_path(out, frame), self.overlay)
        write_bytes(left_out_path(out, frame), self.left_out)


def check_frame_name(frame: str) -> None:
    """Refuse, by `InputError`, a frame's name that files and folders cannot have."""
    if not frame or "/" in frame or os.sep in frame or frame.startswith(".") or not frame.isprintable():
        raise InputError(f"frame: expected a name that can be a file's (no slash, no leading dot), got {shown(frame)}")


def check_output(out: Path, frame: str) -> None:
    """Refuse, before any work is done, a frame's name or a folder that its files cannot be written to.

    Raises
    ------
    InputError
        A name that is not one of a file, a file where the folder should be, or a folder that may not be written to.
    """
    check_frame_name(frame)
    for folder in (result_path(out, frame).parent, overlay_path(out, frame).parent):
        check_writable(folder, named=out)


def check_writable(folder: Path, *, named: Path | None = None) -> None:
    """Refuse, by `InputError`, a folder that cannot be written to or made; ``named`` is how the message calls it."""
    name = folder if named is None else named
    there = next(path for path in (folder, *folder.absolute().parents) if os.path.exists(path))
    if not there.is_dir():
        raise InputError(f"{name}: expected a folder to write to, but {there} is a file")
    if not os.access(there, os.W_OK | os.X_OK):
        raise InputError(f"{name}: expected a folder to write to, but {there} may not be written to")


def write_frame(
    out: Path, result: Result, overlay: NDArray[np.uint8], found_mask: NDArray[np.bool_] | None = None
) -> tuple[Path, ...]:
    """Write a result and its overlay (H, W, 3) BGR, each whole or not at all; the result last, so it says all is there.

    ``found_mask`` (H, W) is that of a frame that had none. Returns their paths, the result's first. Raises as
    ``dvrk_cmaes.io.atomic.write_bytes``.
    """
    paths = [result_path(out, result.frame), overlay_path(out, result.frame)]
    if found_mask is not None:
        paths.append(mask_path(out, result.frame))
        write_image(paths[2], found_mask)
    write_image(paths[1], overlay)
    write_json(paths[0], result.to_dict())
    return tuple(paths)
