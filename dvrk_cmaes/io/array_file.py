"""Files of arrays that are used as they are in the file, without parsing, for the cache.

A file has a mark, the length and the checksum of what follows, a JSON header, and the arrays one after another, each at
a multiple of 64 bytes. The header has a ``document`` of JSON values, and type, shape and place of each array.
"""

from __future__ import annotations

import json
import math
import os
import struct
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.io.output import write_bytes

_MARK: Final = b"DVRKARR1"
_START: Final = struct.Struct("<8sQQQ")  # mark, length and checksum of all that follows, length of the header
_ALIGNED: Final = 64  # bytes
_LARGEST: Final = 2_000_000_000  # bytes

UNUSABLE: Final = (OSError, ValueError, KeyError, TypeError, IndexError)
"""Errors of a file that is missing, damaged, or has not the arrays and values that its reader expects."""


def write_arrays(path: Path, document: Mapping[str, Any], arrays: Mapping[str, NDArray[Any]]) -> None:
    """Write JSON values and arrays of numbers; errors as `write_bytes`."""
    places, parts, at = {}, [], 0
    for name, array in arrays.items():
        data = np.ascontiguousarray(array).tobytes()
        places[name] = [array.dtype.str, array.shape, at]
        padding = -len(data) % _ALIGNED
        parts += [data, b"\0" * padding]
        at += len(data) + padding
    header = json.dumps({"document": document, "arrays": places}).encode()
    header += b" " * (-(_START.size + len(header)) % _ALIGNED)
    following = b"".join([header, *parts])
    write_bytes(path, _START.pack(_MARK, len(following), zlib.crc32(following), len(header)) + following)


def read_arrays(path: Path) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
    """Read a file that `write_arrays` wrote; returns its document and its arrays, which cannot be written to.

    The arrays lie in one block of memory. A mapping of the file would end the process where the file is cut later.

    Raises
    ------
    OSError
        There is no such file, or it cannot be read.
    ValueError
        It is damaged.
    """
    with open(path, "rb", buffering=0) as file:
        size = os.fstat(file.fileno()).st_size
        if not _START.size <= size < _LARGEST:
            raise ValueError(f"{path}: not a file of arrays")
        block = np.empty(size + _ALIGNED, np.uint8)
        begin = -block.ctypes.data % _ALIGNED
        whole = block[begin : begin + file.readinto(block[begin : begin + size].data)]
    whole.flags.writeable = False
    mark, length, checksum, header = _START.unpack_from(whole.data)
    following = whole[_START.size :].data
    if mark != _MARK or length != len(following) or zlib.crc32(following) != checksum:
        raise ValueError(f"{path}: not a whole file of arrays")
    content = json.loads(bytes(following[:header]))
    arrays = {}
    for name, (kind, shape, at) in content["arrays"].items():
        flat = np.frombuffer(whole, np.dtype(kind), math.prod(shape), _START.size + header + at)
        arrays[name] = flat.reshape(shape)
    return content["document"], arrays
