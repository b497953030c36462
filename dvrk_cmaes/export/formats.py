"""The export formats by name: direction and unit of the transform, and the files made from a source."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.errors import InputError
from dvrk_cmaes.export.base_choice import ChosenBase
from dvrk_cmaes.export.bop import bop_files
from dvrk_cmaes.export.dvrk_registration import DvrkVersion, registration_files
from dvrk_cmaes.export.easy_handeye import calibration_file
from dvrk_cmaes.export.frames import FrameNames
from dvrk_cmaes.export.joint_correction import correction_files
from dvrk_cmaes.export.pose_table import pose_rows, table_text
from dvrk_cmaes.export.ros_bag import BagKind, bag_files
from dvrk_cmaes.export.ros_topics import ToolTip, numbered_times, result_messages
from dvrk_cmaes.export.source import ExportSource
from dvrk_cmaes.export.tf import publisher_file
from dvrk_cmaes.export.tracker import tracker_files
from dvrk_cmaes.io.short_text import listed

Format = Literal["dvrk", "easy-handeye", "tf", "bop", "csv", "tracker", "ros1-bag", "ros2-bag", "joint-correction"]

DIRECTIONS: Final[dict[Format, str]] = {
    "dvrk": "camera_from_base, m, in OpenCV's and in the dVRK's camera axes",
    "easy-handeye": "base_from_camera, m: the camera in the arm's base",
    "tf": "camera_from_base, m: parent the camera, child the arm's base",
    "bop": "camera_from_root, mm",
    "csv": "camera_from_root and camera_from_base, mm, quaternions xyzw",
    "tracker": "camera_from_root, axis times angle in rad, translation in m",
    "ros1-bag": "camera_from_root and camera_from_base, m, quaternions xyzw: parent the camera",
    "ros2-bag": "camera_from_root and camera_from_base, m, quaternions xyzw: parent the camera",
    "joint-correction": "true = reading + correction: a table in degrees, and a formula in radians",
}

_BASE_FILES = {"easy-handeye": calibration_file, "tf": publisher_file}


@dataclass(frozen=True, eq=False)
class FormatOptions:
    """Options of single formats.

    Parameters
    ----------
    scene, obj
        The ids in the format bop.
    dvrk_version
        Version of the dVRK in the format dvrk.
    ecm_pose : (4, 4)
        In the format dvrk, ``local/measured_cp`` of the endoscope arm that holds the camera; None without one.
    times
        In the formats ros1-bag and ros2-bag, the frames' times, ns; empty if they are not known.
    tip
        In these formats, the tool tip frame of ``measured_cp``.
    """

    scene: int = 0
    obj: int = 1
    dvrk_version: DvrkVersion = "2.4"
    ecm_pose: NDArray[np.float64] | None = None
    times: Mapping[str, int] = field(default_factory=dict)
    tip: ToolTip = field(default_factory=ToolTip)


_NO_OPTIONS = FormatOptions()


@dataclass(frozen=True, eq=False)
class Exported:
    """The files of an export.

    ``files`` are the contents by file name, ``base`` is the choice of ``camera_from_base`` if the format has one,
    ``left_out`` are the frames without a pose, and ``notes`` state what is missing.
    """

    files: dict[str, bytes]
    base: ChosenBase | None = None
    left_out: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()


def export(source: ExportSource, to: Format, names: FrameNames, options: FormatOptions = _NO_OPTIONS) -> Exported:
    """Make the files of a format.

    Raises
    ------
    InputError
        The source has no ``camera_from_base`` or no frames and the format requires them, or a name is not valid in it.
    """
    if to == "dvrk" or to in _BASE_FILES:
        base = source.base()
        if to == "dvrk":
            texts = registration_files(
                base.camera_from_base, names, version=options.dvrk_version, ecm_pose=options.ecm_pose
            )
        else:
            texts = _BASE_FILES[to](base.camera_from_base, names)
        return Exported({name: text.encode() for name, text in texts.items()}, base)
    if to == "joint-correction":
        texts = correction_files(*source.calibration(), names)
        return Exported({name: text.encode() for name, text in texts.items()})
    results = source.poses()
    left_out = tuple(result.frame for result in results if result.camera_from_root is None)
    if to == "ros1-bag" or to == "ros2-bag":
        return _bag(source, to, names, options, left_out)
    if to == "tracker":
        return Exported(tracker_files(results), left_out=left_out)
    if to == "bop":
        texts = bop_files(results, scene=options.scene, obj=options.obj)
        return Exported({name: text.encode() for name, text in texts.items()}, left_out=left_out)
    return Exported({"poses.csv": table_text(pose_rows(results)).encode()})


def _bag(
    source: ExportSource, to: BagKind, names: FrameNames, options: FormatOptions, left_out: tuple[str, ...]
) -> Exported:
    """Make a ROS recording; errors as in ``export`` and ``bag_files``."""
    names.check_tf()
    results = source.poses()
    posed = [result for result in results if result.camera_from_root is not None]
    if not posed:
        raise InputError(f"{source.path}: camera_from_root: expected a pose in at least one frame, got none")
    base = source.base() if source.has_base() else None
    notes: list[str] = []
    if base is None:
        notes.append("camera_from_base is not known: no measured_cp by the readings, and no base in tf")
    times = options.times or numbered_times(results)
    if not options.times:
        notes.append("the frames' times are not known (--times images.csv): they are numbered, one second apart")
    untimed = [result.frame for result in posed if result.frame not in times]
    if untimed:
        raise InputError(f"--times: expected a time of every frame, got none of {listed(untimed)}")
    camera_from_base = None if base is None else base.camera_from_base
    messages = result_messages(posed, times, names, camera_from_base, options.tip)
    return Exported(bag_files(messages, to, names.arm), base, left_out, tuple(notes))
