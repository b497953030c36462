"""Export of results in the format of the BOP benchmark: ``camera_from_root`` in mm, one line per image.

``im_id`` is the number that is the frame's name. If a name is not a number, or two names are the same number, frames
are numbered consecutively, and a file ``im_ids.csv`` maps the numbers to frames.
"""

from __future__ import annotations

from collections.abc import Sequence

from dvrk_cmaes.export.pose_texts import table_text
from dvrk_cmaes.export.request import Exported, ExportRequest

RESULTS = "dvrk-cmaes_dvrk-test.csv"
"""File name; BOP's tools parse method, data set and split from it."""

IM_IDS = "im_ids.csv"
"""Name of the file that maps ``im_id`` to frames."""


def exported(request: ExportRequest) -> Exported:
    """Export the poses of frames, and the numbers of frames if they are needed; InputError if there are no frames.

    Frames without a pose have no line. The score is the overlap (IoU), or 1 for a result without one; the time is in s.
    """
    results = request.source.poses()
    frames = [result.frame for result in results]
    numbered = _numbered(frames)
    numbers = {frame: int(frame) if numbered else row for row, frame in enumerate(frames)}
    lines = ["scene_id,im_id,obj_id,score,R,t,time"]
    for result in results:
        if result.camera_from_root is None:
            continue
        rotation = " ".join(map(repr, result.camera_from_root[:3, :3].ravel().tolist()))
        translation = " ".join(map(repr, (1e3 * result.camera_from_root[:3, 3]).tolist()))
        score = 1.0 if result.quality is None else result.quality.iou
        lines.append(
            f"{request.scene},{numbers[result.frame]},{request.obj},{score!r},{rotation},{translation},"
            f"{result.seconds or -1.0!r}"
        )
    files = {RESULTS: "\n".join(lines) + "\n"}
    if not numbered:
        files[IM_IDS] = table_text([{"im_id": number, "frame": frame} for frame, number in numbers.items()])
    return Exported.of_texts(files, left_out=request.source.without_pose)


def _numbered(frames: Sequence[str]) -> bool:
    """Whether all names are numbers and all numbers are different."""
    if not all(frame.isascii() and frame.isdigit() and len(frame) <= 9 for frame in frames):
        return False
    return len({int(frame) for frame in frames}) == len(frames)
