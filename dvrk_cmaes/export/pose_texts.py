"""Export of results as text, a line a frame.

As a table with the columns of `dvrk_cmaes.results.pose_rows`, or as a trajectory of the TUM RGB-D benchmark,
which evo and other programs read: ``timestamp tx ty tz qx qy qz qw``, of camera_from_root, in s and m.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from dvrk_cmaes.export.request import Exported, ExportRequest
from dvrk_cmaes.export.ros_topics import times_or_rows
from dvrk_cmaes.geometry import quaternion_xyzw
from dvrk_cmaes.io.csv_file import csv_text
from dvrk_cmaes.joints.interpolation import NANOSECONDS
from dvrk_cmaes.results.pose_rows import pose_rows


def table_text(rows: Sequence[Mapping[str, Any]]) -> str:
    """Format rows with equal columns as CSV, None as a blank cell; an empty text for no rows."""
    if not rows:
        return ""
    return csv_text(list(rows[0]), ([*row.values()] for row in rows))


def exported(request: ExportRequest) -> Exported:
    """Export a line for each frame; InputError if there are no frames, or a trajectory's have no time."""
    if request.to == "csv":
        return Exported.of_texts({"poses.csv": table_text(pose_rows(request.source.poses()))})
    results = [result for result in request.source.poses() if result.camera_from_root is not None]
    times, notes = times_or_rows(results, request.times)
    text = ""
    for result in sorted(results, key=lambda result: times[result.frame]):
        assert result.camera_from_root is not None
        seconds, rest = divmod(times[result.frame], NANOSECONDS)
        numbers = (*result.camera_from_root[:3, 3].tolist(), *quaternion_xyzw(result.camera_from_root))
        text += f"{seconds}.{rest:09d} {' '.join(f'{number:.9f}' for number in numbers)}\n"
    return Exported({f"{request.names.arm}.tum": text.encode()}, left_out=request.source.without_pose, notes=notes)
