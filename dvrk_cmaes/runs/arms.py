"""What a session's arms have in common: one overlay a frame with all tools."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.camera import Camera
from dvrk_cmaes.draw.arms_overlay import ArmDrawing, draw_arms, drawings
from dvrk_cmaes.errors import InputError
from dvrk_cmaes.frames.frame import FrameFiles, image_of, mask_of, readable
from dvrk_cmaes.frames.images import match_size
from dvrk_cmaes.geometry import Bool
from dvrk_cmaes.io.atomic import encoded_image
from dvrk_cmaes.io.output import write_bytes
from dvrk_cmaes.io.short_text import natural
from dvrk_cmaes.results.folder import read_results
from dvrk_cmaes.results.paths import overlay_path, result_path
from dvrk_cmaes.runs.agreement import ArmInSession


def write_arms(out: Path, arms: Mapping[str, ArmInSession]) -> None:
    """Write OUT/overlays/FRAME.jpg with the tools of all arms.

    The results of each arm are in OUT/ARM. Overlays that are newer than the results are kept. Errors as in
    `read_results` and `dvrk_cmaes.io.output.write_bytes`.
    """
    folders = {name: read_results(out / name) for name in arms}
    results = {name: folder.frames for name, folder in folders.items()}
    bodies = {name: arm.body for name, arm in arms.items()}
    frames = {name: {files.name: files for files in arm.session.frames} for name, arm in arms.items()}
    for frame in sorted({frame for of_arm in results.values() for frame in of_arm}, key=natural):
        overlay = overlay_path(out, frame)
        if not _is_newer(overlay, [result_path(folder.folder, frame) for folder in folders.values()]):
            shown = drawings(results, bodies, frame)
            seen = [
                (frames[tool.arm][frame], arms[tool.arm].session.camera) for tool in shown if frame in frames[tool.arm]
            ]
            drawn = _drawn(shown, seen)
            if drawn is not None:
                write_bytes(overlay, encoded_image(overlay, drawn))


def _is_newer(path: Path, others: list[Path]) -> bool:
    """Whether a file exists and was written after all others that exist."""
    if not path.exists():
        return False
    written = path.stat().st_mtime_ns
    return all(not other.exists() or other.stat().st_mtime_ns <= written for other in others)


def _drawn(shown: Sequence[ArmDrawing], seen: Sequence[tuple[FrameFiles, Camera]]) -> NDArray[np.uint8] | None:
    """Draw the tools of all arms in a frame; None if neither its image nor a mask can be read.

    ``seen`` are the frame's files and the camera of each arm that has the frame.
    """
    files = [own for own, _ in seen]
    image, mask = readable(partial(image_of, files[0])) if files else None, _all_masks(files)
    if mask is None and image is not None:
        mask = np.zeros(image.shape[:2], np.bool_)
    if mask is None:
        return None
    try:
        camera, _ = match_size(seen[0][1], mask.shape, "mask")
    except InputError:
        return None
    return draw_arms(shown, mask, camera, image)


def _all_masks(frames: list[FrameFiles]) -> Bool | None:
    """Return the union of the arms' masks of a frame; None if none can be read."""
    union: Bool | None = None
    for files in frames:
        mask = None if files.mask is None else readable(partial(mask_of, files, files.mask, blank=True))
        if mask is not None:
            union = mask if union is None or union.shape != mask.shape else union | mask
    return union
