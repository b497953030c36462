"""Joint readings as NumPy files of one array: six values of the arm, one of the jaw, or all seven."""

from __future__ import annotations

import io
import math
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.errors import InputError
from dvrk_cmaes.joints.names import ordered_joints
from dvrk_cmaes.joints.rows import JointFile, JointRow

EXPECTED = "joint readings (a NumPy array of 6, 1 or 7 numbers)"
MAGIC = b"\x93NUMPY"

_MOST = 7


def read_joint_npy(path: str, data: bytes) -> JointFile:
    """Read the bytes of a .npy of joint readings.

    Raises
    ------
    InputError
        Naming the file, and what was expected.
    """
    if Path(path).stem.endswith("_ctr"):
        raise InputError(f"{path}: expected {EXPECTED}, got by its name a pose (axis-angle and translation)")
    values = read_small_array(path, data, expected=EXPECTED)
    joints = ordered_joints(path, values.size)
    cells = dict(zip(joints, values.tolist(), strict=True))
    return JointFile(path, f"NumPy array of {values.size}", {Path(path).stem: JointRow(path, cells)}, "message")


def read_small_array(path: str, data: bytes, *, expected: str) -> NDArray[np.float64]:
    """Read the bytes of a .npy of a few numbers, (N,); pickled objects are refused, and larger arrays before they grow.

    Raises
    ------
    InputError
        Naming the file, and what was expected.
    """
    stream = io.BytesIO(data)
    try:
        version = np.lib.format.read_magic(stream)
        read_header = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
        shape, _, dtype = read_header(stream)
    except Exception as error:  # the header is Python: NumPy parses it, and errors of every kind come through
        raise InputError(f"{path}: expected {expected}, got no valid NumPy file ({_line(error)})") from None
    if dtype.kind not in "fiu" or not 0 < math.prod(shape) <= _MOST:
        raise InputError(f"{path}: expected {expected}, got {dtype} of shape {shape}")
    stream.seek(0)
    try:
        values = np.load(stream, allow_pickle=False)
    except Exception as error:  # as above
        raise InputError(f"{path}: expected {expected}, got no valid NumPy file ({_line(error)})") from None
    return np.asarray(values, np.float64).ravel()


def _line(error: BaseException) -> str:
    return " ".join(str(error).split())[:120]
