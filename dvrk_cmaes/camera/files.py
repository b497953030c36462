"""Read camera files as calibration tools write them; the format is recognised by the content.

A camera may be nested under a single key. The names of fields are those of `document`.
"""

from __future__ import annotations

import re
import xml.etree.ElementTree as ElementTree
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from dvrk_cmaes.camera import Camera, Rig
from dvrk_cmaes.camera.document import FORMAT, read_fields, unwrapped
from dvrk_cmaes.camera.fields import Intrinsics, Side, Size, take_field, take_numbers
from dvrk_cmaes.errors import InputError
from dvrk_cmaes.geometry import exp_rotation
from dvrk_cmaes.io.files import read_bytes
from dvrk_cmaes.io.plain_xml import parse_xml
from dvrk_cmaes.io.yaml_file import read_yaml_mapping

__all__ = ["CameraFile", "Side", "Size", "read_camera", "read_camera_file", "read_document", "read_intrinsics"]

_EXPECTED = "a camera file (YAML or XML)"
_LARGEST = 1_000_000  # bytes

_MATLAB = b"MATLAB "
_COLMAP = re.compile(r"^\s*\d+\s+[A-Z][A-Z_]+\s+\d+\s+\d+\s+[-+.\deE \t]+$", re.MULTILINE)
_NO_LONGER = "not read: write fx, fy, cx, cy, width, height, k1, k2, p1, p2 to a YAML file"


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
    return read_fields(str(path), read_document(path), rectified=rectified, side=side)


def read_document(path: str | Path) -> dict[str, Any]:
    """Read the fields of a camera file as plain values; those of EndoVis' with the names of OpenCV's."""
    data = read_bytes(path, expected=_EXPECTED, largest=_LARGEST)
    text = data.decode("utf-8", errors="replace")
    if is_endovis(text):
        return endovis_document(str(path), text)
    if data.startswith(_MATLAB) or _COLMAP.search(text):
        tool = "MATLAB's .mat is" if data.startswith(_MATLAB) else "COLMAP's cameras.txt is"
        raise InputError(f"{path}: expected {_EXPECTED}: {tool} {_NO_LONGER}")
    if data.lstrip(b"\xef\xbb\xbf \t\r\n").startswith(b"<"):
        return _storage_xml(str(path), parse_xml(Path(path), data))
    return unwrapped(read_yaml_mapping(path, expected=_EXPECTED))


def _storage_xml(where: str, root: ElementTree.Element) -> dict[str, Any]:
    """Convert OpenCV's XML to a document of plain values: ``{name: {"dt", "data"} or text}``."""
    if root.tag != "opencv_storage":
        raise InputError(f"{where}: expected OpenCV's XML, whose root element is <opencv_storage>, got <{root.tag}>")
    document: dict[str, Any] = {}
    for element in root:
        if element.get("type_id") in ("opencv-matrix", "opencv-nd-matrix"):
            matrix: dict[str, Any] = {child.tag: (child.text or "").strip() for child in element}
            document[element.tag] = {**matrix, "data": (element.findtext("data") or "").split()}
        else:
            document[element.tag] = (element.text or "").strip()
    return document


USUAL: Final = 1.5
"""Focal length in image widths: endoscopes of da Vinci systems have 1.4 to 1.6, see the page `uncalibrated`."""

_GUESSED = (0.1, 0.005, 0.05, 0.05, 0.15)  # standard deviations of a guessed camera, as of `Camera.covariance`
_LEAST_FOCAL, _LARGEST_FOCAL = 0.3, 6.0  # image widths


def guessed_camera(size: Size, focal: float | None = None) -> CameraFile:
    """Return a guess of a camera of which there is no file: the middle of the image, and no lens distortion.

    Parameters
    ----------
    size
        Width and height of the images, px.
    focal
        The focal length, px; by default that which is usual.

    Raises
    ------
    InputError
        The focal length is far from what cameras have.
    """
    width, height = size
    focal = USUAL * width if focal is None else focal
    if not _LEAST_FOCAL * width <= focal <= _LARGEST_FOCAL * width:
        raise InputError(
            f"--focal: expected a focal length of {_LEAST_FOCAL * width:g} to {_LARGEST_FOCAL * width:g} px, "
            f"{_LEAST_FOCAL:g} to {_LARGEST_FOCAL:g} widths of the images, got {focal:g}"
        )
    covariance = tuple(map(tuple, np.diag(np.square(_GUESSED)).tolist()))
    camera = Camera(width, height, focal, focal, (width - 1) / 2, (height - 1) / 2, covariance=covariance)
    kind = f"none; a guess with a focal length of {focal:g} px and no lens distortion"
    return CameraFile(Rig.of_camera(camera), kind)


_FIELD = re.compile(r"^\s*([A-Za-z0-9-]+)\s*:\s*([^/\n]*)", re.MULTILINE)


def is_endovis(text: str) -> bool:
    """Whether a text is EndoVis' camera_calibration.txt."""
    return re.search(r"^\s*Camera-0-F\s*:", text, re.MULTILINE) is not None


def endovis_document(where: str, text: str) -> dict[str, Any]:
    """Convert EndoVis' camera_calibration.txt, of both eyes, lengths in mm; InputError names a wrong field."""
    fields = dict(_FIELD.findall(text))

    def numbers(name: str, count: int) -> list[float]:
        """Return the numbers of a field."""
        _, entry = take_field(where, fields, (name,))
        return take_numbers(where, name, entry.split(), count)

    document: dict[str, Any] = {FORMAT: "EndoVis calibration"}
    for name, field in (("image_width", "Width"), ("image_height", "Height")):
        (document[name],) = numbers(field, 1)
    for number, camera in enumerate(("Camera-0", "Camera-1"), start=1):
        if number == 2 and f"{camera}-F" not in fields:
            continue
        (fx, fy), (cx, cy) = numbers(f"{camera}-F", 2), numbers(f"{camera}-C", 2)
        skew = numbers(f"{camera}-Alpha", 1)[0] if f"{camera}-Alpha" in fields else 0.0
        document[f"K{number}"] = [fx, skew * fx, cx, 0.0, fy, cy, 0.0, 0.0, 1.0]
        document[f"D{number}"] = numbers(f"{camera}-K", 5)
    if "Extrinsic-T" in fields:
        document["R"] = exp_rotation(np.array(numbers("Extrinsic-Omega", 3))).ravel().tolist()
        document["T"] = numbers("Extrinsic-T", 3)
    return document
