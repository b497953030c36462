"""What lies over all pictures of a recording and never changes: its border, and texts such as a robot's messages.

A text is found in the images together: its pixels stay the same and stand out from what is around them in nearly all
images, and little else does so. Where camera and scene stand still, no text is found in these. An instrument that is
held still before what moves reaches the edge of the picture, or is in the masks.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import Final

import cv2
import numpy as np

from dvrk_cmaes.frames.field_of_view import outside_view
from dvrk_cmaes.frames.frame import FrameFiles, readable, resized
from dvrk_cmaes.frames.session_folder import OVERLAID, Session
from dvrk_cmaes.geometry import Bool, Float32, Image

_FEWEST: Final = 8  # images
_MOST: Final = 24  # images that are looked at, spread evenly, ...
_FIRST: Final = 600  # ... over the first of a video, which is decoded from its beginning
_SIDE: Final = 960  # px, longer side at which they are compared
_OUTSIDE: Final = 0.75  # share of the images outside whose picture a pixel of the border is
_STILL: Final = 12  # grey levels, of a pixel's range over the images without its least and largest value: it stays
_AROUND: Final = 0.03  # of the longer side: what is around a pixel, and what joins the letters of a text
_STANDS_OUT: Final = 35  # grey levels by which a text differs from what is around it, ...
_MOSTLY: Final = 0.75  # ... in this share of the images
_LEAST: Final = 40  # px of a text
_LARGEST: Final = 0.1  # share of the picture of one text
_ALL: Final = 0.4  # share of the picture with what may be text, and about it
_STATIC: Final = 0.2  # share of the variance of details that stays the same, from which on camera and scene stand still
_SMEARED: Final = 3  # px, by which a text is widened: compression smears it
_INSTRUMENT: Final = 0.3  # share of a text that is in a mask, in half of the masks or more, if it is the instrument


def overlaid(images: Sequence[Image], masks: Sequence[Bool] = ()) -> Bool | None:
    """Return the pixels (H, W) of what lies over all images of a recording and never changes; None if there are none.

    Parameters
    ----------
    images
        (H, W, 3) uint8, BGR, of some moments of the recording. In fewer than 8 nothing is found.
    masks
        (H, W) bool, of the instrument in some of the images; without any, what reaches the edge is no text.
    """
    if len(images) < _FEWEST:
        return None
    height, width = images[0].shape[:2]
    same = [image for image in images if image.shape == images[0].shape]
    scale = min(1.0, _SIDE / max(height, width))
    size = max(1, round(scale * width)), max(1, round(scale * height))
    shrunk = (image if scale == 1 else cv2.resize(image, size, interpolation=cv2.INTER_AREA) for image in same)
    small = [np.asarray(image, np.uint8) for image in shrunk]
    outside = np.mean([outside_view(image) for image in small[:: max(1, len(small) // _FEWEST)]], axis=0) >= _OUTSIDE
    found = outside | _texts(
        [np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)) for image in small],
        ~outside,
        [resized(mask, size) for mask in masks],
    )
    return resized(found, (width, height)) if found.any() else None


def _texts(images: Sequence[Image], inside: Bool, masks: Sequence[Bool]) -> Bool:
    """Return the pixels (H, W) of texts over grey images, in the picture that is ``inside`` a border."""
    none, side = np.zeros_like(inside), max(inside.shape)
    if not inside.any():
        return none
    around = 2 * max(2, round(_AROUND * side / 2)) + 1
    details = [image - cv2.blur(image, (around, around)) for image in (image.astype(np.float32) for image in images)]
    apart = np.sum([np.abs(each) >= _STANDS_OUT for each in details], axis=0)
    strokes = (apart >= _MOSTLY * len(images)) & (_ranges(images) <= _STILL) & inside
    closing = np.ones((around // 2, around), np.uint8)
    joined = np.asarray(cv2.morphologyEx(strokes.astype(np.uint8), cv2.MORPH_CLOSE, closing), np.uint8)
    contours, _ = cv2.findContours(joined, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    texts = none.copy()
    edge = cv2.erode(np.pad(inside, 1).astype(np.uint8), np.ones((5, 5), np.uint8))[1:-1, 1:-1] == 0
    for contour in contours:
        one = np.zeros(inside.shape, np.uint8)
        cv2.drawContours(one, [contour], -1, 1, cv2.FILLED)
        block = one > 0
        if (
            np.count_nonzero(strokes & block) >= _LEAST
            and block.sum() <= _LARGEST * inside.sum()
            and not _is_instrument(block, masks, at_edge=bool((block & edge).any()))
        ):
            texts |= _widened(one, _SMEARED) > 0
    elsewhere = inside & (_widened(joined, around // 2) == 0)
    if elsewhere.sum() < (1 - _ALL) * inside.sum() or _stand_still(details, elsewhere):
        return none
    return texts


def _stand_still(details: Sequence[Float32], where: Bool) -> bool:
    """Whether the details (H, W) of images are in the same places: their mean then varies as each of them does."""
    clipped = [np.clip(each[where], -_STANDS_OUT, _STANDS_OUT) for each in details]
    one = float(np.mean([each.var() for each in clipped]))
    return float(np.mean(clipped, axis=0).var()) > (_STATIC + 1 / len(clipped)) * one


def _ranges(images: Sequence[Image]) -> Image:
    """Return the range (H, W) of each pixel over images, without its least and its largest value."""
    low = [np.full_like(images[0], 255)] * 2
    high = [np.zeros_like(images[0])] * 2
    for image in images:
        low = [np.minimum(low[0], image), np.minimum(low[1], np.maximum(low[0], image))]
        high = [np.maximum(high[0], image), np.maximum(high[1], np.minimum(high[0], image))]
    return np.asarray(high[1] - np.minimum(low[1], high[1]), np.uint8)


def _is_instrument(block: Bool, masks: Sequence[Bool], *, at_edge: bool) -> bool:
    """Whether what does not move is an instrument that is held still."""
    if not masks:
        return at_edge
    return bool(2 * sum(mask[block].mean() >= _INSTRUMENT for mask in masks) >= len(masks))


def _widened(mask: Image, by: int) -> Image:
    """Widen a mask by some px."""
    return np.asarray(cv2.dilate(mask, np.ones((2 * by + 1, 2 * by + 1), np.uint8)))


def with_overlaid(session: Session) -> Session:
    """Return a session whose frames ignore what lies over all of its images and never changes, of each view."""
    frames = list(session.frames)
    for number, view in enumerate(session.rig.names):
        of_view = [files if number == 0 else files.others.get(view) for files in frames]
        pixels = _learned([files for files in of_view if files is not None])
        if pixels is None:
            continue
        encoded = cv2.imencode(".png", 255 * pixels.astype(np.uint8))[1].tobytes()
        for k, (files, own) in enumerate(zip(frames, of_view, strict=True)):
            if own is not None:
                own = replace(own, overlaid=encoded, notes=(*own.notes, OVERLAID))
                frames[k] = own if number == 0 else replace(files, others={**files.others, view: own})
    notes = (OVERLAID,) if any(files.overlaid is not None for files in frames) else ()
    return replace(session, frames=tuple(frames), notes=(*session.notes, *notes))


def _learned(frames: Sequence[FrameFiles]) -> Bool | None:
    """Return the pixels (H, W) of the whole pictures over which something lies in all frames of a view."""
    usable = [replace(files, crop=None) for files in frames if files.has_image and files.problem is None]
    if usable and usable[0].image is None:
        usable = usable[:_FIRST]
    if len(usable) < _FEWEST:
        return None
    chosen = [usable[int(k)] for k in np.unique(np.linspace(0, len(usable) - 1, _MOST).round())]
    images = [image for files in chosen if (image := readable(files.read_image)) is not None]
    masked = [partial(files.read_mask, blank=True) for files in chosen if files.mask is not None]
    masks = (readable(each) for each in masked[:: max(1, len(masked) // _FEWEST)])
    return overlaid(images, [mask for mask in masks if mask is not None])
