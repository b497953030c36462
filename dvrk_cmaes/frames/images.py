"""Reader of masks and images from PNG or JPEG files.

The header is parsed before the image is decoded: a file whose header states more than 36 megapixels is refused before
memory is allocated for it. An EXIF orientation is ignored, so that pixels are those of the camera, as stored.
"""

from __future__ import annotations

import math
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import simplejpeg
from numpy.typing import NDArray

from dvrk_cmaes.camera import Camera
from dvrk_cmaes.errors import InputError
from dvrk_cmaes.frames.coco_mask import read_coco_mask
from dvrk_cmaes.frames.label import ANY, Label, LabelText, named, parse_label, selected
from dvrk_cmaes.frames.label import EXPECTED as LABEL
from dvrk_cmaes.geometry import Bool
from dvrk_cmaes.io.files import read_bytes
from dvrk_cmaes.io.image_header import ImageHeader, checked_header, checked_png, palette_as_grey
from dvrk_cmaes.io.short_text import shown

_LARGEST = 400_000_000  # bytes
THRESHOLD = 127  # above which a mask is instrument
_MOST_OF_EDGE, _MOST_OF_IMAGE = 0.7, 0.6  # shares in a mask from which on it is taken for an inverted one
MOST_LABELS = 16
_SOFT, _SHARP_SHARE = 40, 0.98  # so near to 0 or 255, for JPEG's compression, is at least this share of a mask
_PLACES = np.array([1, 256, 65536])  # of the channels of a colour in its number
_ASPECT, _ROUNDED_ASPECT = 0.005, 0.02  # by which the aspects of mask and calibration may differ, as a share
_SKIPPED = re.compile(r"Corrupt JPEG data: \d+ extraneous bytes")  # libjpeg's words for bytes skipped without a loss


def read_mask(
    path: str | Path,
    *,
    label: LabelText | None = None,
    pick: tuple[float, float] | None = None,
    blank: bool = False,
    name: str | None = None,
) -> Bool:
    """Read an instrument mask.

    Parameters
    ----------
    path
        Grey image of 8 bits or of 1, or colour image with equal channels; values above 127 are instrument. Or JSON with
        polygons or runs, as of `coco_mask`.
    label
        For a mask of labels: what selects the instrument's pixels, as in `label`. Of an image with a palette, the index
        counts.
    pick
        A pixel (u, v): only its 8-connected component of the mask is returned.
    blank
        Accept a mask that is empty or full, as in images of a recording in which the instrument is not in view.
    name
        Name of the frame, for a file with the masks of many.

    Returns
    -------
    (H, W) bool
        True on the instrument; neither all False nor all True unless ``blank``.

    Raises
    ------
    InputError
        The file is not a valid mask; the message names the file and what was expected.
    """
    if Path(path).suffix.lower() == ".json":
        kinds = None if label is None else frozenset(map(str, [label] if isinstance(label, int | str) else label))
        mask = read_coco_mask(Path(path), name, kinds)
        missing = "expected annotations of the instrument, got none"
    elif label is None:
        grey = _read_grey(path, "a mask")
        mask = grey > THRESHOLD
        missing = f"expected pixels above {THRESHOLD} on the instrument, got none (the largest value is {grey.max()}"
        missing += "; of labels, say which: --label 1, or --label any)" if 0 < grey.max() <= THRESHOLD else ")"
    else:
        wanted = parse_label(f"{path}: label", label)
        values = _read_labels(path, wanted)
        mask = selected(values, wanted)
        missing = f"expected pixels of label {', '.join(map(str, wanted))}, got only {named(values)}"
    if blank and (mask.all() or not mask.any()):
        return np.asarray(mask)
    if not mask.any():
        raise InputError(f"{path}: mask is empty: {missing}")
    if mask.all():
        raise InputError(f"{path}: mask is full: expected background around the instrument, got none")
    if label is None and not mask.all() and _is_inverted(mask):
        raise InputError(
            f"{path}: mask is inverted: expected pixels above {THRESHOLD} on the instrument, got most of the edge and "
            f"{mask.mean():.0%} of the image: --label 0 takes the pixels of value 0 for the instrument"
        )
    return mask if pick is None else _component(path, mask, pick)


def read_ignore(path: str | Path) -> Bool:
    """Read a mask of ignored pixels, (H, W) bool: True where the 8-bit value is above 127; it may be empty.

    Raises
    ------
    InputError
        The file is not an 8-bit grey image.
    """
    return np.asarray(_read_grey(path, "a mask of ignored pixels") > THRESHOLD)


def read_image(path: str | Path) -> NDArray[np.uint8]:
    """Read an image as (H, W, 3) uint8, BGR; a grey image is converted.

    Raises
    ------
    InputError
        The file is not a PNG or JPEG that can be decoded.
    """
    data, _ = read_image_file(path, "an image")
    return decode_image(path, data, "an image", cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION)


def looks_like_mask(pixels: NDArray[np.uint8]) -> bool:
    """Whether a picture (H, W, 3) has few colours, as labels have, or is grey and almost only black and white."""
    if not (pixels == pixels[:, :, :1]).all():
        flat = pixels.reshape(-1, 3)  # of a few of whose pixels an image mostly has more colours already
        return all(len(np.unique(some @ _PLACES)) <= MOST_LABELS for some in (flat[::101], flat))
    counts = np.bincount(pixels[:, :, 0].ravel(), minlength=256)
    sharp = counts[:_SOFT].sum() + counts[-_SOFT:].sum() >= _SHARP_SHARE * counts.sum()
    return bool((sharp and counts[THRESHOLD + 1 :].any()) or 1 < np.count_nonzero(counts) <= MOST_LABELS)


def match_size(
    camera: Camera, shape: tuple[int, ...], what: str = "mask", where: str = ""
) -> tuple[Camera, str | None]:
    """Rescale a camera's intrinsics to the size of a mask or an image.

    Parameters
    ----------
    camera
        The calibrated camera.
    shape
        Height and width in pixels.
    what
        Name of the mask or image in messages.
    where
        Beginning of messages.

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
        raise InputError(
            f"{where}{what}: expected the calibration's size {sizes[1]}, or one of that aspect, got {sizes[0]} "
            "(--crop x,y,w,h for a part of the picture, --stretch for one that was resized unevenly; of a session, "
            "crop or stretch of [camera] in session.toml)"
        )
    note = f"the {what} is {sizes[0]}, the calibration {sizes[1]}: intrinsics rescaled by {width / camera.width:.4g}"
    scaled = camera.scaled(width, height)
    return replace(scaled, remarks=(*camera.remarks, note)), note


def read_image_file(path: str | Path, what: str) -> tuple[bytes, ImageHeader]:
    """Read the bytes and the header of a whole PNG or JPEG of at most `MOST_PIXELS` pixels."""
    expected = f"{what} (PNG or JPEG)"
    data = read_bytes(path, expected=expected, largest=_LARGEST)
    return data, checked_header(data, str(path), expected)


def decode_image(path: str | Path, data: bytes, what: str, flags: int) -> NDArray[Any]:
    """Decode an image with OpenCV's flags; InputError if it cannot be decoded, or not without a loss.

    The decoders print nothing: OpenCV's own JPEG decoder would print what it had to make up, and only gets those in the
    colours of print, and PNG files without the chunks that do not change their pixels.
    """
    pixels: Any
    try:
        pixels = _decode_jpeg(data, flags) if data.startswith(b"\xff\xd8") else None
        if pixels is None:
            pixels = cv2.imdecode(np.frombuffer(checked_png(data), np.uint8), flags)
    except (cv2.error, ValueError):
        pixels = None
    if pixels is None:
        raise InputError(f"{path}: expected {what} (PNG or JPEG), got one that is damaged")
    return np.asarray(pixels)


def _decode_jpeg(data: bytes, flags: int) -> Any:
    """Decode a JPEG as OpenCV does, to the last bit; None for one in colours of print, ValueError if it is damaged."""
    _, _, colours, _ = simplejpeg.decode_jpeg_header(data)
    grey = flags == cv2.IMREAD_GRAYSCALE | cv2.IMREAD_IGNORE_ORIENTATION
    wanted = "GRAY" if grey or (flags == cv2.IMREAD_UNCHANGED and colours == "Gray") else "BGR"
    if colours not in ("Gray", "YCbCr", "RGB"):
        simplejpeg.decode_jpeg(data, "CMYK", strict=True)
        return None
    try:
        pixels = simplejpeg.decode_jpeg(data, wanted, strict=True)
    except ValueError as error:
        if not _SKIPPED.search(str(error)):
            raise
        pixels = simplejpeg.decode_jpeg(data, wanted, strict=False)
    return pixels[:, :, 0] if wanted == "GRAY" else pixels


def _is_inverted(mask: Bool) -> bool:
    """Whether a mask (H, W) has most of the image's edge and of its pixels, as no instrument has."""
    edge = np.concatenate([mask[0], mask[-1], mask[:, 0], mask[:, -1]])
    return bool(edge.mean() > _MOST_OF_EDGE and mask.mean() > _MOST_OF_IMAGE)


def _read_labels(path: str | Path, label: Label) -> NDArray[np.integer]:
    """Read the values (H, W) of an image of labels, the indices of one with a palette, or colours (H, W, 3), BGR."""
    what = "a mask of labels"
    name = next((part for part in label if isinstance(part, str) and part != ANY and not part.startswith("#")), None)
    if name is not None:
        raise InputError(f"{path}: label: expected {LABEL}, got {shown(name)} (names are those of categories in JSON)")
    data, header = read_image_file(path, what)
    if any(isinstance(part, str) and part.startswith("#") for part in label):
        if len(label) > 1 and not all(isinstance(part, str) for part in label):
            raise InputError(f"{path}: label: expected either colours or values, got {', '.join(map(str, label))}")
        return decode_image(path, data, what, cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION)
    pixels = decode_image(path, palette_as_grey(data) if header.palette else data, what, cv2.IMREAD_UNCHANGED)
    if pixels.ndim == 2:
        return pixels // (255 // (2**header.bits - 1)) if header.bits < 8 else pixels  # decoded to the range of 8 bits
    colours = pixels[:, :, : min(pixels.shape[2], 3)]
    if (colours == colours[:, :, :1]).all():
        return np.ascontiguousarray(colours[:, :, 0])
    if ANY in label:
        return colours
    raise InputError(
        f"{path}: label: expected a mask of labels in grey or with a palette, got colours: say which, such as "
        f"--label '#00ff00' (there are {named(colours)})"
    )


def _read_grey(path: str | Path, what: str) -> NDArray[np.uint8]:
    """Read a grey image (H, W) of 8 bits or of 1, or one with equal channels."""
    data, header = read_image_file(path, what)
    if header.bits not in (1, 8):  # of one bit, OpenCV makes 0 and 255
        hint = " (--label any takes them)" if what == "a mask" else ""
        raise InputError(f"{path}: not 8-bit: expected {what} of 8 bits a pixel, got {header.bits} bits{hint}")
    pixels = decode_image(path, data, what, cv2.IMREAD_UNCHANGED)
    if pixels.ndim == 2:
        return pixels
    grey = pixels[:, :, 0]
    if any(not np.array_equal(grey, pixels[:, :, k]) for k in range(1, min(pixels.shape[2], 3))):
        labels = header.palette or looks_like_mask(np.ascontiguousarray(pixels[:, :, :3]))
        kind = f"the colours {named(pixels[:, :, :3])}" if labels else "a colour image (--image takes one)"
        hint = ", of labels by --label 1 or '#00ff00' (of a session: label of a [[tool]] in session.toml)"
        hint = hint if labels and what == "a mask" else ""
        raise InputError(f"{path}: expected {what} in grey{hint}, got {kind}")
    if pixels.shape[2] == 4 and pixels[:, :, 3].min() < 255:
        raise InputError(f"{path}: expected {what} in grey, got an image with transparency: save it without")
    return np.ascontiguousarray(grey)


def _component(path: str | Path, mask: Bool, pick: tuple[float, float]) -> Bool:
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
