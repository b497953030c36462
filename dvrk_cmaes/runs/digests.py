"""Short digests of the inputs of results, by which changed inputs are detected."""

from __future__ import annotations

import dataclasses
import hashlib
from collections.abc import Iterator, Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from dvrk_cmaes.frames.frame import FrameFiles
from dvrk_cmaes.frames.video_frames import Video
from dvrk_cmaes.instrument import Instrument
from dvrk_cmaes.io.files import file_digest

_FILES = ("mask", "image", "ignore")
_LENGTH = 16
"""Hexadecimal digits of a digest; among a million digests, two are equal by chance with a probability of 3e-8."""

UNREADABLE = "unreadable"
"""Stands for the digest of a file that cannot be read."""


def instrument_digest(instrument: Instrument) -> str:
    """Compute the digest of an instrument's content; the paths of its files do not matter."""
    return digest_of(instrument)


def frame_digests(files: FrameFiles) -> dict[str, str]:
    """Compute the digests of the parts of a frame, by name of the part; `UNREADABLE` for a file that cannot be read."""
    digests = {name: _file_digest(path) for name in _FILES if (path := getattr(files, name)) is not None}
    others_there = {
        f"other tool {k}": _file_digest(tool.mask) + str(tool.label or "") for k, tool in enumerate(files.other_tools)
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
        rest["video"] = (_video_digest(film.video), film.number, film.window)
    if files.prompts is not None and files.mask is None:
        rest["prompts"] = files.prompts
    others = {
        f"{view} {part}": digest
        for view, other in files.others.items()
        for part, digest in frame_digests(other).items()
        if part in _FILES
    }
    return digests | {name: digest_of(value) for name, value in rest.items()} | others | others_there


def _file_digest(path: Path) -> str:
    """Compute the digest of a file's content."""
    try:
        return file_digest(path)[:_LENGTH]
    except OSError:
        return UNREADABLE


@lru_cache(maxsize=4)
def _video_digest(video: Video) -> str:
    """Compute the digest of a video's file, once for all of its frames."""
    return _file_digest(video.path)


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
