"""How the pictures in files fit a camera file: as a part of them, or resized unevenly."""

from __future__ import annotations

from dataclasses import dataclass, replace

from dvrk_cmaes.camera import Camera
from dvrk_cmaes.camera.fields import Size
from dvrk_cmaes.camera.files import CameraFile
from dvrk_cmaes.errors import InputError
from dvrk_cmaes.frames.frame import FrameFiles, Window, frame_size
from dvrk_cmaes.io.short_text import shown

_SAME_ASPECT = 0.005


@dataclass(frozen=True)
class PictureFit:
    """How pictures fit a camera file.

    Parameters
    ----------
    crop
        Left, top, width and height, px, of the part of the files' pictures that is used; None for all.
    stretch
        Whether the camera is scaled to the pictures' size, also where that has another aspect.
    """

    crop: Window | None = None
    stretch: bool = False

    def lens(self, lens: CameraFile, frame: FrameFiles) -> CameraFile:
        """Return a camera or a rig for the pictures of a frame, which has the same crop, and notes on what was done.

        A camera of the size of the whole pictures, or of their aspect if the part has another, is cropped, too.

        Raises
        ------
        InputError
            The part is not inside the frame's picture.
        """
        if self == WHOLE:
            return lens
        whole, part = frame_size(replace(frame, crop=None)), frame_size(frame)
        notes: list[str] = []
        cameras = {view.name: self._camera(view.camera, whole, part, notes) for view in lens.rig.views}
        return replace(lens, rig=lens.rig.with_cameras(cameras), notes=(*lens.notes, *dict.fromkeys(notes)))

    def _camera(self, camera: Camera, whole: Size, part: Size, notes: list[str]) -> Camera:
        """Return the camera of the part of pictures."""
        if self.crop is not None and _is_of(camera, whole, part):
            scale = camera.width / whole[0], camera.height / whole[1]
            left, top, width, height = (round(value * scale[k % 2]) for k, value in enumerate(self.crop))
            camera = camera.cropped(left, top, width, height)
            notes.append(f"the principal point is moved by {-left:+d}, {-top:+d} px, to the part of the images")
        if not self.stretch or (camera.width, camera.height) == part:
            return camera
        sx, sy = part[0] / camera.width, part[1] / camera.height
        notes.append(f"intrinsics scaled unevenly, by {sx:.4g} across and {sy:.4g} down")
        cx, cy = (camera.cx + 0.5) * sx - 0.5, (camera.cy + 0.5) * sy - 0.5
        return replace(camera, width=part[0], height=part[1], fx=camera.fx * sx, fy=camera.fy * sy, cx=cx, cy=cy)


WHOLE = PictureFit()
"""Of pictures that fit the camera file as they are."""


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
        raise InputError(f"{where}: expected x,y,w,h in whole pixels, got {shown(given)}") from None
    if left < 0 or top < 0 or width < 1 or height < 1:
        raise InputError(
            f"{where}: expected x,y,w,h in pixels, x and y at least 0, w and h at least 1, got {shown(given)}"
        )
    return left, top, width, height
