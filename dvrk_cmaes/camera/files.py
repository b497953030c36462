"""Read camera files as calibration tools write them; the format is recognised by the content.

The formats are ROS camera_info, OpenCV FileStorage, kalibr camchain and plain YAML, with one module each; those of
further tools are converted to OpenCV's. A camera may be nested under a single key.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from dvrk_cmaes.camera import Camera, Rig
from dvrk_cmaes.camera.fields import Intrinsics, Side, Size, unknown_layout
from dvrk_cmaes.camera.kalibr import is_camchain, read_camchain
from dvrk_cmaes.camera.opencv import is_storage, read_storage, read_storage_xml
from dvrk_cmaes.camera.other_formats import (
    MAPPINGS,
    MAT_FILE,
    colmap_document,
    endovis_document,
    is_colmap,
    is_endovis,
    matlab_document,
)
from dvrk_cmaes.camera.plain import is_plain, read_plain
from dvrk_cmaes.camera.ros import is_camera_info, read_camera_info
from dvrk_cmaes.errors import InputError
from dvrk_cmaes.io.files import read_bytes
from dvrk_cmaes.io.plain_xml import parse_xml
from dvrk_cmaes.io.yaml_file import read_yaml_mapping

__all__ = ["CameraFile", "Side", "Size", "read_camera", "read_camera_file", "read_document", "read_intrinsics"]

_EXPECTED = "a camera file (YAML or XML)"
_LARGEST = 1_000_000  # bytes

_KINDS = (
    (is_camchain, read_camchain),
    (is_storage, read_storage),
    (is_plain, read_plain),
    (is_camera_info, read_camera_info),
)


@dataclass(frozen=True, eq=False)
class CameraFile:
    """A camera or a pair read from files: ``kind`` describes the format, ``notes`` state assumptions that were made."""

    rig: Rig
    kind: str
    notes: tuple[str, ...] = ()

    @property
    def camera(self) -> Camera:
        """The only camera, or the reference camera of a pair."""
        return self.rig.camera


def read_camera(
    path: str | Path, *, rectified: bool = False, side: Side = "left", size: Size | Callable[[], Size] | None = None
) -> Camera:
    """Read the camera of a camera file of any known format; errors as in ``read_camera_file``.

    Parameters
    ----------
    path
        The camera file, of any format that is read.
    rectified
        Whether the images are rectified.
    side
        ``left`` or ``right``: the camera of a file of both eyes.
    size
        Width and height of the images, px, or a function that returns them, for files that do not state them.
    """
    return read_camera_file(path, rectified=rectified, side=side, size=size).camera


def read_camera_file(
    path: str | Path, *, rectified: bool = False, side: Side = "left", size: Size | Callable[[], Size] | None = None
) -> CameraFile:
    """Read a camera file of any known format.

    Parameters
    ----------
    path
        The file.
    rectified
        Whether the images are rectified.
    side
        Which camera of a stereo pair.
    size
        Width and height of the images in pixels, or a function that returns them, for files that do not state them.

    Returns
    -------
    CameraFile
        The camera for images of the size stated in the file, or of ``size``.

    Raises
    ------
    InputError
        A field is missing or wrong, the size is neither stated nor given, or the principal point lies outside
        images of the given size.
    """
    intrinsics = read_intrinsics(path, rectified=rectified, side=side)
    notes = intrinsics.notes
    width, height = intrinsics.size or (0, 0)
    if intrinsics.size is None:
        if size is None:
            raise InputError(f"{path}: image size: not stated in the file; expected it to be given, in pixels")
        width, height = size() if callable(size) else size
        if not (0 <= intrinsics.cx < width and 0 <= intrinsics.cy < height):
            raise InputError(
                f"{path}: principal point: expected one within images of {width} x {height}, "
                f"got {intrinsics.cx:g}, {intrinsics.cy:g}: the calibration is of another size, which the file does "
                "not state"
            )
        notes = (*notes, f"the camera file states no image size: taken to be {width} x {height}, that of the frames")
    return CameraFile(Rig.of_camera(intrinsics.camera(path, (width, height))), intrinsics.kind, notes)


def read_intrinsics(path: str | Path, *, rectified: bool = False, side: Side = "left") -> Intrinsics:
    """Read the intrinsics that a camera file states, with or without a size; errors as in ``read_camera_file``."""
    where, document = str(path), read_document(path)
    if _is_pair(document):
        where, document, side = f"{path}: {side}", _unwrapped(document[side], f"{path}: {side}"), "left"
    for is_kind, read_kind in _KINDS:
        if is_kind(document):
            return read_kind(where, document, rectified=rectified, side=side)
    raise unknown_layout(where, document)


def read_document(path: str | Path) -> dict[str, Any]:
    """Read the fields of a camera file as plain values; those of further tools in the layout of OpenCV's."""
    data = read_bytes(path, expected=_EXPECTED, largest=_LARGEST)
    if data.startswith(MAT_FILE):
        return matlab_document(str(path), data)
    text = data.decode("utf-8", errors="replace")
    if is_endovis(text):
        return endovis_document(str(path), text)
    if is_colmap(text):
        return colmap_document(str(path), text)
    if data.lstrip(b"\xef\xbb\xbf \t\r\n").startswith(b"<"):
        return read_storage_xml(str(path), parse_xml(Path(path), data))
    return _unwrapped(read_yaml_mapping(path, expected=_EXPECTED), str(path))


def is_camera(document: Mapping[str, Any]) -> bool:
    """Whether a document has the fields of a camera of any format."""
    return any(is_kind(document) for is_kind, _ in (*MAPPINGS, *_KINDS))


def _unwrapped(document: dict[str, Any], where: str) -> dict[str, Any]:
    """Return the camera in a document that is nested under a single key; those of `MAPPINGS` are converted."""
    for is_kind, converted in MAPPINGS:
        if is_kind(document):
            return converted(where, document)
    if any(is_kind(document) for is_kind, _ in _KINDS) or _is_pair(document):
        return document
    inside = [value for value in document.values() if isinstance(value, dict)]
    found = _unwrapped(inside[0], where) if len(inside) == 1 else document
    return found if is_camera(found) or _is_pair(found) else document


def _is_pair(document: Mapping[str, Any]) -> bool:
    """Whether a document has a mapping for each camera of a pair."""
    return all(isinstance(document.get(name), dict) for name in ("left", "right"))
