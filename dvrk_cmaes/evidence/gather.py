"""Collection of the image evidence of one frame: the mask and the features found in it."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache

import cv2
import numpy as np

from dvrk_cmaes.camera import Camera
from dvrk_cmaes.errors import InputError
from dvrk_cmaes.evidence.jaw_tips import find_tips
from dvrk_cmaes.evidence.shaft_edges import Contour, ShaftEdges, find_contour, find_shaft_edges, half_width
from dvrk_cmaes.geometry import Bool, Float32, Float64
from dvrk_cmaes.instrument import Instrument


@dataclass(frozen=True, eq=False)
class Evidence:
    """The image evidence of one frame.

    mask : (H, W) bool, True on the instrument.
    weight : (H, W) float32, 0 for ignored pixels, 1 for all others.
    contour : the mask's contour with subpixel accuracy.
    shaft_edges : pairs of lines that may be the shaft's two edges, best supported first; empty if none was found.
    tips : (2, 2) px, the jaw tips in either order; None if they were neither given nor found.
    tips_given : whether the tips were given by the user.
    unused : descriptions of evidence that is missing, with the reason.
    """

    camera: Camera
    mask: Bool
    weight: Float32
    contour: Contour
    shaft_edges: tuple[ShaftEdges, ...]
    tips: Float64 | None
    tips_given: bool
    unused: tuple[str, ...] = field(default=())

    @cached_property
    def _at_sizes(self) -> dict[tuple[int, int], tuple[Float32, Float32]]:
        return {}

    def at_size(self, width: int, height: int) -> tuple[Float32, Float32]:
        """Return mask (h, w), 0 to 1, and weight (h, w) at another image size, px; ignored pixels do not count."""
        known = self._at_sizes
        if (width, height) not in known:
            mask, weight = self.share, self.weight
            if mask.shape != (height, width):
                weight = self.weight_at(width, height)
                mask = shrunk(mask * self.weight if self.ignores else mask, width, height)
                if self.ignores:
                    mask = np.divide(mask, np.maximum(weight, 1e-6), dtype=np.float32)
            known[width, height] = mask, weight
        return known[width, height]

    def weight_at(self, width: int, height: int) -> Float32:
        """Return the weight (h, w) at another image size, px."""
        if not self.ignores:
            return np.ones((height, width), dtype=np.float32)
        return shrunk(self.weight, width, height)

    def shows_both(self, width: int, height: int) -> bool:
        """Return whether some pixel is instrument, and another one background, at an image size, px."""
        mask, _ = self.at_size(width, height)
        return 0 < int(np.count_nonzero(mask > 0.5)) < mask.size

    @cached_property
    def share(self) -> Float32:
        """The mask as numbers (H, W), 0 or 1."""
        return self.mask.astype(np.float32)

    @cached_property
    def half_width(self) -> float:
        """Half the width, px, of the mask at its widest place."""
        return half_width(self.mask)

    @cached_property
    def ignores(self) -> bool:
        """Whether there are ignored pixels."""
        return bool(self.weight.min() < 1)

    def overlap_with(self, silhouette: Bool, window: tuple[slice, slice] = np.s_[:, :]) -> float:
        """Return the intersection over union of a silhouette (H, W) and the mask, without ignored pixels.

        All of both is in the ``window`` of the image.
        """
        drawn, mask = silhouette[window], self.mask[window]
        both, either = drawn & mask, drawn | mask
        if self.ignores:
            counts = self.weight[window] > 0
            both, either = both & counts, either & counts
        return float(np.count_nonzero(both)) / max(float(np.count_nonzero(either)), 1.0)


def gather_evidence(
    mask: Bool,
    camera: Camera,
    instrument: Instrument,
    *,
    ignore: Bool | None = None,
    keypoints: Float64 | None = None,
    seed: int = 0,
    features: bool = True,
) -> Evidence:
    """Collect the evidence of one frame.

    ``mask`` and ``ignore`` are (H, W), of the camera's size; ``keypoints`` (2, 2) are jaw tips in pixels, in either
    order. The mask's values at ignored pixels have no effect. Without ``features``, the shaft's edges and the jaw tips
    are not looked for: only a search needs them. Raises `InputError` if the mask has another size, is
    empty or full, or if ``ignore`` or ``keypoints`` have another shape or are not finite.
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
    if not features:
        return _without_features(mask.copy(), ignore, camera, keypoints)
    marks = None if keypoints is None else tuple(keypoints.ravel().tolist())
    hidden = None if ignore is None else ignore.tobytes()
    return _gathered(mask.tobytes(), hidden, marks, camera, instrument, seed)


@lru_cache(maxsize=4)
def _gathered(
    mask_bytes: bytes,
    ignore_bytes: bytes | None,
    marks: tuple[float, ...] | None,
    camera: Camera,
    instrument: Instrument,
    seed: int,
) -> Evidence:
    """Collect all evidence of one frame; that of the last ones is kept, because an overlay shows it, too.

    ``mask_bytes`` and ``ignore_bytes`` are the contents of ``mask`` and ``ignore``, ``marks`` those of ``keypoints``;
    the others are as in `gather_evidence`.
    """
    size = camera.height, camera.width
    mask = np.frombuffer(mask_bytes, dtype=np.bool_).reshape(size)
    ignore = None if ignore_bytes is None else np.frombuffer(ignore_bytes, dtype=np.bool_).reshape(size)
    keypoints = None if marks is None else np.reshape(marks, (2, 2))
    bare = _without_features(mask, ignore, camera, keypoints)
    contour = bare.contour
    unused: list[str] = []
    edges: tuple[ShaftEdges, ...] = ()
    if instrument.shaft is None:
        unused.append("shaft edges: the instrument has no straight shaft below its root link")
    else:
        found = find_shaft_edges(
            mask, contour, camera, instrument.shaft.radius, ignore=ignore, seed=seed, widest=bare.half_width
        )
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
    gathered = replace(bare, shaft_edges=edges, tips=tips, unused=tuple(unused))
    if "half_width" in vars(bare):
        vars(gathered)["half_width"] = bare.half_width
    return gathered


def _without_features(mask: Bool, ignore: Bool | None, camera: Camera, keypoints: Float64 | None) -> Evidence:
    """Collect the evidence of a mask (H, W) alone, and the jaw tips that are given."""
    weight = np.ones(mask.shape, dtype=np.float32)
    if ignore is not None:
        weight[ignore] = 0.0
    return Evidence(camera, mask, weight, find_contour(mask, camera, ignore), (), keypoints, keypoints is not None)


def shrunk(image: Float32, width: int, height: int) -> Float32:
    """Downsample an image (H, W) to another size by area averaging."""
    return np.asarray(cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA), dtype=np.float32)


def window_around(mask: Bool, margin: int) -> tuple[int, int, int, int]:
    """Return left, top, width and height, px, of the bounding box of a non-empty mask, with a margin, in the image."""
    first, highest, wide, high = cv2.boundingRect(np.ascontiguousarray(mask).view(np.uint8))
    left, top = max(first - margin, 0), max(highest - margin, 0)
    right, bottom = min(first + wide + margin, mask.shape[1]), min(highest + high + margin, mask.shape[0])
    return left, top, right - left, bottom - top
