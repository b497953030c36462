"""Masks and images, from PNG or JPEG files to arrays.

The header is read first, by hand: a file that claims more than 100 megapixels is refused before any memory is taken
for it. Turning by EXIF is not done: pixels are the camera's, as stored.
"""

from __future__ import annotations

import math
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.camera import Camera
from dvrk_cmaes.errors import InputError
from dvrk_cmaes.io.files import read_bytes
from dvrk_cmaes.io.image_header import MOST_PIXELS, ImageHeader, read_header

_LARGEST = 400_000_000  # bytes
_THRESHOLD = 127


def read_mask(
    path: str | Path, *, label: int | None = None, pick: tuple[float, float] | None = None
) -> NDArray[np.bool_]:
    """Read an instrument mask.

    Parameters
    ----------
    path
        8-bit grey image, or colour with equal channels; above 127 is instrument.
    label
        The file is a mask of labels: instrument is where a pixel has just this value, 0 to 255.
    pick
        Pixel (u, v): only the connected component there, corners touching included, is kept.

    Returns
    -------
    (H, W) bool
        True on the instrument; neither empty nor full.

    Raises
    ------
    InputError
        Naming the file and what was expected.
    """
    grey = _read_grey(path, "a mask", values=label is not None)
    if label is None:
        mask = grey > _THRESHOLD
        missing = f"expected pixels above {_THRESHOLD} on the instrument, got none (the largest value is {grey.max()}"
        missing += "; is it a mask of labels?)" if 0 < grey.max() <= _THRESHOLD else ")"
    else:
        mask = grey == label
        found = [str(value) for value in np.unique(grey)]
        missing = f"expected pixels of label {label}, got only {', '.join(found[:8])}{', ...' if found[8:] else ''}"
    if not mask.any():
        raise InputError(f"{path}: mask is empty: {missing}")
    if mask.all():
        raise InputError(f"{path}: mask is full: expected background around the instrument, got none")
    return mask if pick is None else _component(path, mask, pick)


def read_ignore(path: str | Path) -> NDArray[np.bool_]:
    """Read the pixels that count neither way, (H, W) bool: 8-bit, above 127; may be empty. InputError as a mask's."""
    return np.asarray(_read_grey(path, "a mask of ignored pixels") > _THRESHOLD)


def read_image(path: str | Path, *, halved: bool = False) -> NDArray[np.uint8]:
    """Read an image as (H, W, 3) uint8, BGR; grey is expanded. InputError if it cannot be.

    ``halved``: at half its size, which for a JPEG is decoded in a third of the time.
    """
    data, _ = _read_file(path, "an image")
    colour = cv2.IMREAD_REDUCED_COLOR_2 if halved else cv2.IMREAD_COLOR
    return _decode(path, data, "an image", colour | cv2.IMREAD_IGNORE_ORIENTATION)


def match_size(camera: Camera, shape: tuple[int, int], what: str = "mask") -> tuple[Camera, str | None]:
    """Fit a camera to the size of a mask or an image.

    Parameters
    ----------
    camera
        As calibrated.
    shape
        Height and width in pixels.
    what
        How messages call what has that size.

    Returns
    -------
    Camera, str or None
        The camera at that size, and a line that says so if it had to be rescaled.

    Raises
    ------
    InputError
        The aspects differ by more than 0.5 %: it is cropped, or another camera's.
    """
    height, width = shape
    if (width, height) == (camera.width, camera.height):
        return camera, None
    sizes = f"{width} x {height}", f"{camera.width} x {camera.height}"
    if abs(width * camera.height / (height * camera.width) - 1) > 0.005:
        raise InputError(f"{what}: expected the calibration's size {sizes[1]}, or one of that aspect, got {sizes[0]}")
    note = f"the {what} is {sizes[0]}, the calibration {sizes[1]}: intrinsics rescaled by {width / camera.width:.4g}"
    return camera.scaled(width, height), note


def _read_file(path: str | Path, what: str) -> tuple[bytes, ImageHeader]:
    """Read the bytes and the header of a PNG or JPEG of a bearable size."""
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
    try:
        pixels = cv2.imdecode(np.frombuffer(data, np.uint8), flags)
    except cv2.error:
        pixels = None
    if pixels is None:
        raise InputError(f"{path}: expected {what} (PNG or JPEG), got one that is damaged")
    return np.asarray(pixels, np.uint8)


def _read_grey(path: str | Path, what: str, *, values: bool = False) -> NDArray[np.uint8]:
    """Read an 8-bit image of one channel, or of equal ones, (H, W); ``values``: they must be the file's very own."""
    data, header = _read_file(path, what)
    if values and header.palette:
        raise InputError(f"{path}: label: expected a mask of labels in plain grey, got one with a palette")
    if header.bits != 8:
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
    """Keep the connected component of a mask at a pixel."""
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
