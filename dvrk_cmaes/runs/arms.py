"""What a session's arms have in common: one overlay a frame with all tools, and a page that leads to each arm's."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.camera import Camera
from dvrk_cmaes.draw.arms_overlay import ArmDrawing, draw_arms, drawings
from dvrk_cmaes.errors import InputError
from dvrk_cmaes.frames.frame import FrameFiles
from dvrk_cmaes.frames.images import match_size, read_image, read_mask
from dvrk_cmaes.frames.session_folder import Session
from dvrk_cmaes.io.atomic import encoded_image, write_bytes
from dvrk_cmaes.report.arms_page import write_arms_page
from dvrk_cmaes.results.folder import ResultsFolder
from dvrk_cmaes.results.paths import overlay_path, result_path
from dvrk_cmaes.silhouette import Body


def write_arms(
    out: Path, folders: Mapping[str, ResultsFolder], bodies: Mapping[str, Body], sessions: Mapping[str, Session]
) -> Path:
    """Write OUT/overlays/FRAME.jpg with the tools of all arms, and OUT/report.html; returns the path of the page.

    ``folders`` are the results of each arm in OUT/ARM, ``bodies`` their instruments, ``sessions`` the sessions as the
    arms see them. Overlays that are newer than the results are kept. Errors as in `dvrk_cmaes.io.atomic.write_bytes`.
    """
    results = {arm: folder.frames for arm, folder in folders.items()}
    frames = {arm: {files.name: files for files in session.frames} for arm, session in sessions.items()}
    cameras = {arm: session.camera for arm, session in sessions.items()}
    for name in sorted({name for of_arm in results.values() for name in of_arm}):
        overlay = overlay_path(out, name)
        if not _is_newer(overlay, [result_path(folder.folder, name) for folder in folders.values()]):
            drawn = _drawn(drawings(results, bodies, name), name, frames, cameras)
            if drawn is not None:
                write_bytes(overlay, encoded_image(overlay, drawn))
    return write_arms_page(out, folders)


def _is_newer(path: Path, others: list[Path]) -> bool:
    """Whether a file exists and was written after all others that exist."""
    if not path.exists():
        return False
    written = path.stat().st_mtime_ns
    return all(not other.exists() or other.stat().st_mtime_ns <= written for other in others)


def _drawn(
    shown: Sequence[ArmDrawing],
    name: str,
    frames: Mapping[str, Mapping[str, FrameFiles]],
    cameras: Mapping[str, Camera],
) -> NDArray[np.uint8] | None:
    """Draw the tools of all arms in a frame; None if neither its image nor a mask can be read.

    ``frames`` are the files by arm and frame, ``cameras`` the cameras by arm.
    """
    seen = [one.arm for one in shown if name in frames[one.arm]]
    files = [frames[arm][name] for arm in seen]
    image, mask = _image(files[0]) if files else None, _all_masks(files)
    if mask is None and image is not None:
        mask = np.zeros(image.shape[:2], np.bool_)
    if mask is None:
        return None
    try:
        camera, _ = match_size(cameras[seen[0]], mask.shape, "mask")
    except InputError:
        return None
    return draw_arms(shown, mask, camera, image)


def _image(files: FrameFiles) -> NDArray[np.uint8] | None:
    """Read the image of a frame; None if it has none that can be read."""
    try:
        return None if files.image is None else read_image(files.image)
    except InputError:
        return None


def _all_masks(frames: list[FrameFiles]) -> NDArray[np.bool_] | None:
    """Return the union of the arms' masks of a frame; None if none can be read."""
    union: NDArray[np.bool_] | None = None
    for files in frames:
        try:
            if files.mask is None:
                continue
            mask = read_mask(files.mask, label=files.label, pick=files.pick, blank=True)
        except InputError:
            continue
        union = mask if union is None or union.shape != mask.shape else union | mask
    return union
