"""Reader of joint readings as NumPy files: one array of the arm's six values, the jaw's one, or all seven."""

from __future__ import annotations

import io
import math
from pathlib import Path

import numpy as np

from dvrk_cmaes.errors import InputError, one_line
from dvrk_cmaes.geometry import Float64
from dvrk_cmaes.joints.names import joints_by_count
from dvrk_cmaes.joints.rows import JointFile, JointRow

EXPECTED = "joint readings (a NumPy array of 6, 1 or 7 numbers)"
MAGIC = b"\x93NUMPY"

_MOST = 7


def read_joint_npy(path: str, data: bytes) -> JointFile:
    """Read joint readings from the bytes of a .npy file; ``path`` is for messages and names the row.

    Raises
    ------
    InputError
        The array is not one of readings; the message names the file and what was expected.
    """
    if Path(path).stem.endswith("_ctr"):
        raise InputError(f"{path}: expected {EXPECTED}, got by its name a pose (axis-angle and translation)")
    values = read_small_array(path, data, expected=EXPECTED)
    joints = joints_by_count(path, values.size)
    cells = dict(zip(joints, values.tolist(), strict=True))
    return JointFile(path, f"NumPy array of {values.size}", {Path(path).stem: JointRow(path, cells)}, "message")


def read_small_array(path: str, data: bytes, *, expected: str) -> Float64:
    """Read an array of 1 to 7 numbers, flattened to (N,), from the bytes of a .npy file.

    The shape is checked before the array is read, and pickled objects are refused.

    Raises
    ------
    InputError
        The file is not such an array; the message names the file and begins with what was ``expected``.
    """
    stream = io.BytesIO(data)
    try:
        version = np.lib.format.read_magic(stream)
        read_header = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
        shape, _, dtype = read_header(stream)
        small = dtype.kind in "fiu" and 0 < math.prod(shape) <= _MOST
        stream.seek(0)
        values = np.load(stream, allow_pickle=False) if small else None
    except Exception as error:  # NumPy parses the header as a Python literal, with errors of many types
        raise InputError(f"{path}: expected {expected}, got no valid NumPy file ({one_line(error)})") from None
    if values is None:
        raise InputError(f"{path}: expected {expected}, got {dtype} of shape {shape}")
    return np.asarray(values, np.float64).ravel()
