"""Convert EndoVis' camera_calibration.txt to a document with the names of OpenCV's stereo files."""

from __future__ import annotations

import re
from typing import Any

import numpy as np

from dvrk_cmaes.camera.document import FORMAT
from dvrk_cmaes.camera.fields import take_field, take_numbers
from dvrk_cmaes.geometry import exp_rotation

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
