"""The folder layout of published dVRK frames: one folder per frame, with readings as NumPy files.

A folder has frameNNNN.png (the image), 0NNNN.jpg (the mask, with JPEG artefacts), joint_NNNN.npy (yaw, pitch,
insertion, roll, wrist pitch, wrist yaw; rad and m) and jaw_NNNN.npy (rad). There is no camera file; it has to be given.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

from dvrk_cmaes.errors import InputError
from dvrk_cmaes.frames.frame import FrameFiles
from dvrk_cmaes.io.files import check_own
from dvrk_cmaes.io.short_text import natural
from dvrk_cmaes.joints.reading import frame_readings, read_joint_file

_IMAGE = re.compile(r"frame(\d+)\.(png|jpe?g)", re.IGNORECASE)
_MASK = re.compile(r"(\d+)\.(png|jpe?g)", re.IGNORECASE)


def is_published_layout(root: Path) -> bool:
    """Whether a folder is a frame folder of this layout, or contains such folders."""
    return next(_images(root), None) is not None


def find_published_frames(root: Path) -> tuple[FrameFiles, ...]:
    """Find the frames of a folder of this layout, sorted by name.

    A frame's name is the number of its image, prefixed with the folder's name if two folders have the same number. An
    error in its readings is recorded as the frame's ``problem``. Links that leave the folder are refused.
    """
    images = list(_images(root))
    numbers = [number for number, _ in images]
    frames = []
    for number, image in images:
        name = number if numbers.count(number) == 1 else f"{image.parent.name}_{number}"
        masks = [path for path in sorted(image.parent.iterdir()) if _MASK.fullmatch(path.name)]
        masks = [path for path in masks if int(path.stem) == int(number)]
        paths = [image.with_name(f"{kind}_{number}.npy") for kind in ("joint", "jaw")]
        check_own(root, (image, *masks, *paths))
        problem, readings = None, {}
        try:
            if len(masks) > 1:
                raise InputError(f"{masks[1]}: expected one mask for frame {name}, got {masks[0].name} too")
            readings = frame_readings([read_joint_file(path) for path in paths if path.exists()], name, single=True)[0]
        except InputError as error:
            problem = str(error)
        frames.append(FrameFiles(name, next(iter(masks), None), readings, image, problem=problem))
    return tuple(sorted(frames, key=lambda frame: natural(frame.name)))


def _images(root: Path) -> Iterator[tuple[str, Path]]:
    """Yield the number and path of each image in a folder and in its subfolders."""
    for path in (*sorted(root.glob("*")), *sorted(root.glob("*/*"))):
        match = _IMAGE.fullmatch(path.name)
        if match is not None:
            yield match[1], path
