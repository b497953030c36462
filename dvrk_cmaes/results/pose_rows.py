"""Results as rows of a table: one row per frame, one number per column, with the unit in the column's name.

``camera_from_root_*`` and ``camera_from_base_*`` map points from the frames of the instrument's root link and of the
arm's base to the camera frame (OpenCV's axes): translation in mm, quaternion in the order of ROS.
``std_camera_from_root_*`` are standard deviations along and about the camera's axes. ``tip_1_*`` and ``tip_2_*`` are
the tips of jaw_1 and jaw_2, or the end of an instrument without a pair of jaws, in the camera, with standard deviations
along the camera's axes, and their pixels. ``time`` is that of the image, s. Jaw tips are within ``tips_90_mm`` with
90 %, and within ``tips_90_given_camera_mm`` if the camera file is exact, for which the standard deviations of the pose
hold as well; ``std_tips_mm`` is the root mean square error of their mean. Joint columns are estimated values,
``*_read_*`` are readings, in deg, insertion in mm.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import Any

import numpy as np

from dvrk_cmaes.geometry import Float64, quaternion_xyzw
from dvrk_cmaes.joints.names import shown_unit
from dvrk_cmaes.results.result import Result

_DIGITS = 6  # decimals; of mm, a nanometre


def pose_rows(results: Iterable[Result]) -> list[dict[str, Any]]:
    """Return the rows of the table, all with the same columns in the same order; None for a missing value.

    A joint has columns if at least one result has a value for it.
    """
    results = list(results)
    joints = list(dict.fromkeys(name for result in results for name in result.joints))
    readings = list(dict.fromkeys(name for result in results for name in result.readings))
    tips = max((len(result.tips) for result in results), default=0)
    return [dict(_row(result, joints, readings, tips)) for result in results]


def _row(result: Result, joints: Sequence[str], readings: Sequence[str], tips: int) -> Iterator[tuple[str, Any]]:
    """Yield the columns and values of one result; ``tips`` is the largest number of tips of all results."""
    yield "frame", result.frame
    yield "time", result.time
    yield "status", result.status
    yield from _pose("camera_from_root", result.camera_from_root)
    for name in joints:
        yield _scaled(name, "", result.joints.get(name))
    for name in readings:
        yield _scaled(name, "_read", result.readings.get(name))
    yield from _deviations(result, joints)
    for number in range(tips):
        yield from _tip(result, number)
    expected = result.expected_error
    yield "tips_90_mm", None if expected is None else round(expected.tip_90_mm, _DIGITS)
    in_camera = None if expected is None else expected.tip_90_given_camera_mm
    yield "tips_90_given_camera_mm", None if in_camera is None else round(in_camera, _DIGITS)
    yield "std_tips_mm", None if expected is None else round(expected.of_tips_mm, _DIGITS)
    yield "std_shaft_deg", None if expected is None else round(expected.shaft_deg, _DIGITS)
    yield "mode_probability", result.mode_probability
    yield "tip_probability", result.tip_probability
    for name in ("iou", "loss", "contour_px_median", "contour_px_95", "steady_share", "distal_px"):
        yield name, getattr(result.quality, name, None)
    yield from _pose("camera_from_base", result.camera_from_base)
    yield "source", result.source
    yield "alternatives", len(result.alternatives)
    yield "seconds", result.seconds or None
    yield "reasons", "; ".join(result.reasons)
    yield "warnings", "; ".join(result.warnings)
    yield "unused", "; ".join(result.unused)


def _pose(name: str, pose: Float64 | None) -> Iterator[tuple[str, float | None]]:
    """Yield the columns and values of a pose (4, 4), or None values without a pose."""
    translation = [None] * 3 if pose is None else np.round(1e3 * pose[:3, 3], _DIGITS).tolist()
    quaternion = [None] * 4 if pose is None else np.round(quaternion_xyzw(pose), 9).tolist()
    yield from ((f"{name}_{axis}_mm", value) for axis, value in zip("xyz", translation, strict=True))
    yield from ((f"{name}_q{axis}", value) for axis, value in zip("xyzw", quaternion, strict=True))


def _tip(result: Result, number: int) -> Iterator[tuple[str, float | None]]:
    """Yield the columns and values of a tip, counted from 0: position, standard deviations, pixel."""
    there = number < len(result.tips)
    name = f"jaw_{number + 1}" if len(result.tips) > 1 else "tip"
    axes = None if result.expected_error is None else result.expected_error.tip_axes_mm.get(name)
    for kind, unit, parts, values in (
        ("", "mm", "xyz", 1e3 * result.tips[number] if there else None),
        ("std_", "mm", "xyz", axes if there else None),
        ("", "px", "uv", result.tips_px[number] if number < len(result.tips_px) else None),
    ):
        for k, part in enumerate(parts):
            yield f"{kind}tip_{number + 1}_{part}_{unit}", None if values is None else round(float(values[k]), _DIGITS)


def _scaled(name: str, suffix: str, value: float | None) -> tuple[str, float | None]:
    """Return the column and value of a joint, converted from rad or m to deg or mm."""
    factor, unit = shown_unit(name)
    return f"{name}{suffix}_{unit}", None if value is None else round(factor * value, _DIGITS)


def _deviations(result: Result, joints: Sequence[str]) -> Iterator[tuple[str, float | None]]:
    """Yield the columns and values of the standard deviations."""
    covariance, joint = result.covariance_in_camera(), result.std_joints_deg or {}
    std = None if covariance is None else np.sqrt(np.diag(covariance)[:6])
    for k, axis in enumerate(("x", "y", "z", "rx", "ry", "rz")):
        unit, factor = ("mm", 1e3) if k < 3 else ("deg", float(np.degrees(1.0)))
        value = None if std is None else round(factor * float(std[k]), _DIGITS)
        yield f"std_camera_from_root_{axis}_{unit}", value
    for name in joints:
        yield f"std_{name}_deg", round(joint[name], _DIGITS) if name in joint else None
