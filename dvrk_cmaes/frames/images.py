"""Reader of masks and images from PNG or JPEG files.

The header is parsed before the image is decoded: a file whose header states more than 36 megapixels is refused before
memory is allocated for it. An EXIF orientation is ignored, so that pixels are those of the camera, as stored.
"""

from __future__ import annotations

import math
import re
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.camera import Camera
from dvrk_cmaes.errors import InputError
from dvrk_cmaes.io.files import read_bytes
from dvrk_cmaes.io.image_header import MOST_PIXELS, ImageHeader, read_header
from dvrk_cmaes.io.quiet_stderr import native_messages

_LARGEST = 400_000_000  # bytes
_THRESHOLD = 127
_ASPECT, _ROUNDED_ASPECT = 0.005, 0.02  # by which the aspects of mask and calibration may differ, as a share
# libjpeg's words for data that it had to make up; other bytes before a marker are skipped without a loss
_LOST = re.compile(r"Corrupt JPEG data(?!: \d+ extraneous bytes)|Premature end of JPEG")


def read_mask(
    path: str | Path,
    *,
    label: int | None = None,
    pick: tuple[float, float] | None = None,
    blank: bool = False,
) -> NDArray[np.bool_]:
    """Read an instrument mask.

    Parameters
    ----------
    path
        Grey image of 8 bits or of 1, or colour image with equal channels; values above 127 are instrument.
    label
        For a mask of labels: the value, 0 to 255, of the instrument's pixels.
    pick
        A pixel (u, v): only its 8-connected component of the mask is returned.
    blank
        Accept a mask that is empty or full, as in images of a recording in which the instrument is not in view.

    Returns
    -------
    (H, W) bool
        True on the instrument; neither all False nor all True unless ``blank``.

    Raises
    ------
    InputError
        The file is not a valid mask; the message names the file and what was expected.
    """
    grey = _read_grey(path, "a mask", values=label is not None)
    if label is None:
        mask = grey > _THRESHOLD
        missing = f"expected pixels above {_THRESHOLD} on the instrument, got none (the largest value is {grey.max()}"
        missing += "; is it a mask of labels?)" if 0 < grey.max() <= _THRESHOLD else ")"
    else:
        mask = grey == label
        values = [str(value) for value in np.unique(grey)]
        missing = f"expected pixels of label {label}, got only {', '.join(values[:8])}{', ...' if values[8:] else ''}"
    if blank and (mask.all() or not mask.any()):
        return np.asarray(mask)
    if not mask.any():
        raise InputError(f"{path}: mask is empty: {missing}")
    if mask.all():
        raise InputError(f"{path}: mask is full: expected background around the instrument, got none")
    return mask if pick is None else _component(path, mask, pick)


def read_ignore(path: str | Path) -> NDArray[np.bool_]:
    """Read a mask of ignored pixels, (H, W) bool: True where the 8-bit value is above 127; it may be empty.

    Raises
    ------
    InputError
        The file is not an 8-bit grey image.
    """
    return np.asarray(_read_grey(path, "a mask of ignored pixels") > _THRESHOLD)


def read_image(path: str | Path, *, halved: bool = False) -> NDArray[np.uint8]:
    """Read an image as (H, W, 3) uint8, BGR; a grey image is converted.

    With ``halved``, the image is decoded at half its size, which takes a third of the time for a JPEG.

    Raises
    ------
    InputError
        The file is not a PNG or JPEG that can be decoded.
    """
    data, _ = _read_file(path, "an image")
    colour = cv2.IMREAD_REDUCED_COLOR_2 if halved else cv2.IMREAD_COLOR
    return _decode(path, data, "an image", colour | cv2.IMREAD_IGNORE_ORIENTATION)


def match_size(camera: Camera, shape: tuple[int, int], what: str = "mask") -> tuple[Camera, str | None]:
    """Rescale a camera's intrinsics to the size of a mask or an image.

    Parameters
    ----------
    camera
        The calibrated camera.
    shape
        Height and width in pixels.
    what
        Name of the mask or image in messages.

    Returns
    -------
    Camera, str or None
        The camera of that size, and a note if its intrinsics were rescaled.

    Raises
    ------
    InputError
        The aspect ratios differ by more than 0.5 %, or 2 % where a size was rounded to whole pixels: the image is
        cropped or of another camera.
    """
    height, width = shape
    if (width, height) == (camera.width, camera.height):
        return camera, None
    sizes = f"{width} x {height}", f"{camera.width} x {camera.height}"
    across, down = width / camera.width, height / camera.height
    off = abs(across / down - 1)
    rounded = min(abs(width - down * camera.width), abs(height - across * camera.height)) <= 0.5
    if off > (_ROUNDED_ASPECT if rounded else _ASPECT):
        raise InputError(f"{what}: expected the calibration's size {sizes[1]}, or one of that aspect, got {sizes[0]}")
    note = f"the {what} is {sizes[0]}, the calibration {sizes[1]}: intrinsics rescaled by {width / camera.width:.4g}"
    scaled = camera.scaled(width, height)
    return replace(scaled, remarks=(*camera.remarks, note)), note


def _read_file(path: str | Path, what: str) -> tuple[bytes, ImageHeader]:
    """Read the bytes and the header of a PNG or JPEG of at most `MOST_PIXELS` pixels."""
    expected = f"{what} (PNG or JPEG)"
    data = read_bytes(path, expected=expected, largest=_LARGEST)
    header = read_header(data)
    if header is None:
        raise InputError(f"{path}: expected {expected}, got something else or a damaged file")
    if header.width * header.height > MOST_PIXELS:
        raise InputError(
            f"{path}: expected at most {MOST_PIXELS // 1_000_000} megapixels, got {header.width} x {header.height}"
        )
    if not header.whole:
        raise InputError(f"{path}: expected {expected}, got one that is cut off or damaged")
    return data, header


def _decode(path: str | Path, data: bytes, what: str, flags: int) -> NDArray[np.uint8]:
    """Decode an image with OpenCV's flags; InputError if it cannot be decoded."""
    try:
        with native_messages() as messages:
            pixels = cv2.imdecode(np.frombuffer(data, np.uint8), flags)
    except cv2.error:
        pixels = None
    if pixels is None or any(_LOST.search(message) for message in messages):
        raise InputError(f"{path}: expected {what} (PNG or JPEG), got one that is damaged")
    return np.asarray(pixels, np.uint8)


def _read_grey(path: str | Path, what: str, *, values: bool = False) -> NDArray[np.uint8]:
    """Read a grey image (H, W) of 8 bits or of 1, or one with equal channels.

    With ``values``, palettes and single bits are refused.
    """
    data, header = _read_file(path, what)
    if values and header.palette:
        raise InputError(f"{path}: label: expected a mask of labels in plain grey, got one with a palette")
    if header.bits != 8 and (header.bits, values) != (1, False):  # of one bit, OpenCV makes 0 and 255
        raise InputError(f"{path}: not 8-bit: expected {what} of 8 bits a pixel, got {header.bits} bits")
    pixels = _decode(path, data, what, cv2.IMREAD_UNCHANGED)
    if pixels.ndim == 2:
        return pixels
    grey = pixels[:, :, 0]
    if any(not np.array_equal(grey, pixels[:, :, k]) for k in range(1, min(pixels.shape[2], 3))):
        raise InputError(f"{path}: expected {what} in grey, got a colour image")
    if pixels.shape[2] == 4 and pixels[:, :, 3].min() < 255:
        raise InputError(f"{path}: expected {what} in grey, got an image with transparency")
    return np.ascontiguousarray(grey)


def _component(path: str | Path, mask: NDArray[np.bool_], pick: tuple[float, float]) -> NDArray[np.bool_]:
    """Return the 8-connected component of a mask at a pixel (u, v); InputError if the pixel is not in the mask."""
    height, width = mask.shape
    if not (math.isfinite(pick[0]) and math.isfinite(pick[1])):
        raise InputError(f"{path}: pick: expected two finite numbers u,v in pixels, got {pick[0]},{pick[1]}")
    u, v = round(pick[0]), round(pick[1])
    if not (0 <= u < width and 0 <= v < height):
        raise InputError(f"{path}: pick: expected a pixel of the {width} x {height} mask, got {u},{v}")
    if not mask[v, u]:
        raise InputError(f"{path}: pick: expected a pixel on the instrument, got background at {u},{v}")
    _, components = cv2.connectedComponents(mask.astype(np.uint8), connectivity=8)
    return np.asarray(components == components[v, u])
