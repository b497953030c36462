"""Reader of a measured Cartesian pose of the dVRK (CRTK's ``measured_cp``) from a file.

The file is a message as printed by ``rostopic echo`` or ``ros2 topic echo --once``, a PoseStamped (``pose`` with
``position`` and ``orientation``) or a TransformStamped (``transform`` with ``translation`` and ``rotation``), or an
object with ``measured_cp``, 4 rows of 4 numbers, as in the dVRK's suj-fixed.json. Lengths are in m.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from msgspec import Struct

from dvrk_cmaes.errors import InputError
from dvrk_cmaes.geometry import Float64, transform
from dvrk_cmaes.io.short_text import listed, shown
from dvrk_cmaes.io.typed_document import Number, Transform, convert_document
from dvrk_cmaes.io.yaml_file import read_yaml_mapping

_EXPECTED = "a pose measured_cp (PoseStamped or TransformStamped as YAML, or measured_cp as 4 rows of 4 numbers)"
_UNIT = 1e-3  # tolerance of a quaternion's length


class _Vector(Struct):
    x: Number
    y: Number
    z: Number


class _Quaternion(_Vector):
    w: Number


class _Pose(Struct):
    position: _Vector
    orientation: _Quaternion


class _Transform(Struct):
    translation: _Vector
    rotation: _Quaternion


class _Measured(Struct):
    pose: _Pose | None = None
    transform: _Transform | None = None
    measured_cp: Transform | None = None


def read_cartesian_pose(path: Path) -> Float64:
    """Read a pose (4, 4), m; of several messages the first.

    Raises
    ------
    InputError
        The file is not readable or has no such pose; the message names the file and the field.
    """
    where = str(path)
    document = _with_numbers(read_yaml_mapping(path, expected=_EXPECTED))
    stated = convert_document(where, document, _Measured)
    if stated.pose is not None:
        return _pose(where, "pose.orientation", stated.pose.position, stated.pose.orientation)
    if stated.transform is not None:
        return _pose(where, "transform.rotation", stated.transform.translation, stated.transform.rotation)
    if stated.measured_cp is not None:
        return stated.measured_cp
    raise InputError(f"{path}: expected {_EXPECTED}, got fields {listed(document, 8)}")


def _with_numbers(value: Any) -> Any:
    """Convert texts of numbers, e.g. 1e-05, which YAML takes for a text because it has no point."""
    if isinstance(value, dict):
        return {key: _with_numbers(inner) for key, inner in value.items()}
    if isinstance(value, list):
        return [_with_numbers(inner) for inner in value]
    try:
        return float(value) if isinstance(value, str) else value
    except ValueError:
        return value


def _pose(where: str, field: str, position: _Vector, orientation: _Quaternion) -> Float64:
    """Convert a position and a quaternion to a pose (4, 4); InputError for a quaternion that is not a unit one."""
    quaternion = np.array([orientation.x, orientation.y, orientation.z, orientation.w])
    if abs(np.linalg.norm(quaternion) - 1) > _UNIT:
        raise InputError(f"{where}: {field}: expected a unit quaternion x, y, z, w, got {shown(quaternion.tolist())}")
    from scipy.spatial.transform import Rotation  # imported late: most exports do without

    return transform(Rotation.from_quat(quaternion).as_matrix(), [position.x, position.y, position.z])
