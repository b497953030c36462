"""Drawing of antialiased lines, regions and text on an image.

The colours are those of Okabe and Ito's palette, which can be distinguished with the common colour-vision deficiencies.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.geometry import Bool, Float64, Image

Colour = tuple[int, int, int]
"""Blue, green, red, 0 to 255."""

ORANGE: Colour = (0, 159, 230)
SKY_BLUE: Colour = (233, 180, 86)
GREEN: Colour = (115, 158, 0)
YELLOW: Colour = (66, 228, 240)
VERMILLION: Colour = (0, 94, 213)
PURPLE: Colour = (167, 121, 204)
WHITE: Colour = (255, 255, 255)
GREY: Colour = (170, 170, 170)
DARK: Colour = (28, 24, 22)
AXES: tuple[tuple[str, Colour], ...] = (("x", VERMILLION), ("y", GREEN), ("z", SKY_BLUE))
"""Names and colours of a coordinate frame's axes."""

_SHIFT = 4  # fractional bits of OpenCV's fixed-point coordinates
_WIDEST = 20.0  # units, of a line with its rim, and the pixels that its antialiasing reaches
_STRIP: Colour = (52, 46, 43)
_EDGE: Final = 8  # px at the left of strips without a letter; and the largest change of a colour by JPEG
_LINE, _MARGIN = 26.0, 14.0  # units, from line to line and beside the lines
_FONT = cv2.FONT_HERSHEY_SIMPLEX


def plain(height: int, width: int, colour: Colour) -> NDArray[np.uint8]:
    """Return an image (height, width, 3) of one colour."""
    image = np.empty((height, width, 3), dtype=np.uint8)
    image[:] = np.tile(np.array(colour, dtype=np.uint8), (width, 1))
    return image


def beside(pictures: Sequence[Image]) -> Image:
    """Return pictures (h, w, 3) beside each other, with dark rows below those that are lower than others."""
    if len(pictures) == 1:
        return pictures[0]
    height = max(picture.shape[0] for picture in pictures)
    padded = [
        cv2.copyMakeBorder(picture, 0, height - picture.shape[0], 0, 0, cv2.BORDER_CONSTANT, value=DARK)
        for picture in pictures
    ]
    return np.asarray(np.concatenate(padded, axis=1), dtype=np.uint8)


def strip(width: int, unit: float, lines: Sequence[Sequence[tuple[str, Colour]]], *, size: float = 0.55) -> Image:
    """Return a dark strip (H, width, 3) BGR with lines of texts, each in its colour, wrapped where there is no room.

    Parameters
    ----------
    width
        Width, px.
    unit
        As of `Canvas`.
    lines
        The lines, each of texts with their colours.
    size
        Size of the letters, of OpenCV.
    """
    placed, row, probe = [], -1, Canvas(plain(1, 1, DARK), unit)
    for texts in lines:
        left, row = _MARGIN * unit, row + 1
        for text, colour in texts:
            for word in (*text.split(), "  "):  # which is between two texts
                wide = probe.text_width(f"{word} ", size)
                if left + wide > width and left > _MARGIN * unit:
                    left, row = _MARGIN * unit, row + 1
                placed.append((word, (left, unit * _LINE * (row + 0.5)), colour))
                left += wide
    canvas = Canvas(plain(max(1, round(unit * _LINE * (row + 1))), width, _STRIP), unit)
    for word, at, colour in placed:
        canvas.text(word, at, colour, size=size)
    return canvas.image


def without_strips(picture: Image) -> Image:
    """Return the rows of a drawing (H, W, 3), which may have been stored as JPEG, between strips at its ends."""
    is_strip = (np.abs(picture[:, :_EDGE].astype(np.int16) - _STRIP) < _EDGE).all(axis=(1, 2))
    above, below = int(np.argmin(is_strip)), int(np.argmin(is_strip[::-1]))
    return picture[above : len(picture) - below]


class Canvas:
    """An image (H, W, 3) uint8 BGR with methods that draw on it in place.

    Coordinates are in pixels, with pixel centres at integers. Widths and sizes are multiples of ``unit``, px, so that
    drawings look alike at any size.
    """

    def __init__(self, image: NDArray[np.uint8], unit: float) -> None:
        self.image = image
        self.unit = unit

    def line(
        self,
        points: Float64,
        colour: Colour,
        *,
        width: float = 1.5,
        dash: tuple[float, float] | None = None,
        phase: float = 0.0,
        rim: bool = True,
    ) -> None:
        """Draw an antialiased polyline.

        Parameters
        ----------
        points
            (N, 2) px; the line is interrupted at points that are not finite or far outside the image.
        colour
            The line's colour.
        width
            The line's width.
        dash
            Lengths of dashes and of gaps; None for a solid line.
        phase
            Length by which the dashes are shifted along the line.
        rim
            Whether the line has a dark rim for contrast with the background.
        """
        for part in self._inside(points):
            strokes = [part] if dash is None else self._dashed(part, self.unit * np.array(dash), self.unit * phase)
            if rim:
                self._draw(strokes, DARK, width + 1.6)
            self._draw(strokes, colour, width)

    def outline(self, mask: Bool, colour: Colour) -> None:
        """Draw the contours of a mask of the canvas's size, without the parts on the image's border."""
        chains, _ = cv2.findContours(mask.astype(np.uint8), cv2.RETR_LIST, cv2.CHAIN_APPROX_NONE)
        last = np.array([mask.shape[1] - 1, mask.shape[0] - 1])
        for chain in chains:
            points = np.concatenate([chain[:, 0, :], chain[:1, 0, :]]).astype(np.float64)
            points[((points <= 0) | (points >= last)).any(axis=1)] = np.nan
            self.line(points, colour, width=2.0, rim=False)

    def cross(self, at: Float64, colour: Colour, size: float = 7.0) -> None:
        """Draw an x at a point (2,)."""
        reach = size * self.unit * np.array([[-1.0, -1.0], [1.0, 1.0]])
        arms = [at + reach, at + reach * [1.0, -1.0]]
        for over in (False, True):
            for arm in arms:
                if np.isfinite(arm).all():
                    self._draw([arm], colour if over else DARK, 2.0 if over else 4.0)

    def ring(self, at: Float64, colour: Colour, radius: float = 7.0) -> None:
        """Draw a circle about a point (2,)."""
        angle = np.linspace(0, 2 * np.pi, 33)
        self.line(at + radius * self.unit * np.stack([np.cos(angle), np.sin(angle)], axis=1), colour, width=2.0)

    def tint(self, where: Bool, colour: Colour, share: float) -> None:
        """Blend a colour into the pixels where a mask (H, W) is True; ``share`` is the colour's weight, 0 to 1."""
        at = np.divmod(np.flatnonzero(where), where.shape[1])
        self.image[at] = np.rint(self.image[at] * (1 - share) + share * np.array(colour)).astype(np.uint8)

    def text(
        self, text: str, at: tuple[float, float], colour: Colour = WHITE, *, size: float = 0.5, rim: bool = False
    ) -> None:
        """Write a line of text.

        ``at`` (u, v) is its left end, at the middle of its height. Characters that are not ASCII are written as ``?``.
        """
        plain = _plain(text)
        place = (round(at[0]), round(at[1] + 10 * size * self.unit))
        if rim:
            cv2.putText(self.image, plain, place, _FONT, size * self.unit, DARK, self._thickness(3.5), cv2.LINE_AA)
        cv2.putText(self.image, plain, place, _FONT, size * self.unit, colour, self._thickness(1.2), cv2.LINE_AA)

    def text_width(self, text: str, size: float = 0.5) -> float:
        """Return the width of a line of text, px."""
        return float(cv2.getTextSize(_plain(text), _FONT, size * self.unit, self._thickness(1.2))[0][0])

    def _thickness(self, width: float) -> int:
        return max(1, round(width * self.unit))

    def _draw(self, strokes: Sequence[Float64], colour: Colour, width: float) -> None:
        fixed = [np.rint(points * 2**_SHIFT).astype(np.int32) for points in strokes]
        cv2.polylines(self.image, fixed, False, colour, self._thickness(width), cv2.LINE_AA, _SHIFT)

    def _inside(self, points: Float64) -> Iterator[Float64]:
        """Yield the parts of a polyline on the canvas or near it; OpenCV's coordinates overflow farther outside."""
        size = np.array([self.image.shape[1], self.image.shape[0]])
        with np.errstate(invalid="ignore"):
            near = np.asarray(((points > -2 * size) & (points < 3 * size)).all(axis=1))
        for part in np.split(np.arange(len(points)), np.flatnonzero(np.diff(near.astype(int))) + 1):
            if len(part) > 1 and near[part[0]]:
                yield points[part]

    def _dashed(self, points: Float64, dash: Float64, phase: float) -> list[Float64]:
        """Return the dashes of a polyline (N, 2) that may show; ``dash`` (2,) are the lengths of dashes and gaps."""
        length = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
        starts = np.arange(-(phase % dash.sum()), length[-1], dash.sum())
        first, last = np.maximum(starts, 0.0), np.minimum(starts + dash[0], length[-1])
        begin = np.stack([np.interp(first, length, points[:, k]) for k in range(2)], axis=1)
        # no point of a dash is farther from its begin than its length
        margin = dash[0] + _WIDEST * self.unit
        shown = ((begin > -margin) & (begin < np.array(self.image.shape[1::-1]) + margin)).all(axis=1) & (last > first)
        dashes = []
        for begins, ends in zip(first[shown], last[shown], strict=True):
            at = np.concatenate([[begins], length[(length > begins) & (length < ends)], [ends]])
            dashes.append(np.stack([np.interp(at, length, points[:, k]) for k in range(2)], axis=1))
        return dashes


def _plain(text: str) -> str:
    """Replace characters that OpenCV's fonts do not have, those that are not ASCII, by ``?``."""
    return text.encode("ascii", "replace").decode("ascii")
