"""How the pictures in files fit a camera file: as a part of them, or resized unevenly."""

from __future__ import annotations

from dataclasses import replace

from dvrk_cmaes.camera import Camera
from dvrk_cmaes.camera.fields import Size
from dvrk_cmaes.camera.files import CameraFile
from dvrk_cmaes.errors import InputError
from dvrk_cmaes.frames.frame import FrameFiles
from dvrk_cmaes.frames.video_frames import Window
from dvrk_cmaes.io.short_text import shown

_SAME_ASPECT = 0.005


def fitted(lens: CameraFile, frame: FrameFiles, *, stretch: bool = False) -> CameraFile:
    """Return a camera or a rig for the pictures of a frame, or their crop, and notes on what was done.

    A camera of the size of the whole pictures, or of their aspect if the part has another, is cropped, too.

    Parameters
    ----------
    lens
        The camera or the rig of the camera file.
    frame
        The files of a frame; its ``crop`` is the part of the files' pictures that is used.
    stretch
        Whether the camera is scaled to the pictures' size, also where that has another aspect.

    Raises
    ------
    InputError
        The part is not inside the frame's picture.
    """
    if frame.crop is None and not stretch:
        return lens
    whole, part = replace(frame, crop=None).size, frame.size
    notes: list[str] = []
    cameras = {view.name: _camera(view.camera, frame.crop, whole, part, notes, stretch) for view in lens.rig.views}
    return replace(lens, rig=lens.rig.with_cameras(cameras), notes=(*lens.notes, *dict.fromkeys(notes)))


def _camera(camera: Camera, crop: Window | None, whole: Size, part: Size, notes: list[str], stretch: bool) -> Camera:
    """Return the camera of the part of pictures."""
    if crop is not None and _is_of(camera, whole, part):
        scale = camera.width / whole[0], camera.height / whole[1]
        left, top, width, height = (round(value * scale[k % 2]) for k, value in enumerate(crop))
        camera = camera.cropped(left, top, width, height)
        notes.append(f"the principal point is moved by {-left:+d}, {-top:+d} px, to the part of the images")
    if not stretch or (camera.width, camera.height) == part:
        return camera
    sx, sy = part[0] / camera.width, part[1] / camera.height
    notes.append(f"intrinsics scaled unevenly, by {sx:.4g} across and {sy:.4g} down")
    return camera.scaled(*part)


def _is_of(camera: Camera, whole: Size, part: Size) -> bool:
    """Whether a camera is that of pictures of size ``whole``, and not that of their ``part``."""
    aspect = camera.width / camera.height
    alike = [abs(width / height / aspect - 1) <= _SAME_ASPECT for width, height in (whole, part)]
    if alike[0] != alike[1]:
        return alike[0]
    return alike[0] and abs(camera.width - whole[0]) < abs(camera.width - part[0])


def parse_crop(where: str, given: str | tuple[int, ...]) -> Window:
    """Parse ``x,y,w,h``, px; InputError, which begins with ``where``, if it is not a part of a picture."""
    try:
        left, top, width, height = (int(part) for part in (given.split(",") if isinstance(given, str) else given))
    except ValueError:
        left = top = width = height = -1
    if left < 0 or top < 0 or width < 1 or height < 1:
        expected = "x,y,w,h in whole pixels, x and y at least 0, w and h at least 1"
        raise InputError(f"{where}: expected {expected}, got {shown(given)}")
    return left, top, width, height
