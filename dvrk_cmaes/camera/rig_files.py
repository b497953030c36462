"""Read the rig of a stereo pair: one file that has both cameras and their pose, or a file of each camera."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from dvrk_cmaes.camera.document import is_camchain, is_stereo
from dvrk_cmaes.camera.fields import ONE_CAMERA, has_field
from dvrk_cmaes.camera.files import CameraFile, Size, read_camera_file, read_document
from dvrk_cmaes.camera.rig import Rig
from dvrk_cmaes.camera.stereo import StereoPose, pose_of_camchain, pose_of_camera_infos, pose_of_plain, pose_of_storage
from dvrk_cmaes.errors import InputError


def read_rig(
    left: str | Path,
    right: str | Path | None = None,
    *,
    rectified: bool = False,
    size: Size | Callable[[], Size] | None = None,
) -> CameraFile:
    """Read the two cameras of a stereo pair and the pose between them.

    Parameters
    ----------
    left
        The left camera's file, or a file that has both cameras: OpenCV's of a pair, or a kalibr camchain.
    right
        The right camera's file: ROS camera_info, with one of the left, or plain YAML with ``right_from_left``.
    rectified, size
        As in ``read_camera_file``.

    Raises
    ------
    InputError
        As ``read_camera_file``; the files do not state the pose between the cameras, a baseline is not that of an
        endoscope's eyes, or left and right are exchanged.
    """
    first = read_camera_file(left, rectified=rectified, side="left", size=size)
    both = Path(left if right is None else right)
    second = read_camera_file(both, rectified=rectified, side="right", size=size)
    pose, notes = _pose_of_one(Path(left), rectified) if right is None else _pose_of_two(Path(left), both, rectified)
    try:
        rig = Rig.stereo(first.camera, second.camera, pose)
    except InputError as error:
        raise InputError(f"{both}: {error}") from None
    kind = first.kind if right is None else f"{first.kind} of each eye"
    more = tuple(note for note in second.notes if note != ONE_CAMERA)
    return CameraFile(rig, f"stereo: {kind}", tuple(dict.fromkeys((*first.notes, *more, *notes))))


def _pose_of_one(path: Path, rectified: bool) -> StereoPose:
    """Return the pose between the cameras of a file that has both."""
    document = read_document(path)
    if is_camchain(document):
        return pose_of_camchain(str(path), document)
    if is_stereo(document):
        return pose_of_storage(str(path), document, rectified=rectified)
    raise InputError(f"{path}: expected both eyes (OpenCV's stereo, kalibr's camchain), got the file of one camera")


def _pose_of_two(left: Path, right: Path, rectified: bool) -> StereoPose:
    """Return the pose between the cameras of two files."""
    documents: tuple[Mapping[str, Any], Mapping[str, Any]] = (read_document(left), read_document(right))
    if is_stereo(documents[1]):
        raise InputError(f"{right}: expected the file of one camera, got a pair's: give it as the only file")
    if has_field(documents[1], ("projection_matrix", "P", "p")):
        return pose_of_camera_infos((str(left), str(right)), *documents, rectified=rectified)
    return pose_of_plain(str(right), documents[1])
