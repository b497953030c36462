"""Export of poses as a trajectory in the format of the TUM RGB-D benchmark, which evo and other programs read.

A line a frame: ``timestamp tx ty tz qx qy qz qw``, of camera_from_root, in s and m.
"""

from __future__ import annotations

from dvrk_cmaes.export.request import Exported, ExportRequest
from dvrk_cmaes.export.ros_topics import times_or_rows
from dvrk_cmaes.geometry import quaternion_xyzw
from dvrk_cmaes.joints.interpolation import NANOSECONDS


def exported(request: ExportRequest) -> Exported:
    """Export the poses of frames; InputError if there are no frames, or some have no time."""
    results = [result for result in request.source.poses() if result.camera_from_root is not None]
    times, notes = times_or_rows(results, request.options.times)
    text = ""
    for result in sorted(results, key=lambda result: times[result.frame]):
        assert result.camera_from_root is not None
        seconds, rest = divmod(times[result.frame], NANOSECONDS)
        numbers = (*result.camera_from_root[:3, 3].tolist(), *quaternion_xyzw(result.camera_from_root))
        text += f"{seconds}.{rest:09d} {' '.join(f'{number:.9f}' for number in numbers)}\n"
    return Exported({f"{request.names.arm}.tum": text.encode()}, left_out=request.source.without_pose, notes=notes)
