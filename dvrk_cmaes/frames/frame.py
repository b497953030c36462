"""The files of one frame, and what is in them: mask, readings, and if there are any, image and ignored pixels.

`FrameFiles` says where things lie; `read_frame` reads them and checks that they belong together.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from time import perf_counter
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.camera import Camera
from dvrk_cmaes.camera.fields import Size
from dvrk_cmaes.errors import DvrkCmaesError, InputError
from dvrk_cmaes.frames.images import match_size, read_ignore, read_image, read_mask
from dvrk_cmaes.io.files import read_bytes
from dvrk_cmaes.io.image_header import read_header
from dvrk_cmaes.segment import Segmentation
from dvrk_cmaes.segment.field_of_view import outside_view

_LARGEST = 400_000_000  # bytes


@dataclass(frozen=True, eq=False)
class FrameFiles:
    """Where the parts of a frame lie; a frame without a mask has an image that is still to be segmented.

    ``readings`` are by joint, rad or m; ``keypoints`` (2, 2) px are the jaw tips in either order. ``label`` and
    ``pick`` say which part of the mask is the instrument, as in ``read_mask``. ``notes`` say what was decided about
    camera and readings when they were found, ``problem`` why the frame cannot be used: others of its session may be.
    """

    name: str
    mask: Path | None
    readings: Mapping[str, float] = field(default_factory=dict)
    image: Path | None = None
    ignore: Path | None = None
    keypoints: NDArray[np.float64] | None = None
    label: int | None = None
    pick: tuple[float, float] | None = None
    notes: tuple[str, ...] = ()
    problem: str | None = None


@dataclass(frozen=True, eq=False)
class FrameData:
    """A frame in memory.

    ``mask`` and ``ignore`` are (H, W) bool, ``image`` (H', W', 3) uint8 BGR of the mask's aspect; ``camera`` has the
    mask's size. ``notes`` say in words what was done to make the parts fit. Where the mask was found in the image,
    ``segmentation`` is how, and ``segment_seconds`` what that took.
    """

    mask: NDArray[np.bool_]
    camera: Camera
    ignore: NDArray[np.bool_] | None
    image: NDArray[np.uint8] | None
    notes: tuple[str, ...]
    segmentation: Segmentation | None = None
    segment_seconds: float = 0.0


class FindsMask(Protocol):
    """Finds the instrument in an image (H, W, 3) BGR of the camera's size; joints by name, rad or m."""

    def __call__(
        self,
        image: NDArray[np.uint8],
        camera: Camera,
        joints: Mapping[str, float],
        ignore: NDArray[np.bool_] | None = None,
    ) -> Segmentation:
        """Return the mask; errors as in `dvrk_cmaes.segment.with_instrument.segment_with_instrument`."""


def read_frame(files: FrameFiles, camera: Camera, segmenter: FindsMask | None = None) -> FrameData:
    """Read a frame taken by a camera, whose intrinsics are rescaled where the frame is of another size.

    A frame without a mask is handed to the ``segmenter``.

    Raises
    ------
    InputError
        A file that cannot be read, or of a size that does not fit the others: names the file. No mask, and no image or
        no segmenter to find one in it.
    DvrkCmaesError
        No instrument was found in the image: names the file.
    """
    if files.problem is not None:
        raise InputError(files.problem)
    if files.mask is not None:
        mask = read_mask(files.mask, label=files.label, pick=files.pick)
        fitted, notes = _fit(camera, mask.shape, files.mask, "mask")
        ignore = _ignored(files, mask.shape, "mask")
        image = None if files.image is None else read_image(files.image)
        if image is not None and abs(image.shape[1] * mask.shape[0] / (image.shape[0] * mask.shape[1]) - 1) > 0.005:
            raise InputError(
                f"{files.image}: expected the mask's size {_size(mask.shape)}, or one of that aspect, "
                f"got {_size(image.shape)}"
            )
        return FrameData(mask, fitted, ignore, image, (*files.notes, *notes))
    if files.image is None or segmenter is None:
        raise InputError(f"frame {files.name}: expected a mask, got {files.image or 'neither mask nor image'}")
    image = read_image(files.image)
    fitted, notes = _fit(camera, image.shape, files.image, "image")
    ignore = _ignored(files, image.shape, "image")
    outside = outside_view(image)
    if outside.any():
        ignore = outside if ignore is None else ignore | outside
        notes = (*notes, "the image is a round picture in black: what is outside of it is ignored")
    started = perf_counter()
    try:
        found = segmenter(image, fitted, files.readings, ignore)
    except DvrkCmaesError as error:
        raise type(error)(f"{files.image}: {error}") from None
    seconds = perf_counter() - started
    return FrameData(found.mask, fitted, ignore, image, (*files.notes, *notes, *found.notes), found, seconds)


def _fit(camera: Camera, shape: tuple[int, ...], path: Path | None, what: str) -> tuple[Camera, tuple[str, ...]]:
    """Fit a camera to the size of a file's picture."""
    try:
        fitted, note = match_size(camera, (shape[0], shape[1]), what)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
    return fitted, () if note is None else (note,)


def _ignored(files: FrameFiles, shape: tuple[int, ...], what: str) -> NDArray[np.bool_] | None:
    """Read the pixels that count neither way."""
    ignore = None if files.ignore is None else read_ignore(files.ignore)
    if ignore is not None and ignore.shape != shape[:2]:
        raise InputError(
            f"{files.ignore}: expected the {what}'s size {_size(shape)}, got {_size(ignore.shape)} (width x height)"
        )
    return ignore


def frame_size(files: FrameFiles) -> Size:
    """Width and height in pixels of a frame's mask, or else its image, from the file's header.

    Raises
    ------
    InputError
        No such file, or no PNG or JPEG.
    """
    path = files.mask or files.image
    if path is None:
        raise InputError(f"frame {files.name}: expected a mask or an image, got neither")
    expected = "a mask or an image (PNG or JPEG)"
    header = read_header(read_bytes(path, expected=expected, largest=_LARGEST))
    if header is None:
        raise InputError(f"{path}: expected {expected}, got something else or a damaged file")
    return header.width, header.height


def _size(shape: tuple[int, ...]) -> str:
    return f"{shape[1]} x {shape[0]}"
