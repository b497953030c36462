"""Results as the BOP benchmark takes them: ``camera_from_root`` in mm, a line an image.

``im_id`` is the frame's number. Where a frame's name is no number, or two names are the same number, all frames are
numbered by their rows in ``im_ids.csv``, written beside.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from dvrk_cmaes.export.pose_table import table_text
from dvrk_cmaes.results.result import Result

RESULTS = "dvrk-cmaes_dvrk-test.csv"
"""BOP's tools read the method, the data set and the split off a file's name."""

IM_IDS = "im_ids.csv"


def bop_files(results: Sequence[Result], *, scene: int = 0, obj: int = 1) -> dict[str, str]:
    """Texts of the results, and where needed of the map from frames to im_id, by the files' names.

    Frames without a pose have no line. The score is the overlap (IoU), 1 where a result does not say; the time is in s.
    """
    numbers = image_numbers([result.frame for result in results])
    lines = ["scene_id,im_id,obj_id,score,R,t,time"]
    for result in results:
        if result.camera_from_root is None:
            continue
        rotation = " ".join(map(repr, result.camera_from_root[:3, :3].ravel().tolist()))
        translation = " ".join(map(repr, (1e3 * result.camera_from_root[:3, 3]).tolist()))
        score = 1.0 if result.quality is None else result.quality.iou
        lines.append(f"{scene},{numbers[result.frame]},{obj},{score!r},{rotation},{translation},{result.seconds!r}")
    files = {RESULTS: "\n".join(lines) + "\n"}
    if not _numbered(list(numbers)):
        files[IM_IDS] = table_text([{"im_id": number, "frame": frame} for frame, number in numbers.items()])
    return files


def image_numbers(frames: Sequence[str]) -> Mapping[str, int]:
    """Give each frame a number: its name or, where that does not do for all, its row."""
    if _numbered(frames):
        return {frame: int(frame) for frame in frames}
    return {frame: row for row, frame in enumerate(frames)}


def _numbered(frames: Sequence[str]) -> bool:
    """Whether all names are numbers, each another."""
    if not all(frame.isascii() and frame.isdigit() and len(frame) <= 9 for frame in frames):
        return False
    return len({int(frame) for frame in frames}) == len(frames)
