"""The silhouette of a result drawn over an image, for a look at it from Python."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from dvrk_cmaes.errors import InputError
from dvrk_cmaes.geometry import Float64, Image
from dvrk_cmaes.io.arguments import checked_array

_COLOURS = {"ok": (233, 180, 86), "doubtful": (60, 200, 240), "lost": (0, 94, 213)}  # BGR, of the silhouette's outline
_TIPS = (255, 255, 255)


def drawn_over(
    image: Image,
    camera_from_root: Float64 | None,
    joints: Mapping[str, float],
    status: str,
    renderer: Any,
) -> Image:
    """Return an image, (H, W, 3) BGR, with the outline of a pose in the colour of its status.

    ``image`` is (H, W, 3) BGR, as OpenCV reads it, or grey (H, W), of any size of the camera's aspect;
    ``renderer`` is a `dvrk_cmaes.Renderer` of the instrument, or None.

    Raises
    ------
    InputError
        The image is none or has another aspect than the camera's, or there is a pose and no renderer.
    """
    import cv2  # here, since it takes a seventh of a second and most who read results draw nothing

    given = checked_array("image", image, np.uint8, "an image (H, W, 3) of uint8, BGR, or a grey one (H, W)")
    if given.ndim not in (2, 3) or given.shape[2:] not in ((), (3,)) or not given.size:
        raise InputError(f"image: expected (H, W, 3) BGR or (H, W), got an array of shape {given.shape}")
    drawn = np.array(given if given.ndim == 3 else np.repeat(given[..., None], 3, axis=2), np.uint8, order="C")
    if camera_from_root is None:
        return drawn
    if renderer is None:
        raise InputError("overlay: expected renderer=Renderer(body, camera) for a result that was read from a file")
    (height, width), camera = drawn.shape[:2], renderer.camera
    if abs(width * camera.height - height * camera.width) > max(camera.width, camera.height):  # more than a pixel
        size = f"{camera.width} x {camera.height}, the camera's"
        raise InputError(f"image: expected {size}, or another size of that aspect, got {width} x {height}")
    mask = renderer.at(width, height).masks(camera_from_root, joints)
    thick = max(round(width / 400), 1)
    beyond = 4 * thick  # px, so that no line is drawn where the silhouette leaves the image
    padded = cv2.copyMakeBorder(mask.astype(np.uint8), beyond, beyond, beyond, beyond, cv2.BORDER_REPLICATE)
    lines, _ = cv2.findContours(padded, cv2.RETR_LIST, cv2.CHAIN_APPROX_NONE, offset=(-beyond, -beyond))
    cv2.drawContours(drawn, lines, -1, (0, 0, 0), 3 * thick, cv2.LINE_AA)
    cv2.drawContours(drawn, lines, -1, _COLOURS.get(status, _TIPS), thick, cv2.LINE_AA)
    return drawn
