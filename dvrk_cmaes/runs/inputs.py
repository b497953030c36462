"""Sizes and times of the files of frames, and digests of settings, by which changed inputs are detected."""

from __future__ import annotations

import dataclasses
import hashlib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from dvrk_cmaes.frames.frame import FrameFiles
from dvrk_cmaes.instrument import Instrument

_FILES = ("mask", "image", "ignore")
_LENGTH = 16
"""Hexadecimal digits of a digest; among a million digests, two are equal by chance with a probability of 3e-8."""

UNREADABLE = "unreadable"
"""Stands for the size and time of a file that cannot be read."""


def instrument_digest(instrument: Instrument) -> str:
    """Compute the digest of an instrument's content; the paths of its files do not matter."""
    return digest_of(instrument)


def frame_stamps(files: FrameFiles) -> dict[str, str]:
    """Return sizes and times of the files of a frame, and digests of its other parts, by name of the part.

    Of a file that cannot be read it is `UNREADABLE`.
    """
    stamps = {name: _stamp(path) for name in _FILES if (path := getattr(files, name)) is not None}
    others_there = {
        f"other tool {k}": f"{_stamp(tool.mask)} {tool.label or ''}" for k, tool in enumerate(files.other_tools)
    }
    rest: dict[str, Any] = {
        "readings": (dict(sorted(files.readings.items())), files.notes, files.problem),
        "keypoints": files.keypoints,
        "part of the mask": (files.label, files.pick),
    }
    if files.time is not None:
        rest["time"] = files.time
    if files.video is not None:
        film = files.video
        rest["video"] = (_stamp(film.video.path), film.number, film.window)
    if files.prompts is not None and files.mask is None:
        rest["prompts"] = files.prompts
    others = {
        f"{view} {part}": stamp
        for view, other in files.others.items()
        for part, stamp in frame_stamps(other).items()
        if part in _FILES
    }
    return stamps | {name: digest_of(value) for name, value in rest.items()} | others | others_there


def _stamp(path: Path) -> str:
    """Return size, bytes, and time of change, ns, of a file."""
    try:
        status = path.stat()
    except OSError:
        return UNREADABLE
    return f"{status.st_size} {status.st_mtime_ns}"


def digest_of(value: Any) -> str:
    """Compute the digest of a tree of dataclasses, mappings, sequences, arrays and plain values."""
    sha256 = hashlib.sha256()
    for part in _parts(value):
        sha256.update(len(part).to_bytes(8, "little") + part)
    return sha256.hexdigest()[:_LENGTH]


def _parts(value: Any) -> Iterator[bytes]:
    """Yield the content of such a tree as bytes: names of fields, keys, lengths and values.

    Fields whose metadata say so are no content: what follows from others, or is kept of a file.
    """
    if isinstance(value, np.ndarray):
        yield f"{value.dtype.str}{value.shape}".encode()
        yield np.ascontiguousarray(value).tobytes()
    elif dataclasses.is_dataclass(value) and not isinstance(value, type):
        for field in dataclasses.fields(value):
            if field.metadata.get("content", True):
                yield field.name.encode()
                yield from _parts(getattr(value, field.name))
    elif isinstance(value, Mapping):
        for key, part in value.items():
            yield str(key).encode()
            yield from _parts(part)
    elif isinstance(value, list | tuple):
        yield str(len(value)).encode()
        for part in value:
            yield from _parts(part)
    else:
        yield repr(value).encode()
