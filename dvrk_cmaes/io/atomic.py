"""Write files atomically: to a temporary file beside the target, which is then renamed."""

from __future__ import annotations

import contextlib
import errno
import json
import os
import uuid
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.errors import DvrkCmaesError, InputError

# errors that do not depend on the path; EFBIG: the limit on the size of files (ulimit -f)
_MACHINE_AT_FAULT = (errno.ENOSPC, errno.EDQUOT, errno.EIO, errno.EFBIG)


def write_bytes(path: str | Path, data: bytes) -> None:
    """Write a file, creating the folders above it; an existing file is replaced once the new one is complete.

    Raises
    ------
    InputError
        The path cannot be written to.
    DvrkCmaesError
        The disk is full or failing.
    """
    target = Path(path)
    beside = target.with_name(f".{uuid.uuid4().hex}.tmp")
    try:
        made = [folder for folder in (target.parent, *target.parent.parents) if not folder.exists()]
        target.parent.mkdir(parents=True, exist_ok=True)
        try:
            with open(beside, "xb") as file:
                file.write(data)
            os.replace(beside, target)
        except BaseException:
            with contextlib.suppress(OSError):
                beside.unlink()
            for folder in made:
                with contextlib.suppress(OSError):  # another process may have written there since
                    folder.rmdir()
            raise
    except (OSError, ValueError) as error:  # ValueError: a null character in the name
        raise not_written(path, error, "a file") from None


def not_written(path: str | Path, error: OSError | ValueError, what: str) -> DvrkCmaesError:
    """Return the error of a path that was not written: `InputError`, or `DvrkCmaesError` if the machine is at fault."""
    if isinstance(error, ValueError):
        return InputError(f"{str(path)!r}: not written ({error}); expected a place to write {what}")
    kind = DvrkCmaesError if error.errno in _MACHINE_AT_FAULT else InputError
    reason = "a file lies where a folder is wanted" if isinstance(error, FileExistsError) else error.strerror
    return kind(f"{path}: not written ({reason}); expected a place to write {what}")


@contextlib.contextmanager
def places_to_write(path: str | Path, what: str) -> Iterator[None]:
    """Raise the error of ``not_written`` for errors of the system in the block, which looks at or writes to a path."""
    try:
        yield
    except (OSError, ValueError) as error:  # ValueError: a null character in the name
        raise not_written(path, error, what) from None


@contextlib.contextmanager
def written_beside(path: Path, what: str) -> Iterator[Path]:
    """Give a path beside a target, of the same extension, for a program that writes files itself.

    Its file is renamed to the target at the end, or removed after an error. ``what`` is named in messages. Errors are
    those of ``write_bytes``.
    """
    beside = path.with_name(f".{uuid.uuid4().hex}{path.suffix}")
    try:
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise not_written(path, error, what) from None
        yield beside
        try:
            os.replace(beside, path)
        except OSError as error:
            raise not_written(path, error, what) from None
    finally:
        with contextlib.suppress(OSError):
            beside.unlink()


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


def write_image(path: str | Path, image: NDArray[np.uint8] | NDArray[np.bool_], *, quality: int | None = None) -> None:
    """Write an image in the format of its extension; images and errors as in ``encoded_image`` and ``write_bytes``."""
    write_bytes(path, encoded_image(path, image, quality=quality))


def encoded_image(
    path: str | Path, image: NDArray[np.uint8] | NDArray[np.bool_], *, quality: int | None = None
) -> bytes:
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
