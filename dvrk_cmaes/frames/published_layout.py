"""The layout in which real dVRK frames were published: a folder a frame, with readings as NumPy files.

frameNNNN.png the image, 0NNNN.jpg the mask (a soft JPEG), joint_NNNN.npy (yaw, pitch, insertion, roll, wrist pitch,
wrist yaw; rad and m) and jaw_NNNN.npy. There is no camera file: it has to be named.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

from dvrk_cmaes.errors import InputError
from dvrk_cmaes.frames.frame import FrameFiles
from dvrk_cmaes.joints.reading import frame_readings, read_joint_file

_IMAGE = re.compile(r"frame(\d+)\.(png|jpe?g)", re.IGNORECASE)
_MASK = re.compile(r"(\d+)\.(png|jpe?g)", re.IGNORECASE)


def is_published_layout(root: Path) -> bool:
    """Whether a folder is a frame of this layout, or holds folders that are."""
    return next(_images(root), None) is not None


def find_published_frames(root: Path) -> tuple[FrameFiles, ...]:
    """Frames of a folder of this layout, in the order of their names.

    A frame is called as its image is numbered, with its folder's name before it where two folders have one number.
    Unusable readings are the frame's ``problem``.
    """
    images = list(_images(root))
    numbers = [number for number, _ in images]
    frames = []
    for number, image in images:
        name = number if numbers.count(number) == 1 else f"{image.parent.name}_{number}"
        frames.append(_frame(name, number, image))
    return tuple(sorted(frames, key=lambda frame: frame.name))


def _images(root: Path) -> Iterator[tuple[str, Path]]:
    """Find number and path of all images of a folder and of the folders in it."""
    for folder in (root, *sorted(path for path in root.iterdir() if path.is_dir())):
        try:
            paths = sorted(folder.iterdir())
        except OSError:
            continue
        for path in paths:
            match = _IMAGE.fullmatch(path.name)
            if match is not None:
                yield match[1], path


def _frame(name: str, number: str, image: Path) -> FrameFiles:
    """Find what belongs to an image, by its number."""
    masks = [path for path in sorted(image.parent.iterdir()) if _MASK.fullmatch(path.name)]
    own = [path for path in masks if int(path.stem) == int(number)]
    problem, readings = None, {}
    try:
        if len(own) > 1:
            raise InputError(f"{own[1]}: expected one mask for frame {name}, got {own[0].name} too")
        paths = [image.with_name(f"{kind}_{number}.npy") for kind in ("joint", "jaw")]
        files = [read_joint_file(path) for path in paths if path.exists()]
        readings = frame_readings(files, name, single=True).readings
    except InputError as error:
        problem = str(error)
    return FrameFiles(name, own[0] if own else None, readings, image, problem=problem)
