"""Read JSON files, and write documents and images: each file is complete or as it was before."""

from __future__ import annotations

import json
import math
import re
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.errors import DvrkCmaesError, InputError
from dvrk_cmaes.geometry import Bool
from dvrk_cmaes.io.files import read_text
from dvrk_cmaes.io.output import write_bytes
from dvrk_cmaes.io.short_text import shown

_LARGEST = 20_000_000  # bytes
_MOST_VALUES = 6_000_000  # commas and opening brackets; empty lists take some 20 times their text in memory
_MOST_DIGITS = 20  # of a whole number
_SUSPECT = re.compile(r"\d{20}|[eE]\+?\d{3}")
_SURROGATE = re.compile(r"\\u[dD][89a-fA-F]")
# strings are matched so that comment marks within them are kept; ends are optional, so that time stays linear
_STRING_OR_COMMENT = re.compile(r'("(?:\\.|[^"\\])*(?:"|\Z))|//[^\n]*|/\*.*?(?:\*/|\Z)', re.DOTALL)


def read_json_object(path: str | Path, *, expected: str, comments: bool = False) -> dict[str, Any]:
    """Read a JSON file whose document is an object.

    Parameters
    ----------
    path
        The file.
    expected
        What the file should be, for messages.
    comments
        Whether comments as in C++ are allowed, which the dVRK's configuration files contain.

    Raises
    ------
    InputError
        The file is not readable, larger than 20 MB, of more than six million values, not JSON, nested too deeply, or
        not an object.
    """
    document = read_json(path, expected=expected, comments=comments)
    if not isinstance(document, dict):
        raise InputError(f"{path}: expected {expected}, got {shown(document)}")
    return document


def read_json(path: str | Path, *, expected: str, comments: bool = False) -> Any:
    """Read a JSON file of any document; parameters and errors as in ``read_json_object``."""
    text = read_text(path, expected=expected, largest=_LARGEST)
    if (values := sum(map(text.count, ",[{"))) > _MOST_VALUES:
        raise InputError(f"{path}: expected {expected}, got {values} values; at most {_MOST_VALUES} are read")
    try:
        return parse_json(_without_comments(text) if comments else text)
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path}: expected {expected}, got no valid JSON ({error})") from None


def parse_json(text: str) -> Any:
    """Parse JSON strictly: ValueError for what JSON does not have, or what other documents could not hold again.

    These are NaN and infinity, also as numbers that are too large, whole numbers of more than 20 digits, and halves of
    surrogate pairs in texts.
    """
    suspect = bool(_SUSPECT.search(text))  # the checks of single numbers take time
    document = json.loads(
        text,
        parse_constant=_refuse_constant,
        parse_float=_finite if suspect else None,
        parse_int=_short if suspect else None,
    )
    if _SURROGATE.search(text):
        try:
            json.dumps(document, ensure_ascii=False).encode()
        except UnicodeEncodeError:
            raise ValueError("half of a surrogate pair in a text") from None
    return document


def _refuse_constant(name: str) -> NoReturn:
    raise ValueError(f"{name} is no number in JSON")


def _finite(text: str) -> float:
    if not math.isfinite(float(text)):
        raise ValueError(f"the number {shown(text)[1:-1]} is too large")
    return float(text)


def _short(text: str) -> int:
    if len(text) > _MOST_DIGITS:
        raise ValueError(f"a whole number of {len(text)} digits is too large")
    return int(text)


def _without_comments(text: str) -> str:
    """Replace comments by blanks; the numbers of lines do not change."""
    return _STRING_OR_COMMENT.sub(lambda match: match[1] or " " + "\n" * match[0].count("\n"), text)


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
