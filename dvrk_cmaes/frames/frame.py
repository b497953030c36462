"""The files of one frame and their content: mask, readings and, where there are any, image and ignored pixels.

`FrameFiles` has the paths. `read_frame` reads a frame with a mask, `read_frame_image` one that has only an image; both
check that the sizes of the files fit each other and the camera.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.camera import Camera, Rig
from dvrk_cmaes.camera.fields import Size
from dvrk_cmaes.errors import InputError
from dvrk_cmaes.frames.boxes import FramePrompts
from dvrk_cmaes.frames.images import match_size, read_ignore, read_image, read_mask
from dvrk_cmaes.frames.video_file import VideoFrame
from dvrk_cmaes.io.files import read_bytes
from dvrk_cmaes.io.image_header import read_header
from dvrk_cmaes.results.result import Result

_LARGEST = 400_000_000  # bytes
_BESIDE = 2  # px beside another tool, where its outline and this one's cannot be told apart


@dataclass(frozen=True)
class OtherTool:
    """The mask of another tool in a frame, or its value in a mask of labels.

    Its pixels count neither way, as long as it is not known to be ``behind`` this tool: then they are background.
    """

    mask: Path
    label: int | None = None
    arm: str = ""
    behind: bool = False


@dataclass(frozen=True, eq=False)
class FrameFiles:
    """Paths of the files of a frame, and its readings.

    A frame without a mask has an image, in which the instrument is to be segmented. ``readings`` are by joint name, rad
    (insertion: m); ``keypoints`` (2, 2) px are the jaw tips in either order. ``label`` and ``pick`` select the
    instrument in the mask, as in ``read_mask``. ``prompts`` state where the instrument is in an image without a mask.
    ``time`` is that of the image, s, if it is known. ``notes`` state how camera and readings were chosen; ``problem``
    states why this frame cannot be used, None if it can. ``others`` are the files of the further views of a rig, by
    name; ``other_tools`` are other tools in the frame. ``video`` is the frame's image where that is in a video, and
    there is no ``image``. ``start`` is an earlier result of the frame, which is refined instead of a search.
    """

    name: str
    mask: Path | None
    readings: Mapping[str, float] = field(default_factory=dict)
    image: Path | None = None
    ignore: Path | None = None
    keypoints: NDArray[np.float64] | None = None
    label: int | None = None
    pick: tuple[float, float] | None = None
    time: float | None = None
    prompts: FramePrompts | None = None
    notes: tuple[str, ...] = ()
    problem: str | None = None
    others: Mapping[str, FrameFiles] = field(default_factory=dict)
    other_tools: tuple[OtherTool, ...] = ()
    video: VideoFrame | None = None
    start: Result | None = None

    @property
    def has_mask(self) -> bool:
        """Whether the frame has a mask, in at least one view."""
        return self.mask is not None or any(other.mask is not None for other in self.others.values())

    @property
    def has_image(self) -> bool:
        """Whether the frame has an image."""
        return self.image is not None or self.video is not None


@dataclass(frozen=True, eq=False)
class FrameData:
    """A frame in memory.

    ``mask`` and ``ignore`` are (H, W) bool, ``image`` (H', W', 3) uint8 BGR of the mask's aspect; ``camera`` has the
    mask's size. ``notes`` say what was done to make the parts fit, e.g. that the intrinsics were rescaled. A frame of a
    rig has the rig and the data of its further views; a view without a mask has an empty one.
    """

    mask: NDArray[np.bool_]
    camera: Camera
    ignore: NDArray[np.bool_] | None
    image: NDArray[np.uint8] | None
    notes: tuple[str, ...]
    rig: Rig | None = None
    others: Mapping[str, FrameData] = field(default_factory=dict)

    @property
    def of_views(self) -> dict[str, FrameData]:
        """The data of all views by name, the main one first, which is named left in a frame without a rig."""
        return {"left" if self.rig is None else self.rig.names[0]: self, **self.others}


@dataclass(frozen=True, eq=False)
class FrameImage:
    """A frame without a mask in memory: its image (H, W, 3) uint8 BGR, in which the instrument is to be segmented.

    ``ignore`` is (H, W) bool, ``camera`` has the image's size; ``path`` is the image's file, ``notes``, ``rig`` and
    ``others`` as in `FrameData`.
    """

    path: Path
    image: NDArray[np.uint8]
    camera: Camera
    ignore: NDArray[np.bool_] | None
    notes: tuple[str, ...]
    rig: Rig | None = None
    others: Mapping[str, FrameImage] = field(default_factory=dict)

    def with_mask(self, mask: NDArray[np.bool_], notes: tuple[str, ...] = ()) -> FrameData:
        """Return the frame with a mask (H, W) that was found in its image, and notes added."""
        return FrameData(mask, self.camera, self.ignore, self.image, (*self.notes, *notes))


def read_frame(files: FrameFiles, camera: Camera, *, blank: bool = False) -> FrameData:
    """Read a frame taken by a camera; the intrinsics are rescaled if the mask is of another size.

    With ``blank``, the mask may be empty or full.

    Raises
    ------
    InputError
        A file that cannot be read, or of a size that does not fit the others: names the file. No mask.
    """
    if files.problem is not None:
        raise InputError(files.problem)
    if files.mask is None:
        raise InputError(f"frame {files.name}: expected a mask, got {files.image or 'neither mask nor image'}")
    mask = read_mask(files.mask, label=files.label, pick=files.pick, blank=blank)
    fitted, notes = _fit(camera, mask.shape, files.mask, "mask")
    ignore = _ignored(files, mask.shape, "mask")
    image = _image_of(files)
    if image is not None and abs(image.shape[1] * mask.shape[0] / (image.shape[0] * mask.shape[1]) - 1) > 0.005:
        raise InputError(
            f"{_image_path(files)}: expected the mask's size {_size(mask.shape)}, or one of that aspect, "
            f"got {_size(image.shape)}"
        )
    return FrameData(mask, fitted, ignore, image, (*files.notes, *notes))


def read_frame_image(files: FrameFiles, camera: Camera) -> FrameImage:
    """Read a frame that has an image and no mask; the intrinsics are rescaled if the image is of another size.

    Raises
    ------
    InputError
        A file that cannot be read, or of a size that does not fit the others: names the file. No image.
    """
    if files.problem is not None:
        raise InputError(files.problem)
    image, path = _image_of(files), _image_path(files)
    if image is None or path is None:
        raise InputError(f"frame {files.name}: expected a mask, got neither mask nor image")
    fitted, notes = _fit(camera, image.shape, path, "image")
    return FrameImage(path, image, fitted, _ignored(files, image.shape, "image"), (*files.notes, *notes))


def _image_path(files: FrameFiles) -> Path | None:
    """Return the file that a frame's image is in."""
    return files.video.video.path if files.image is None and files.video is not None else files.image


def _image_of(files: FrameFiles) -> NDArray[np.uint8] | None:
    """Read the image of a frame; None if it has none."""
    if files.image is None:
        return None if files.video is None else files.video.image()
    return read_image(files.image)


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
    for tool in files.other_tools:
        if tool.behind:
            continue
        there = read_mask(tool.mask, label=tool.label, blank=True)
        if there.shape != shape[:2]:
            raise InputError(f"{tool.mask}: expected the {what}'s size {_size(shape)}, got {_size(there.shape)}")
        ignore = with_tool(ignore, there)
    return ignore


def with_tool(ignore: NDArray[np.bool_] | None, tool: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Add the pixels (H, W) of another tool, and those close beside it, to pixels that count neither way."""
    near = cv2.dilate(tool.astype(np.uint8), np.ones((3, 3), np.uint8), iterations=_BESIDE).astype(np.bool_)
    return near if ignore is None else ignore | near


def frame_size(files: FrameFiles) -> Size:
    """Width and height in pixels of a frame's mask, or else its image, from the file's header.

    Raises
    ------
    InputError
        No such file, or no PNG or JPEG.
    """
    path = files.mask or files.image
    if path is None and files.video is not None:
        return files.video.window[2:]
    if path is None:
        raise InputError(f"frame {files.name}: expected a mask or an image, got neither")
    expected = "a mask or an image (PNG or JPEG)"
    header = read_header(read_bytes(path, expected=expected, largest=_LARGEST))
    if header is None:
        raise InputError(f"{path}: expected {expected}, got something else or a damaged file")
    return header.width, header.height


def _size(shape: tuple[int, ...]) -> str:
    return f"{shape[1]} x {shape[0]}"
