"""The camera or rig that a session calibration used, in the formats of camera files that are read."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

import cv2
import numpy as np
from msgspec import Struct

from dvrk_cmaes.camera import View
from dvrk_cmaes.camera.rig import ViewDocument
from dvrk_cmaes.camera.ros import view_info_text
from dvrk_cmaes.errors import InputError
from dvrk_cmaes.export.request import Exported, ExportRequest
from dvrk_cmaes.io.typed_document import convert_document
from dvrk_cmaes.io.yaml_file import yaml_text

_ALONE: Final = "camera"  # name of the only camera's files


class _SessionOfCamera(Struct):
    """Fields of session.json."""

    views: tuple[ViewDocument, ...] = ()


def exported(request: ExportRequest) -> Exported:
    """Export the cameras of a session calibration.

    Lengths are in metres, images raw.

    Raises
    ------
    InputError
        There is no calibration, or it does not state its cameras, or a field is wrong.
    """
    where, document = request.source.calibration()
    views = [each.restored() for each in convert_document(where, document, _SessionOfCamera).views]
    if not views:
        raise InputError(f"{where}: views: expected the cameras that were used, got none: calibrate the session again")
    names = [view.name for view in views] if len(views) > 1 else [_ALONE]
    files = {f"ros/{name}.yaml": view_info_text(view, name) for name, view in zip(names, views, strict=True)}
    files[f"opencv/{'stereo' if len(views) > 1 else _ALONE}.xml"] = _storage(views)
    notes: tuple[str, ...] = ("plain YAML has no fisheye lenses: left out",)
    if all(view.camera.model != "equidistant" for view in views):
        notes, files = (), files | {f"plain/{name}.yaml": _plain(view) for name, view in zip(names, views, strict=True)}
    return Exported({name: text.encode() for name, text in files.items()}, notes=notes)


def _is_first(view: View) -> bool:
    """Return whether a view is the first one of its rig."""
    return bool(np.array_equal(view.view_from_camera, np.eye(4)))


def _plain(view: View) -> str:
    """Return a plain YAML file."""
    document: dict[str, Any] = {"intrinsic": view.camera.matrix.tolist(), "distortion": list(view.camera.distortion)}
    if not _is_first(view):
        document["right_from_left"] = view.view_from_camera.tolist()
    return yaml_text(document)


def _storage(views: Sequence[View]) -> str:
    """Return an OpenCV FileStorage in XML of one camera or a stereo pair."""
    first, *others = views
    storage = cv2.FileStorage("cameras.xml", cv2.FILE_STORAGE_WRITE | cv2.FILE_STORAGE_MEMORY)
    storage.write("image_width", first.camera.width)
    storage.write("image_height", first.camera.height)
    if any(view.camera.model == "equidistant" for view in views):
        storage.write("fisheye_model", 1)
    for number, view in enumerate(views, start=1):
        matrix, lens = (f"M{number}", f"D{number}") if others else ("camera_matrix", "distortion_coefficients")
        storage.write(matrix, view.camera.matrix)
        storage.write(lens, np.array([view.camera.distortion or (0.0,) * 5]))
    for view in others:
        storage.write("R", np.ascontiguousarray(view.view_from_camera[:3, :3]))
        storage.write("T", np.ascontiguousarray(view.view_from_camera[:3, 3:]))
    return storage.releaseAndGetString()
