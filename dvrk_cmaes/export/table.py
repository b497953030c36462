"""The export formats: a row for each, with the module that makes its files.

The module has a function ``exported(request) -> Exported`` (see `dvrk_cmaes.export.request`). It is imported when it is
used, so that this table costs nothing where it is only listed.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final


@dataclass(frozen=True)
class ExportFormat:
    """A format by its name.

    content : transform and units, and after a semicolon what is written. module : name of the module of
    `dvrk_cmaes.export` that makes the files.
    """

    name: str
    content: str
    module: str

    @property
    def direction(self) -> str:
        """Transform and units, as in the summary of an export."""
        return self.content.partition(";")[0]


_ROWS: Final = (
    ExportFormat(
        "dvrk",
        "camera_from_base, m; two JSON files, named as by dvrk_camera_registration, for the camera axes of OpenCV "
        "(x right, y down) and of the dVRK (x left, y up: multiplied by diag(-1,-1,1,1) on the left). The latter is "
        "the arm's base_frame in system.json. With --ecm-pose there is suj-fixed.json instead.",
        "dvrk_registration",
    ),
    ExportFormat(
        "easy-handeye",
        "base_from_camera, m; a .calib file of easy_handeye2, a .yaml file of easy_handeye (ROS 1), type eye_on_base.",
        "easy_handeye",
    ),
    ExportFormat(
        "tf",
        "camera_from_base, m; a command line of ROS 2's static_transform_publisher, parent camera, child base. It is "
        "printed on stdout, and with --out it is also written to a file.",
        "tf",
    ),
    ExportFormat(
        "bop",
        "camera_from_root, mm; results CSV of the BOP benchmark. If names of frames are not numbers, im_ids.csv has "
        "the number of each frame.",
        "bop",
    ),
    ExportFormat(
        "csv",
        "camera_from_root and camera_from_base, mm, deg and quaternions xyzw; poses.csv, one row for each frame.",
        "pose_texts",
    ),
    ExportFormat(
        "tum",
        "camera_from_root, m; ARM.tum, a trajectory as of the TUM RGB-D benchmark: a line for each frame, timestamp in "
        "s, position, quaternion xyzw.",
        "pose_texts",
    ),
    ExportFormat(
        "lerobot",
        "camera_from_base, m; the parquet file of an episode of a LeRobot data set (--table), with corrected joints, "
        "camera_from_base, lag, status and tip_probability as columns beside the original ones.",
        "lerobot",
    ),
    ExportFormat(
        "ros1-bag",
        "camera_from_root and camera_from_base, m, quaternions xyzw; ARM.bag with poses, JointState and tf "
        "messages for each frame; `dvrk-cmaes help exports` lists the topics. Needs the library rosbags.",
        "result_bag",
    ),
    ExportFormat(
        "ros2-bag",
        "camera_from_root and camera_from_base, m, quaternions xyzw; the same as a folder ARM (sqlite3).",
        "result_bag",
    ),
    ExportFormat(
        "camera",
        "camera matrix and distortion, px, view_from_camera, m; the camera or the rig that a session calibration used, "
        "for raw images, as camera files that are read: ros/ (camera_info), opencv/ (XML) and plain/ (YAML).",
        "camera",
    ),
)

FORMATS: Final = {row.name: row for row in _ROWS}
"""The formats by name."""
