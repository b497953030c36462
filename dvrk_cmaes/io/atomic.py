"""Write documents and images: each file is complete or as it was before."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.errors import DvrkCmaesError, InputError
from dvrk_cmaes.geometry import Bool
from dvrk_cmaes.io.output import write_bytes


def write_text(path: str | Path, text: str) -> None:
    """Write UTF-8 text; errors as in ``write_bytes``."""
    write_bytes(path, text.encode("utf-8"))


def json_text(obj: Any) -> str:
    """Format an object of plain values as JSON with a final line break; ValueError for a number that is not finite."""
    return json.dumps(obj, indent=1, allow_nan=False, ensure_ascii=False) + "\n"


def write_json(path: str | Path, obj: Any) -> None:
    """Write an object of plain values as JSON; errors as in ``write_bytes``.

    Raises
    ------
    ValueError
        A number is not finite, which JSON cannot represent.
    """
    write_text(path, json_text(obj))


def write_image(path: str | Path, image: NDArray[np.uint8] | Bool, *, quality: int | None = None) -> None:
    """Write an image in the format of its extension; images and errors as in ``encoded_image`` and ``write_bytes``."""
    write_bytes(path, encoded_image(path, image, quality=quality))


def encoded_image(path: str | Path, image: NDArray[np.uint8] | Bool, *, quality: int | None = None) -> bytes:
    """Encode an image in the format of a path's extension.

    Parameters
    ----------
    path
        Path whose extension is .png, .jpg or .jpeg.
    image
        (H, W) grey, (H, W, 3) BGR, or a bool mask (H, W), which is encoded as 0 and 255.
    quality
        Quality of a JPEG, 0 to 100; by default that of OpenCV, 95.

    Raises
    ------
    InputError
        The path has another extension.
    DvrkCmaesError
        The image could not be encoded.
    """
    extension = Path(path).suffix.lower()
    if extension not in (".png", ".jpg", ".jpeg"):
        raise InputError(f"{path}: expected an image's name to end in .png, .jpg or .jpeg, got {extension!r}")
    import cv2  # here, because commands that write no image need not import it

    pixels = np.asarray(image, np.uint8) * (255 if image.dtype == np.bool_ else 1)
    parameters = [] if quality is None or extension == ".png" else [cv2.IMWRITE_JPEG_QUALITY, quality]
    encoded, data = cv2.imencode(extension, pixels, parameters)
    if not encoded:
        raise DvrkCmaesError(f"{path}: the image could not be encoded")
    return data.tobytes()
