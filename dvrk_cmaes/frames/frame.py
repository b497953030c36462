"""The files of one frame and their content: mask, readings and, where there are any, image and ignored pixels.

`FrameFiles` says where the parts of a frame are, and reads each when it is asked for; `FrameData` has them in memory.
`read_frame` reads a frame by its masks, or by its images alone, and checks that the sizes of the files fit each other
and the camera.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.camera import Camera, Rig, View
from dvrk_cmaes.camera.fields import Size
from dvrk_cmaes.errors import InputError
from dvrk_cmaes.frames.field_of_view import IGNORED, outside_view
from dvrk_cmaes.frames.images import match_size, read_ignore, read_image, read_mask
from dvrk_cmaes.frames.keypoints import Hints
from dvrk_cmaes.frames.label import Label
from dvrk_cmaes.frames.seen_view import Mask, SeenView, seen_views
from dvrk_cmaes.frames.video_frames import VideoFrame, Window, check_crop, part_of
from dvrk_cmaes.geometry import Bool, Float64
from dvrk_cmaes.io.arguments import check_type
from dvrk_cmaes.io.files import read_bytes
from dvrk_cmaes.io.image_header import read_header
from dvrk_cmaes.results.result import Result

T = TypeVar("T")

_LARGEST = 400_000_000  # bytes
_NEAR = 2  # px beside another tool, where its outline and this one's cannot be distinguished


@dataclass(frozen=True, eq=False)
class FrameFiles:
    """Paths of the files of a frame, and its readings.

    A frame without a mask has an image, in which the instrument is to be segmented. ``readings`` are by joint name, rad
    (insertion: m); ``keypoints`` (2, 2) px are the jaw tips in either order. ``label`` and ``pick`` select the
    instrument in the mask, as in ``read_mask``. ``prompts`` state where the instrument is in an image without a mask.
    ``time`` is that of the image, s, if it is known. ``notes`` state how camera and readings were chosen; ``problem``
    states why this frame cannot be used, None if it can. ``others`` are the files of the further views of a rig, by
    name; ``other_tools`` are those of other tools in the frame, whose pixels count neither way. ``video`` is the
    frame's image where that is in a video, and there is no ``image``. ``start`` is an earlier result of the frame,
    which is refined instead of a search. ``crop`` is the part of the pictures that is used, left, top, width and
    height, px; ``pick``, ``keypoints`` and ``prompts`` are in pixels of the whole pictures. ``overlaid`` is a PNG of
    pixels of the whole pictures that are over all images of the session, as a robot's messages, and do not count.
    ``without_reading``: a ``problem`` that is only that no reading is near the image's time. ``mask_name``: of the mask
    in a file with those of many frames, by default that of the frame.
    """

    name: str
    mask: Path | None
    readings: Mapping[str, float] = field(default_factory=dict)
    image: Path | None = None
    ignore: Path | None = None
    keypoints: Float64 | None = None
    label: Label | None = None
    pick: tuple[float, float] | None = None
    time: float | None = None
    prompts: Hints | None = None
    notes: tuple[str, ...] = ()
    problem: str | None = None
    others: Mapping[str, FrameFiles] = field(default_factory=dict)
    other_tools: tuple[FrameFiles, ...] = ()
    video: VideoFrame | None = None
    start: Result | None = None
    crop: Window | None = None
    overlaid: bytes | None = None
    without_reading: bool = False
    mask_name: str | None = None

    def __repr__(self) -> str:
        kinds = (str, Path, Mapping, tuple, float)
        given = {key: value for key, value in vars(self).items() if isinstance(value, kinds) and value}
        return f"FrameFiles({', '.join(f'{key}={value!r}' for key, value in given.items())})"

    @property
    def has_mask(self) -> bool:
        """Whether the frame has a mask, in at least one view."""
        return self.mask is not None or any(other.mask is not None for other in self.others.values())

    @property
    def has_image(self) -> bool:
        """Whether the frame has an image, in its first view."""
        return self.image is not None or self.video is not None

    def of_views(self, rig: Rig) -> dict[str, FrameFiles]:
        """Return the files of each view of a rig by name; there are none of a view that the frame does not have.

        Parameters
        ----------
        rig
            The rig, which has the names of the views.
        """
        others = {name: self.others.get(name, FrameFiles(self.name, None)) for name in rig.names[1:]}
        return {rig.names[0]: self, **others}

    def changed(self, **changes: Any) -> FrameFiles:
        """Return the files with fields changed alike in all views.

        Parameters
        ----------
        changes
            Values of fields by name.
        """
        others = {name: replace(other, **changes) for name, other in self.others.items()}
        return replace(self, **changes, others=others)

    @property
    def hints(self) -> Hints:
        """The prompts in pixels of the part of the pictures that is used; none where there are none."""
        given = self.prompts or Hints()
        if self.crop is None:
            return given
        left, top, *_ = self.crop
        box = given.box and (given.box[0] - left, given.box[1] - top, given.box[2] - left, given.box[3] - top)
        points, not_points = ([(u - left, v - top) for u, v in each] for each in (given.points, given.not_points))
        return Hints(box, points, not_points)

    @property
    def picture(self) -> Path | None:
        """The file that the image is in: an image, or a video; None without one."""
        return self.video.video.path if self.image is None and self.video is not None else self.image

    def read_mask(self, *, blank: bool = False) -> Bool | None:
        """Read the mask (H, W) of this view; None if it has none.

        Parameters
        ----------
        blank
            Whether it may be empty or full.
        """
        if self.mask is None:
            return None
        mask = read_mask(self.mask, label=self.label, pick=self.pick, blank=blank, name=self.mask_name or self.name)
        return self._part(mask, self.mask)

    def read_image(self) -> NDArray[np.uint8] | None:
        """Read the image (H, W, 3), BGR, of this view; None if it has none."""
        if self.image is None:
            return None if self.video is None else self._part(self.video.image(), self.video.video.path)
        return self._part(read_image(self.image), self.image)

    def _part(self, pixels: NDArray[Any], path: Path) -> NDArray[Any]:
        """Return the part of a picture (H, W, ...) that is used; InputError if that is not inside."""
        if self.crop is None:
            return pixels
        check_crop(path, self.crop, (pixels.shape[1], pixels.shape[0]))
        return part_of(pixels, self.crop)

    def read_ignored(self, shape: tuple[int, ...], what: str = "mask") -> Bool | None:
        """Read the pixels (H, W) of this view that count neither way; None if there are none.

        Parameters
        ----------
        shape
            Height and width that they must have, px.
        what
            What has this size, for messages.
        """
        ignore = None if self.ignore is None else self._part(read_ignore(self.ignore), self.ignore)
        if ignore is not None and ignore.shape != shape[:2]:
            raise InputError(
                f"{self.ignore}: expected the {what}'s size {_size(shape)}, got {_size(ignore.shape)} (width x height)"
            )
        if self.overlaid is not None:
            over = np.asarray(cv2.imdecode(np.frombuffer(self.overlaid, np.uint8), 0)) > 0
            over = resized(over if self.crop is None else part_of(over, self.crop), (shape[1], shape[0]))
            ignore = over if ignore is None else ignore | over
        for tool in self.other_tools:
            there = replace(tool, crop=self.crop).read_mask(blank=True)
            assert there is not None
            if there.shape != shape[:2]:
                raise InputError(f"{tool.mask}: expected the {what}'s size {_size(shape)}, got {_size(there.shape)}")
            ignore = with_tool(ignore, there)
        return ignore

    @property
    def size(self) -> Size:
        """Width and height in pixels of the mask, or else the image, or of their part that is used.

        It is that of the file's header. InputError if there is no such file, or no PNG or JPEG.
        """
        if self.crop is not None:
            return self.crop[2:]
        path = self.mask or self.image
        if path is None and self.video is not None:
            return self.video.window[2:]
        if path is None:
            raise InputError(f"frame {self.name}: expected a mask or an image, got neither")
        if path.suffix.lower() == ".json":
            height, width = read_mask(path, blank=True, name=self.mask_name or self.name).shape
            return width, height
        expected = "a mask or an image (PNG or JPEG)"
        header = read_header(read_bytes(path, expected=expected, largest=_LARGEST))
        if header is None:
            raise InputError(f"{path}: expected {expected}, got something else or a damaged file")
        return header.width, header.height


@dataclass(frozen=True, eq=False)
class FrameData:
    """A frame in memory: its views, the reference first, and notes.

    The views' cameras have the sizes of their masks. ``notes`` say what was done to make the parts fit, e.g. that the
    intrinsics were rescaled. ``mask``, ``camera``, ``ignore`` and ``image`` are those of the reference view. ``files``
    has its name, time and readings, and says where its views were read.
    """

    views: tuple[SeenView, ...]
    notes: tuple[str, ...] = ()
    files: FrameFiles = FrameFiles("", None)

    @staticmethod
    def of(
        mask: Mask,
        camera: Camera | Rig,
        ignore: Mask | None = None,
        image: NDArray[np.uint8] | None = None,
        notes: tuple[str, ...] = (),
    ) -> FrameData:
        """Return a frame that is given as arrays, as those of `estimate`; ``image`` is that of the reference view.

        Parameters
        ----------
        mask
            (H, W) bool, True on the instrument; with a rig, the masks by name of the view.
        camera
            The camera or the rig.
        ignore
            (H, W) bool, pixels that count neither way; by view with a rig.
        image
            (H, W, 3) uint8, BGR, of the reference view.
        notes
            What was done to make the parts fit, e.g. that the camera was rescaled.
        """
        reference, *others = seen_views(mask, camera, ignore)
        return FrameData((replace(reference, image=image), *others), notes)

    @property
    def mask(self) -> Bool:
        """The mask (H, W), bool; empty where the reference view has none."""
        return self.views[0].mask

    @property
    def camera(self) -> Camera:
        """The camera of the mask's size."""
        return self.views[0].camera

    @property
    def ignore(self) -> Bool | None:
        """The pixels (H, W), bool, that count neither way."""
        return self.views[0].ignore

    @property
    def image(self) -> NDArray[np.uint8] | None:
        """The image (H', W', 3), uint8 BGR, of the mask's aspect."""
        return self.views[0].image


def read_frame(files: FrameFiles, camera: Camera | Rig, *, blank: bool = False) -> FrameData:
    """Read a frame taken by a camera or a rig; the intrinsics are rescaled if a mask or an image is of another size.

    A frame without a mask is read with its images alone, in which masks are to be found: its views have none yet. With
    ``blank``, the mask may be empty or full. Of a rig, some masks may be missing or empty, but without ``blank`` not
    all; of images, only the reference view must have one.

    Parameters
    ----------
    files
        The files of the frame, as a `Session` lists them.
    camera
        The camera, or the rig of a session with several views.
    blank
        Whether the mask may be empty or full.

    Raises
    ------
    InputError
        A file that cannot be read, or of a size that does not fit the others: names the file. Neither mask nor image.
    """
    check_type("files", files, FrameFiles, "a FrameFiles, as a Session has in frames")
    if files.problem is not None:
        raise InputError(files.problem)
    rig = Rig.of(camera)
    of_views, several = files.of_views(rig), len(rig.views) > 1
    masks = [own.mask for own in of_views.values() if own.mask is not None]
    if not masks and not files.has_image:
        expected, got = ("masks", f"an image of the view {rig.names[0]}") if several else ("a mask", "an image")
        raise InputError(f"frame {files.name}: expected {expected}, or {got}, got neither")
    read = [_read_view(of_views[view.name], view, masked=bool(masks), blank=blank or several) for view in rig.views]
    views = tuple(view for view, _ in read)
    if masks and several and not blank and not any(view.mask.any() for view in views):
        paths = ", ".join(map(str, masks))
        raise InputError(f"{paths}: mask is empty: expected the instrument in at least one view, got none")
    main = read[0][1]
    others = (f"view {view.name}: {note}" for view, notes in read[1:] for note in notes if note not in main)
    return FrameData(views, (*main, *others), files)


def _read_view(files: FrameFiles, view: View, *, masked: bool, blank: bool) -> tuple[SeenView, tuple[str, ...]]:
    """Read the files of a view, and notes on them: of its mask and image, or of its image alone.

    A view without a mask, or without an image where that is read alone, is empty.
    """
    mask = files.read_mask(blank=blank) if masked else None
    image = None if masked and mask is None else files.read_image()
    seen = image if mask is None else mask
    if seen is None:
        return replace(SeenView.of(view, None), given=masked), files.notes
    what, path = ("image", files.picture) if mask is None else ("mask", files.mask)
    fitted, note = match_size(view.camera, seen.shape[:2], what, f"{path}: ")
    notes = () if note is None else (note,)
    view = replace(view, camera=fitted)
    ignore, tips = files.read_ignored(seen.shape, what), files.keypoints
    tips = tips if tips is None or files.crop is None else tips - files.crop[:2]
    found = SeenView.of(view, mask, ignore=ignore, image=image, keypoints=tips)
    if image is not None:
        if mask is not None and abs(image.shape[1] * mask.shape[0] / (image.shape[0] * mask.shape[1]) - 1) > 0.005:
            expected = f"the mask's size {_size(mask.shape)}, or one of that aspect"
            raise InputError(f"{files.picture}: expected {expected}, got {_size(image.shape)}")
        border = outside_view(image)
        if border.any():
            found, notes = found.without(resized(border, (seen.shape[1], seen.shape[0]))), (*notes, IGNORED)
    return found, (*files.notes, *notes)


def readable(read: Callable[[], T]) -> T | None:
    """Read a file; None for one that cannot be read."""
    try:
        return read()
    except InputError:
        return None


def resized(pixels: Bool, size: tuple[int, int]) -> Bool:
    """Return pixels (H, W) in another size, width and height: each as the nearest one is."""
    if pixels.shape == size[::-1]:
        return pixels
    return np.asarray(cv2.resize(pixels.astype(np.uint8), size, interpolation=cv2.INTER_NEAREST) > 0)


def with_tool(ignore: Bool | None, tool: Bool) -> Bool:
    """Add the pixels (H, W) of another tool, and those close beside it, to pixels that count neither way."""
    near = cv2.dilate(tool.astype(np.uint8), np.ones((3, 3), np.uint8), iterations=_NEAR).astype(np.bool_)
    return near if ignore is None else ignore | near


def _size(shape: tuple[int, ...]) -> str:
    return f"{shape[1]} x {shape[0]}"
