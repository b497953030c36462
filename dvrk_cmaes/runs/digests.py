"""Short digests of what results are made from, to notice when it is no longer the same."""

from __future__ import annotations

import dataclasses
import hashlib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from dvrk_cmaes.calibration.document import SessionCalibration
from dvrk_cmaes.frames.frame import FrameFiles
from dvrk_cmaes.instrument import Instrument
from dvrk_cmaes.io.atomic import json_text
from dvrk_cmaes.io.files import file_digest

_LENGTH = 16
"""Hexadecimal digits: among a million frames two are alike by chance once in thirty million sessions."""

UNREADABLE = "unreadable"


def instrument_digest(instrument: Instrument) -> str:
    """Digest of all that an instrument is, wherever its files lie."""
    return _digest(instrument)


def calibration_digest(calibration: SessionCalibration) -> str:
    """Digest of a session's calibration."""
    return _digest(json_text(calibration.to_dict()))


def frame_digests(files: FrameFiles) -> dict[str, str]:
    """Digests of the parts of a frame by name; a file that cannot be read has none."""
    digests = {
        name: _file_digest(path)
        for name, path in (("mask", files.mask), ("image", files.image), ("ignore", files.ignore))
        if path is not None
    }
    rest = {
        "readings": (dict(sorted(files.readings.items())), files.notes, files.problem),
        "keypoints": files.keypoints,
        "part of the mask": (files.label, files.pick),
    }
    return digests | {name: _digest(value) for name, value in rest.items()}


def _file_digest(path: Path) -> str:
    try:
        if not path.is_file():  # A pipe would never end.
            return UNREADABLE
        return file_digest(path)[:_LENGTH]
    except OSError:
        return UNREADABLE


def _digest(value: Any) -> str:
    sum_of_all = hashlib.sha256()
    for part in _parts(value):
        sum_of_all.update(len(part).to_bytes(8, "little") + part)
    return sum_of_all.hexdigest()[:_LENGTH]


def _parts(value: Any) -> Iterator[bytes]:
    """All plain values of a tree of dataclasses, mappings, sequences and arrays, as bytes."""
    if isinstance(value, np.ndarray):
        yield f"{value.dtype.str}{value.shape}".encode()
        yield np.ascontiguousarray(value).tobytes()
    elif dataclasses.is_dataclass(value) and not isinstance(value, type):
        for field in dataclasses.fields(value):
            yield field.name.encode()
            yield from _parts(getattr(value, field.name))
    elif isinstance(value, Mapping):
        for key, one in value.items():
            yield str(key).encode()
            yield from _parts(one)
    elif isinstance(value, list | tuple):
        yield str(len(value)).encode()
        for one in value:
            yield from _parts(one)
    else:
        yield repr(value).encode()
