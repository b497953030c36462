"""Export of results as a ROS recording."""

from __future__ import annotations

from typing import cast

from dvrk_cmaes.errors import InputError
from dvrk_cmaes.export.request import Exported, ExportRequest
from dvrk_cmaes.export.ros_bag import BagKind, bag_files
from dvrk_cmaes.export.ros_topics import result_messages, times_or_rows


def exported(request: ExportRequest) -> Exported:
    """Export poses, joints and transforms of frames as messages.

    Raises
    ------
    InputError
        There are no frames, none has a pose, one has no time, or a name is not valid in tf.
    """
    source, names = request.source, request.names
    results = source.poses()
    names.check_tf()
    posed = [result for result in results if result.camera_from_root is not None]
    if not posed:
        raise InputError(f"{source.path}: camera_from_root: expected a pose in at least one frame, got none")
    base = source.base() if source.has_base() else None
    notes: list[str] = []
    if base is None:
        notes.append("camera_from_base is not known: no measured_cp by the readings, and no base in tf")
    times, unknown = times_or_rows(results, request.times)
    notes += unknown
    messages = result_messages(posed, times, names, base, request.tip)
    return Exported(bag_files(messages, cast(BagKind, request.to), names.arm), base, source.without_pose, tuple(notes))
