"""What one frame says about the pose: the mask and what can be found on it."""

from __future__ import annotations

from dataclasses import dataclass, field

import cv2
import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.camera import Camera
from dvrk_cmaes.errors import InputError
from dvrk_cmaes.evidence.jaw_tips import find_tips
from dvrk_cmaes.evidence.shaft_edges import Contour, ShaftEdges, find_contour, find_shaft_edges
from dvrk_cmaes.instrument import Instrument

Float64 = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Evidence:
    """Everything that one frame says.

    mask : (H, W) bool, the instrument.
    weight : (H, W) float32, 0 where a pixel counts neither way, 1 elsewhere.
    contour : the mask's outline between pixels.
    shaft_edges : pairs of lines that may be the shaft's two edges, the likeliest first; none where not found.
    tips : (2, 2) px, the jaw tips in either order, None where they were neither given nor found.
    tips_given : whether the tips are the user's.
    unused : what was left out and why, in words.
    """

    camera: Camera
    mask: NDArray[np.bool_]
    weight: NDArray[np.float32]
    contour: Contour
    shaft_edges: tuple[ShaftEdges, ...]
    tips: Float64 | None
    tips_given: bool
    unused: tuple[str, ...] = field(default=())


def gather_evidence(
    mask: NDArray[np.bool_],
    camera: Camera,
    instrument: Instrument,
    *,
    ignore: NDArray[np.bool_] | None = None,
    keypoints: Float64 | None = None,
    seed: int = 0,
) -> Evidence:
    """Collect the evidence of one frame.

    ``mask`` and ``ignore`` are (H, W) of the camera's size; ``keypoints`` (2, 2) are jaw tips in pixels, in either
    order. What the mask says of ignored pixels makes no difference. Raises `InputError` where the mask is of another
    size, empty or full, and where ``ignore`` or ``keypoints`` have another shape or are not finite.
    """
    if mask.shape != (camera.height, camera.width):
        raise InputError(
            f"mask: expected {camera.width} x {camera.height} pixels as the camera has, got "
            f"{mask.shape[1]} x {mask.shape[0]}"
        )
    if ignore is not None:
        if ignore.shape != mask.shape:
            raise InputError(
                f"ignore: expected {camera.width} x {camera.height} pixels as the mask has, got an array of shape "
                f"{ignore.shape}"
            )
        mask = mask & ~ignore
    if keypoints is not None and (keypoints.shape != (2, 2) or not np.isfinite(keypoints).all()):
        got = f"an array of shape {keypoints.shape}" if keypoints.shape != (2, 2) else keypoints.tolist()
        raise InputError(f"keypoints: expected two finite pixels, (2, 2), got {got}")
    if not mask.any():
        raise InputError("mask: expected some instrument, got no pixel that counts")
    if (mask if ignore is None else mask | ignore).all():
        raise InputError("mask: expected some background, got instrument everywhere")
    weight = np.ones(mask.shape, dtype=np.float32)
    if ignore is not None:
        weight[ignore] = 0.0
    contour = find_contour(mask, camera, ignore)
    unused: list[str] = []
    edges: tuple[ShaftEdges, ...] = ()
    if instrument.shaft is None:
        unused.append("shaft edges: the instrument has no straight shaft below its root link")
    else:
        found = find_shaft_edges(mask, contour, camera, instrument.shaft.radius, seed=seed)
        if isinstance(found, str):
            unused.append(f"shaft edges: {found}")
        else:
            edges = found
    tips = keypoints
    if not instrument.jaw_tips:
        tips = None
        unused.append("jaw tips: the instrument has no pair of jaws")
    elif keypoints is None:
        located = find_tips(mask, contour, edges[0] if edges else None, camera, ignore)
        if isinstance(located, str):
            unused.append(f"jaw tips: {located}")
        else:
            tips = located
    return Evidence(camera, mask, weight, contour, edges, tips, keypoints is not None, tuple(unused))


def shrunk(image: NDArray[np.float32], width: int, height: int) -> NDArray[np.float32]:
    """Average an image (H, W) down to another size."""
    return np.asarray(cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA), dtype=np.float32)


def window_around(mask: NDArray[np.bool_], margin: int) -> tuple[int, int, int, int]:
    """Left, top, width, height of a mask's bounding box with a margin, px, within the image; it may not be empty."""
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    top, bottom = max(rows[0] - margin, 0), min(rows[-1] + margin + 1, mask.shape[0])
    left, right = max(columns[0] - margin, 0), min(columns[-1] + margin + 1, mask.shape[1])
    return int(left), int(top), int(right - left), int(bottom - top)
