"""Reader of the published layout's NumPy files: joint_NNNN.npy with the arm's six values, jaw_NNNN.npy with one."""

from __future__ import annotations

import io
import math
import re
from pathlib import Path

import numpy as np

from dvrk_cmaes.errors import InputError, one_line
from dvrk_cmaes.joints.names import joints_by_count
from dvrk_cmaes.joints.rows import JointFile

MAGIC = b"\x93NUMPY"

_EXPECTED = "joint readings (joint_NNNN.npy of 6 numbers or jaw_NNNN.npy of 1)"
_NAME = re.compile(r"(joint|jaw)_\d+")


def read_joint_npy(path: str, data: bytes) -> JointFile:
    """Read joint readings from the bytes of a .npy file; ``path`` is for messages and names the row.

    The shape is checked before the array is read, and pickled objects are refused.

    Raises
    ------
    InputError
        The array is not one of readings; the message names the file and what was expected.
    """
    stem = Path(path).stem
    if not _NAME.fullmatch(stem):
        raise InputError(f"{path}: expected {_EXPECTED}, got another NumPy file: write its numbers to a joints.csv")
    stream = io.BytesIO(data)
    try:
        version = np.lib.format.read_magic(stream)
        read_header = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
        shape, _, dtype = read_header(stream)
        stream.seek(0)
        small = dtype.kind in "fiu" and 0 < math.prod(shape) <= 6
        values = np.load(stream, allow_pickle=False).ravel().tolist() if small else None
    except Exception as error:  # NumPy parses the header as a Python literal, with errors of many types
        raise InputError(f"{path}: expected {_EXPECTED}, got no valid NumPy file ({one_line(error)})") from None
    if values is None:
        raise InputError(f"{path}: expected {_EXPECTED}, got {dtype} of shape {shape}")
    cells = dict(zip(joints_by_count(path, len(values)), values, strict=True))
    return JointFile.of(path, f"NumPy array of {len(values)}", {stem: (path, cells, None)}, "message")
