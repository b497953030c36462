"""A camera of which there is no file: a guessed focal length, the middle of the image, and no lens distortion."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from dvrk_cmaes.camera.fields import Size
from dvrk_cmaes.camera.files import CameraFile
from dvrk_cmaes.camera.model import Camera
from dvrk_cmaes.camera.rig import Rig
from dvrk_cmaes.errors import InputError

USUAL: Final = 1.5
"""Focal length in image widths: endoscopes of da Vinci systems have 1.4 to 1.6, see the page `uncalibrated`."""

_LEAST, _LARGEST = 0.3, 6.0  # image widths


@dataclass(frozen=True)
class CameraGuess:
    """The guess of a camera; ``focal_px`` is None where not even the focal length is guessed."""

    focal_px: float | None = None

    def file(self, size: Size) -> CameraFile:
        """Return the camera for images of a size, px.

        Raises
        ------
        InputError
            The focal length is far from what cameras have.
        """
        width, height = size
        focal = USUAL * width if self.focal_px is None else self.focal_px
        if not _LEAST * width <= focal <= _LARGEST * width:
            raise InputError(
                f"--focal: expected a focal length of {_LEAST * width:g} to {_LARGEST * width:g} px, {_LEAST:g} to "
                f"{_LARGEST:g} widths of the images, got {focal:g}"
            )
        camera = Camera(width, height, focal, focal, (width - 1) / 2, (height - 1) / 2)
        kind = f"none; a guess with a focal length of {focal:g} px and no lens distortion"
        return CameraFile(Rig.of_camera(camera), kind)
