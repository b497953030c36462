"""What can be said of an image before it is compared with a pose: its size, and whether anything can be seen in it."""

from __future__ import annotations

from zlib import crc32

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.camera import Camera
from dvrk_cmaes.errors import InputError
from dvrk_cmaes.geometry import Bool
from dvrk_cmaes.pose.doubts import image_black, mask_says_nothing

Mask = Bool


class ImageCheck:
    """Checks the images of one camera; ``black_level`` is the brightest pixel below which an image counts as black."""

    def __init__(self, camera: Camera, black_level: int) -> None:
        self.size = (camera.height, camera.width)
        self._black_level = black_level
        self.last: int | None = None
        """Checksum of the latest mask; None without one."""

    def check_size(self, name: str, array: Bool | NDArray[np.uint8] | None) -> None:
        """Raise an InputError for an array that is not of the camera's size, or for an image that is not (H, W, 3)."""
        if array is None:
            return
        if name == "image" and (
            array.dtype != np.uint8 or array.ndim not in (2, 3) or array.shape[2:] not in ((), (3,))
        ):
            raise InputError(f"image: expected (H, W, 3) uint8, BGR, got {array.dtype} of shape {array.shape}")
        if array.shape[:2] != self.size:
            raise InputError(
                f"{name}: expected {self.size[1]} x {self.size[0]} pixels as the camera has, got an array of shape "
                f"{array.shape}"
            )

    def problem(
        self, mask: Mask | None, image: NDArray[np.uint8] | None, ignore: Mask | None, *, by_image: bool
    ) -> str | None:
        """Return why an image says nothing about the pose; None if it may. ``by_image``: its colours are used."""
        brightest = self._black_level if image is None else int(image.max())
        black = image_black(brightest, self._black_level)
        if black is not None or by_image:
            return black
        if mask is None:
            return mask_says_nothing(given=False, shown=False, surrounded=False)
        counts = np.ones_like(mask) if ignore is None else ~ignore
        return mask_says_nothing(given=True, shown=bool((mask & counts).any()), surrounded=bool((~mask & counts).any()))

    def is_same(self, array: Mask | NDArray[np.uint8] | None) -> bool:
        """Whether a mask or an image is that of the call before; of an image, every fourth row is compared."""
        if array is None:
            seen = None
        else:
            seen = crc32(np.packbits(array).tobytes() if array.dtype == np.bool_ else array[::4].tobytes())
        before, self.last = self.last, seen
        return array is not None and self.last == before
