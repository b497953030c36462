"""Convert calibrations of further tools to documents in the layout of OpenCV's FileStorage, which ``opencv`` reads.

These are EndoVis' camera_calibration.txt, MATLAB's cameraParams and stereoParams that were saved as structs, and flat
files with fx, fy, cx and cy, such as BOP's camera.json. The name of the tool is in the document, for messages.
"""

from __future__ import annotations

import io
import re
from collections.abc import Mapping
from typing import Any, Final

import numpy as np

from dvrk_cmaes.camera.fields import as_number, take_field, take_numbers
from dvrk_cmaes.errors import InputError, one_line
from dvrk_cmaes.geometry import Float64, exp_rotation
from dvrk_cmaes.io.short_text import listed, shown

FORMAT = "calibration_format"
"""Field of a converted document with the name of the tool."""

MAT_FILE = b"MATLAB "

_ENDOVIS = re.compile(r"^\s*([A-Za-z0-9-]+)\s*:\s*([^/\n]*)", re.MULTILINE)
_FLAT = ("fx", "fy", "cx", "cy")
_REALSENSE = {"ppx": "cx", "ppy": "cy"}
_ALSO_ROS = ("camera_matrix", "K")
_MATRICES = (*_ALSO_ROS, "cameraMatrix", "intrinsic_matrix", "intrinsicMatrix", "mtx")
_DISTORTIONS = ("dist_coeffs", "distCoeffs", "distortion_coefficients", "distortion", "dist", "D")
_SIZES = ("image_size", "imageSize", "img_size", "resolution", "size")
_COLMAP = re.compile(r"^\s*\d+\s+([A-Z][A-Z_]+)\s+(\d+)\s+(\d+)\s+([-+.\deE \t]+)$", re.MULTILINE)
_COLMAP_MODELS = {
    "SIMPLE_PINHOLE": ("f", "cx", "cy"),
    "PINHOLE": ("fx", "fy", "cx", "cy"),
    "SIMPLE_RADIAL": ("f", "cx", "cy", "k1"),
    "RADIAL": ("f", "cx", "cy", "k1", "k2"),
    "OPENCV": ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2"),
}
_COEFFICIENTS = ("k1", "k2", "p1", "p2", "k3")
_TO_STRUCT = "in MATLAB: s = toStruct(stereoParams); save('stereo.mat', '-struct', 's', '-v7')"


def is_endovis(text: str) -> bool:
    """Whether a text is EndoVis' camera_calibration.txt."""
    return re.search(r"^\s*Camera-0-F\s*:", text, re.MULTILINE) is not None


def endovis_document(where: str, text: str) -> dict[str, Any]:
    """Convert EndoVis' camera_calibration.txt, of both eyes, lengths in mm; InputError names a wrong field."""
    fields = dict(_ENDOVIS.findall(text))

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


def matlab_document(where: str, data: bytes) -> dict[str, Any]:
    """Convert a .mat file with the fields of cameraParams or stereoParams; InputError tells how to save them.

    MATLAB counts pixels from 1, and its matrices of older versions act on rows.
    """
    from scipy.io import loadmat  # takes long to import

    try:
        content = loadmat(io.BytesIO(data), simplify_cells=True)
    except NotImplementedError:
        raise InputError(
            f"{where}: expected a .mat file of version 7 or earlier, got one of 7.3: save it {_TO_STRUCT}"
        ) from None
    except Exception as error:  # SciPy's reader raises errors of many types for damaged files
        raise InputError(f"{where}: expected a .mat file, got one that cannot be read: {one_line(error)}") from None
    fields = {name: value for name, value in content.items() if not name.startswith("__")}
    found = _with_fields(fields)
    if found is None:
        raise InputError(
            f"{where}: expected the fields of cameraParams or stereoParams, got {listed(fields) or 'an object'}: save "
            f"objects as structs, {_TO_STRUCT}"
        )
    if "CameraParameters1" not in found:
        return _one_camera("MATLAB", _matrix(where, found), _coefficients(where, found), _size(where, found))
    document: dict[str, Any] = {FORMAT: "MATLAB"}
    for number in (1, 2):
        camera = found.get(f"CameraParameters{number}")
        if not isinstance(camera, Mapping):
            raise InputError(f"{where}: CameraParameters{number}: expected a struct, got {shown(camera)}")
        document[f"K{number}"], document[f"D{number}"] = _matrix(where, camera), _coefficients(where, camera)
        document |= _size(where, camera)
    pose = found.get("PoseCamera2")
    if isinstance(pose, Mapping):
        document["R"], document["T"] = (
            _numbers(where, "R", pose.get("R"), 9),
            _numbers(where, "T", pose.get("Translation"), 3),
        )
    else:
        rotation = _numbers(where, "RotationOfCamera2", found.get("RotationOfCamera2"), 9)
        document["R"] = np.reshape(rotation, (3, 3)).T.ravel().tolist()
        document["T"] = _numbers(where, "TranslationOfCamera2", found.get("TranslationOfCamera2"), 3)
    return document


def is_flat(document: Mapping[str, Any]) -> bool:
    """Whether a document has the fields fx, fy, cx and cy, which RealSense calls ppx and ppy."""
    return all(as_number(document.get(name)) is not None for name in _FLAT) or (
        all(as_number(document.get(name)) is not None for name in ("fx", "fy", *_REALSENSE)) and "cx" not in document
    )


def flat_document(where: str, document: Mapping[str, Any]) -> dict[str, Any]:
    """Convert a document with fx, fy, cx, cy, and where known width, height and k1, k2, p1, p2, k3."""
    document = {_REALSENSE.get(name, name): value for name, value in document.items()}
    fx, fy, cx, cy = (document[name] for name in _FLAT)
    coefficients = document.get("coeffs", [document.get(name, 0.0) for name in _COEFFICIENTS])
    matrix, lens = [fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0], [] if coefficients in ([0.0] * 5, None) else coefficients
    return _one_camera("fx, fy, cx, cy", matrix, lens, _stated_size(document))


def is_matrix(document: Mapping[str, Any]) -> bool:
    """Whether a document has an intrinsic matrix as three rows, as scripts about OpenCV write it."""
    name = next((name for name in _MATRICES if name in document), None)
    if name is None or (name in _ALSO_ROS and any(size in document for size in ("image_width", "width"))):
        return False
    rows = document[name]
    return isinstance(rows, list) and len(rows) == 3 and all(isinstance(row, list) and len(row) == 3 for row in rows)


def matrix_document(where: str, document: Mapping[str, Any]) -> dict[str, Any]:
    """Convert a document with a matrix in rows; of two numbers of its size, the larger one is the width.

    It is the height where the principal point would be outside the image. InputError names a wrong field.
    """
    name = next(name for name in _MATRICES if name in document)
    matrix = take_numbers(where, name, [value for row in document[name] for value in row], 9)
    lens: Any = next((document[name] for name in _DISTORTIONS if document.get(name) is not None), [])
    if isinstance(lens, list) and all(isinstance(row, list) for row in lens):
        lens = [value for row in lens for value in row]
    sizes = _stated_size(document)
    field = next((field for field in _SIZES if field in document), None)
    if field is not None:
        height, width = sorted(take_numbers(where, field, document[field], 2))
        upright = matrix[2] < width and matrix[5] < height
        sizes = {"image_width": width if upright else height, "image_height": height if upright else width}
    return _one_camera("matrix and distortion", matrix, lens, sizes)


def _stated_size(document: Mapping[str, Any]) -> dict[str, Any]:
    """Return what a document states of width and height, None for what it does not."""
    return {f"image_{name}": document.get(name, document.get(f"image_{name}")) for name in ("width", "height")}


def _one_camera(kind: str, matrix: Any, lens: Any, sizes: Mapping[str, Any]) -> dict[str, Any]:
    """Return the converted document of one camera, without sizes that are None."""
    known = {name: value for name, value in sizes.items() if value is not None}
    whole = {"rows": 3, "cols": 3, "dt": "d", "data": matrix}
    return {FORMAT: kind, "camera_matrix": whole, "distortion_coefficients": lens, **known}


def is_colmap(text: str) -> bool:
    """Whether a text is COLMAP's cameras.txt."""
    return _COLMAP.search(text) is not None


def colmap_document(where: str, text: str) -> dict[str, Any]:
    """Convert COLMAP's cameras.txt of one camera, which counts pixels from their corners; InputError for others."""
    found = _COLMAP.findall(text)
    if len(found) > 1:
        raise InputError(f"{where}: expected one camera, got {len(found)}: leave the others out")
    model, width, height, rest = found[0]
    if model not in _COLMAP_MODELS:
        raise InputError(f"{where}: model: expected one of {', '.join(_COLMAP_MODELS)}, got {shown(model)}")
    names = _COLMAP_MODELS[model]
    values = dict(zip(names, take_numbers(where, model, rest.split(), len(names)), strict=True))
    focal = values.get("f")
    known = {} if focal is None else {"fx": focal, "fy": focal}
    centre = {"cx": values["cx"] - 0.5, "cy": values["cy"] - 0.5, "width": int(width), "height": int(height)}
    return flat_document(where, {**values, **known, **centre}) | {FORMAT: f"COLMAP {model}"}


def is_scene(document: Mapping[str, Any]) -> bool:
    """Whether a document is BOP's scene_camera.json: images by number, with ``cam_K``."""
    return bool(document) and all(isinstance(entry, Mapping) and "cam_K" in entry for entry in document.values())


def scene_document(where: str, document: Mapping[str, Any]) -> dict[str, Any]:
    """Convert BOP's scene_camera.json, of which the first image counts; the images have no distortion."""
    return _one_camera("BOP scene_camera", next(iter(document.values()))["cam_K"], [], {})


MAPPINGS: Final = ((is_flat, flat_document), (is_matrix, matrix_document), (is_scene, scene_document))
"""Kinds of documents of plain values, each as whether a document is of it, and its conversion."""


def _with_fields(content: Mapping[str, Any]) -> Mapping[str, Any] | None:
    """Return the struct that has the fields of a camera or a pair: the content, or one in it; None without one."""
    known = {"CameraParameters1", "IntrinsicMatrix", "K"}
    structs = [content, *(value for value in content.values() if isinstance(value, Mapping))]
    return next((struct for struct in structs if known & struct.keys()), None)


def _matrix(where: str, camera: Mapping[str, Any]) -> list[float]:
    """Return the intrinsic matrix of a struct, row by row, for pixels that are counted from 0."""
    name, entry = take_field(where, camera, ("K", "IntrinsicMatrix"))
    matrix: Float64 = np.reshape(_numbers(where, name, entry, 9), (3, 3))
    matrix = matrix.T if matrix[2, 0] or matrix[2, 1] else matrix
    return (matrix - np.array([[0, 0, 1], [0, 0, 1], [0, 0, 0]])).ravel().tolist()  # type: ignore[no-any-return]


def _coefficients(where: str, camera: Mapping[str, Any]) -> list[float]:
    """Return the distortion of a struct in OpenCV's order."""
    radial = _numbers(where, "RadialDistortion", camera.get("RadialDistortion"))
    p1, p2 = _numbers(where, "TangentialDistortion", camera.get("TangentialDistortion"), 2)
    k1, k2, k3 = (*radial, 0.0, 0.0, 0.0)[:3]
    return [k1, k2, p1, p2, k3]


def _size(where: str, camera: Mapping[str, Any]) -> dict[str, Any]:
    """Return width and height of a struct's images; nothing if they are not stated."""
    if np.size(camera.get("ImageSize", [])) != 2:
        return {}
    height, width = _numbers(where, "ImageSize", camera.get("ImageSize"), 2)
    return {"image_width": width, "image_height": height}


def _numbers(where: str, name: str, entry: Any, count: int | None = None) -> list[float]:
    """Return the numbers of an array, row by row."""
    values = entry.ravel().tolist() if isinstance(entry, np.ndarray) else entry
    return take_numbers(where, name, values, count)
