"""Inspection of PNG and JPEG files: masks, masks of labels, ignored pixels and images.

The kind is recognised by the pixel values and by the name of the folder.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.frames.images import read_ignore, read_image, read_mask
from dvrk_cmaes.inspection.finding import Finding

_THRESHOLD = 127
_SOFT = 40  # largest deviation of a mask's pixels from 0 or 255 due to JPEG compression
_SHARP_SHARE = 0.98  # least fraction of pixels near 0 or 255 in a mask
_MOST_LABELS = 16


def inspect_image(path: Path) -> Finding:
    """Describe a PNG or JPEG as image, mask, mask of labels or ignored pixels; InputError if it is not valid."""
    pixels = read_image(path)
    height, width = pixels.shape[:2]
    read = {"width": width, "height": height}
    size = f"{width} x {height} px"
    grey = pixels[:, :, 0]
    if not (np.array_equal(grey, pixels[:, :, 1]) and np.array_equal(grey, pixels[:, :, 2])):
        return Finding("image", (f"{size}, in colour",), read)
    if path.parent.name == "ignore":
        share = float(read_ignore(path).mean())
        notes = ("it lies in a folder called ignore: above 127 counts neither way",)
        return Finding("ignored pixels", (f"{size}, {share:.2%} ignored",), {**read, "ignored": share}, notes)
    labels = np.unique(grey)
    if labels.max() <= _THRESHOLD and len(labels) <= _MOST_LABELS:
        return _labels(grey, size, read)
    sharp = float(np.mean((grey < _SOFT) | (grey > 255 - _SOFT)))
    if sharp < _SHARP_SHARE:
        return Finding("image", (f"{size}, grey",), read, ("grey with many values between: an image, not a mask",))
    mask = read_mask(path)
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    box = [int(columns[0]), int(rows[0]), int(columns[-1]), int(rows[-1])]
    return Finding(
        "mask",
        (f"{size}, {mask.mean():.2%} instrument, within columns {box[0]} to {box[2]} and rows {box[1]} to {box[3]}",),
        {**read, "instrument": float(mask.mean()), "box": box},
        (f"almost all pixels are near 0 or 255: a mask; above {_THRESHOLD} is instrument",),
    )


def _labels(grey: NDArray[np.uint8], size: str, read: dict[str, int]) -> Finding:
    """Describe a mask of labels (H, W); an image of zeros is an empty one."""
    labels, counts = np.unique(grey, return_counts=True)
    shares = {int(label): float(count / grey.size) for label, count in zip(labels, counts, strict=True)}
    text = ", ".join(f"{label}: {share:.2%}" for label, share in shares.items())
    return Finding(
        "mask of labels",
        (f"{size}, shares of the labels {text}",),
        {**read, "labels": {str(label): share for label, share in shares.items()}},
        (f"no value is above {_THRESHOLD} and few differ: labels; --label says which is the instrument",),
    )
