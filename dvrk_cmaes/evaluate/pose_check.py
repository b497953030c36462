"""Comparison of a result with a golden pose: one row for each quantity, and a table of text that marks large errors."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from dvrk_cmaes.evaluate import Tolerance
from dvrk_cmaes.evaluate.pose_error import Measured, PoseError, compare_poses, tips_in_camera
from dvrk_cmaes.frames.truth import FrameTruth
from dvrk_cmaes.geometry import Float64
from dvrk_cmaes.instrument import Instrument
from dvrk_cmaes.results.result import Result

Pose = tuple[Float64, Mapping[str, float]]


class Row(NamedTuple):
    """A quantity's error, with its values found and expected, mm or deg (three numbers for a point or a direction)."""

    measured: Measured
    found: Sequence[float]
    expected: Sequence[float]


@dataclass(frozen=True, eq=False)
class PoseCheck:
    """Comparison of one frame's result with its golden pose.

    rows : one for each quantity; empty if there is nothing to compare.
    is_twin : whether the rows compare with the mirror twin of the golden pose.
    twin_within_tolerance : whether the mirror twin is within tolerance while the golden pose is not, and twins were not
        accepted.
    no_pose : message that says why there is nothing to compare, otherwise empty.
    """

    frame: str
    rows: tuple[Row, ...]
    is_twin: bool = False
    twin_within_tolerance: bool = False
    no_pose: str = ""

    @property
    def right(self) -> bool:
        """Whether there is a pose and all its errors are within tolerance."""
        return not self.no_pose and not any(row.measured.exceeds for row in self.rows)


def check_pose(
    result: Result, golden: FrameTruth, instrument: Instrument, tolerance: Tolerance, *, modulo_twin: bool = False
) -> PoseCheck:
    """Compare a result with a golden pose.

    With ``modulo_twin``, the result is compared with the golden pose's mirror twin instead if that is nearer in roll.
    """
    if result.camera_from_root is None:
        return PoseCheck(result.frame, (), no_pose=f"no pose: {'; '.join(result.reasons) or result.status}")
    names = instrument.joint_names
    # the tips need all joints of the result, the others only those that are known of the golden pose
    unknown = [name for name in names if name not in result.joints]
    if unknown:
        return PoseCheck(result.frame, (), no_pose=f"no joint {unknown[0]} in the result; is it another instrument's?")
    expected = (golden.camera_from_root, golden.joints)
    pose_found = (result.camera_from_root, result.joints)
    straight = PoseCheck(result.frame, _rows(instrument, pose_found, expected, tolerance))
    if straight.right or not instrument.has_twin or any(name not in golden.joints for name in names):
        return straight
    pose, joints = instrument.twin(golden.camera_from_root, [golden.joints[name] for name in names])
    twin = (pose, dict(zip(names, joints.tolist(), strict=True)))
    turned = PoseCheck(result.frame, _rows(instrument, pose_found, twin, tolerance), is_twin=True)
    if modulo_twin and _roll(turned) < _roll(straight):
        return turned
    return PoseCheck(result.frame, straight.rows, twin_within_tolerance=turned.right)


def table(check: PoseCheck) -> Iterator[str]:
    """Yield the lines of a table of values found and expected, errors and tolerances; large errors are marked."""
    if check.no_pose:
        yield check.no_pose
        return
    yield f"{'':<18}{'found':>27}{'expected':>27}{'error':>9}{'at most':>9}"
    for row in check.rows:
        measured = row.measured
        mark = "  <- off" if measured.exceeds else ""
        yield (
            f"{f'{measured.quantity}, {measured.unit}':<18}{_numbers(row.found):>27}{_numbers(row.expected):>27}"
            f"{measured.error:>9.2f}{measured.at_most:>9g}{mark}"
        )
    if check.is_twin:
        yield "expected is the mirror twin of the golden pose"
    if check.twin_within_tolerance:
        yield "the mirror twin of the golden pose would be within tolerance (modulo_twin)"


def _roll(check: PoseCheck) -> float:
    return next(row.measured.error for row in check.rows if row.measured.quantity == "roll")


def _rows(instrument: Instrument, pose_found: Pose, expected: Pose, tolerance: Tolerance) -> tuple[Row, ...]:
    error: PoseError = compare_poses(instrument, pose_found, expected)
    values = [_values(instrument, pose, joints) for pose, joints in (pose_found, expected)]
    return tuple(
        Row(measured, *(value.get(measured.quantity, ()) for value in values)) for measured in error.measured(tolerance)
    )


def _values(instrument: Instrument, pose: Float64, joints: Mapping[str, float]) -> dict[str, Sequence[float]]:
    """Return the values of a pose by quantity: positions in the camera, mm, direction of the shaft, joints, deg."""
    values: dict[str, Sequence[float]] = {"root": (1e3 * pose[:3, 3]).tolist(), "shaft": pose[:3, 2].tolist()}
    if (tips := tips_in_camera(instrument, pose, joints)) is not None:
        values["tip"] = (1e3 * tips.mean(axis=0)).tolist()
    own = [name for name in instrument.joint_names if name in joints]
    return values | {name: (float(np.degrees(joints[name])),) for name in own}


def _numbers(values: Sequence[float]) -> str:
    return " ".join(f"{value:.2f}" for value in values) or "-"
