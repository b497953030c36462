"""Masks that are given with a recording: a folder of them, a video, or a COCO file, by the names of its frames."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Final

import numpy as np

from dvrk_cmaes.errors import InputError
from dvrk_cmaes.frames.coco_mask import FILES, frames_of
from dvrk_cmaes.frames.images import THRESHOLD
from dvrk_cmaes.frames.session_folder import image_files, with_names_of
from dvrk_cmaes.frames.video_frames import open_capture
from dvrk_cmaes.io.output import write_bytes
from dvrk_cmaes.io.short_text import listed, natural
from dvrk_cmaes.recording.messages import encode_png

_EXPECTED: Final = "a folder of masks, a video of masks, or a COCO file (JSON)"


def write_masks(given: Path, folder: Path, names: Sequence[str], numbers: Sequence[int]) -> str:
    """Write the masks of a session's frames, and say how many have one.

    Parameters
    ----------
    given
        A folder of masks named as the frames or by their numbers; a video whose N-th picture is the mask of the N-th
        image of the recording; or a COCO file of such names.
    folder
        The session folder.
    names, numbers
        Of its frames, and of their images in the recording, from zero.

    Raises
    ------
    InputError
        There is no such file, or no frame has a mask.
    """
    if given.is_dir():
        masks = image_files(given)
        met = {name: path for name, path in with_names_of(given, masks, {}, {*names}).items() if name in {*names}}
        for name, path in met.items():
            write_bytes(folder / "masks" / f"{name}{path.suffix.lower()}", path.read_bytes())
        found, there = len(met), [*masks]
    elif given.suffix.lower() == ".json":
        there = [*frames_of(given)]
        found = len({*names} & {*with_names_of(given, dict.fromkeys(there, given), {}, {*names})}) if there else 0
        write_bytes(folder / FILES[0], given.read_bytes())
    else:
        wanted, there = dict(zip(numbers, names, strict=True)), list[str]()
        with open_capture(given, expected=_EXPECTED) as capture:
            while capture.grab():
                if len(there) in wanted:
                    grey = np.asarray(capture.retrieve()[1]).max(axis=2)
                    mask = encode_png(np.where(grey > THRESHOLD, np.uint8(255), np.uint8(0)))
                    write_bytes(folder / "masks" / f"{wanted[len(there)]}.png", mask)
                there.append(f"{len(there)}")
        found = sum(number < len(there) for number in wanted)
    if not found:
        of_frames = listed(sorted(names, key=natural), 2)
        raise InputError(f"{given}: expected masks of the frames {of_frames}, got {listed(there, 2) or 'none'}")
    return f"masks: {found} of {len(names)} frames, of {given}"
