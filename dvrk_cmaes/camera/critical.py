"""Remarks on intrinsics that are unusual: what a camera file says may be wrong, although it can be used.

A few values are those of a known mistake, which no camera was seen to have: results by them are doubtful.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Final

FILE: Final = "camera file: "
"""What every remark begins with."""
WRONG: Final = f"{FILE}most likely wrong: "
"""What a remark on values of a known mistake begins with."""

_APART = 0.03  # of the focal lengths, beyond which they are not equal
_STRETCHED = 0.1, 0.4  # the same as of images that were stretched; fields are so by half
_AT_MISTAKE = 0.06  # of the width, from where a mistake puts the principal point
_OFF_CENTRE = 0.12  # of the width, from the middle of the image
_STATED = (0.1, 10.0)  # ratios of a file that are taken for such
_FOCAL = (0.4, 4.0)  # image widths
_VIDEO = ((720, 576), (704, 576), (360, 288), (352, 288), (720, 480), (704, 480), (360, 240), (352, 240))
"""Sizes of digitised video, whose pixels are not square: the whole picture is 4 : 3."""


def remarks_on(
    width: int, height: int, fx: float, fy: float, cx: float, cy: float, *, ratio: float = 1.0
) -> tuple[str, ...]:
    """Return a remark on each value of a camera file that is unusual; empty if none is.

    Real cameras may have such values, as those of cropped or rectified images do.

    Parameters
    ----------
    width, height
        Size of the images, px.
    fx, fy, cx, cy
        Focal lengths and principal point, px.
    ratio
        fx / fy that the file states in addition to the focal lengths, as by an uneven binning.
    """
    size, remarks = f"{width} x {height} px", []
    of_video = width / height * 3 / 4 if (width, height) in _VIDEO else 1.0
    usual = (1.0, of_video, ratio if _STATED[0] < ratio < _STATED[1] else 1.0)
    apart = math.expm1(min(abs(math.log(fx / fy / each)) for each in usual))
    if apart > _APART:
        begins = WRONG if _STRETCHED[0] < apart < _STRETCHED[1] else FILE
        remarks.append(
            f"{begins}fx {fx:g} and fy {fy:g} are {100 * abs(fx / fy - 1):.0f} % apart, as pixels of {size} "
            "seldom are; check both, or whether the images were stretched"
        )
    off = (cx + 0.5 - width / 2) / width, (cy + 0.5 - height / 2) / height
    distance = math.hypot(off[0] * width, off[1] * height)
    from_exchanged = math.hypot(cx + 0.5 - height / 2, cy + 0.5 - width / 2)
    if from_exchanged < distance:
        begins = WRONG if from_exchanged < _AT_MISTAKE * width else FILE
        remarks.append(
            f"{begins}principal point {cx:g}, {cy:g} is nearer to {height / 2:g}, {width / 2:g} than to the "
            f"middle of {size}, {width / 2:g}, {height / 2:g}; cx and cy, or width and height, may be exchanged"
        )
    elif math.hypot(cx + 0.5 - width / 4, cy + 0.5 - height / 4) < _AT_MISTAKE * width:
        remarks.append(
            f"{WRONG}principal point {cx:g}, {cy:g} is a quarter of {size}: the file is of images of half the size"
        )
    elif distance > _OFF_CENTRE * width:
        across = f"{100 * abs(off[0]):.0f} % of the width {'right' if off[0] > 0 else 'left'}"
        along = f"{100 * abs(off[1]):.0f} % of the height {'below' if off[1] > 0 else 'above'}"
        remarks.append(
            f"{FILE}principal point {cx:g}, {cy:g}: {across} and {along} of the middle of {size}; usual for "
            "cropped or rectified images, otherwise check the camera file's size, cx and cy"
        )
    if not all(_FOCAL[0] <= each / width <= _FOCAL[1] for each in (fx, fy)):
        remarks.append(
            f"{FILE}focal lengths {fx:g} and {fy:g} px are {fx / width:.2g} image widths; usual are "
            f"{_FOCAL[0]:g} to {_FOCAL[1]:g}: check the camera file's size, fx and fy"
        )
    return tuple(remarks)


def known_mistakes(remarks: Iterable[str]) -> list[str]:
    """Return those of some remarks that name a known mistake of a camera file, of any view.

    Parameters
    ----------
    remarks
        Those of `remarks_on`, after the name of a view or not.
    """
    return [text for text in remarks if WRONG in text]
