"""Drawing on an image: lines finer than its pixels, with dashes and dark rims; text; colours all can tell.

The palette is Okabe and Ito's, which people with any of the common colour-vision deficiencies can tell apart.
"""

from __future__ import annotations

from collections.abc import Iterator

import cv2
import numpy as np
from numpy.typing import NDArray

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
"""A frame's axes."""

_SHIFT = 4  # bits of OpenCV's fractional coordinates
_FONT = cv2.FONT_HERSHEY_SIMPLEX


class Canvas:
    """An image (H, W, 3) uint8 BGR that is drawn on in place.

    Coordinates are pixels, centres at integers. Widths and sizes are in ``unit``, px of the canvas, so that drawings
    look alike at any size.
    """

    def __init__(self, image: NDArray[np.uint8], unit: float) -> None:
        self.image = image
        self.unit = unit

    def line(
        self,
        points: NDArray[np.float64],
        colour: Colour,
        *,
        width: float = 1.5,
        dash: tuple[float, float] | None = None,
        phase: float = 0.0,
        rim: bool = True,
    ) -> None:
        """Draw a polyline through points (N, 2), antialiased; ``dash`` is the length of strokes and of gaps.

        Points that are not finite or far outside interrupt it; a dark ``rim`` lifts it off any background.
        """
        for part in self._inside(points):
            for stroke in [part] if dash is None else _dashed(part, self.unit * np.array(dash), self.unit * phase):
                self._stroke(stroke, colour, width, rim)

    def outline(self, mask: NDArray[np.bool_], colour: Colour) -> None:
        """Draw the outlines of a mask of the canvas's size, but for where it meets the border."""
        found, _ = cv2.findContours(mask.astype(np.uint8), cv2.RETR_LIST, cv2.CHAIN_APPROX_NONE)
        last = np.array([mask.shape[1] - 1, mask.shape[0] - 1])
        for chain in found:
            points = np.concatenate([chain[:, 0, :], chain[:1, 0, :]]).astype(np.float64)
            points[((points <= 0) | (points >= last)).any(axis=1)] = np.nan
            self.line(points, colour, width=2.0, rim=False)

    def cross(self, at: NDArray[np.float64], colour: Colour, size: float = 7.0) -> None:
        """Draw an x at a point (2,)."""
        reach = size * self.unit * np.array([[-1.0, -1.0], [1.0, 1.0]])
        arms = [at + reach, at + reach * [1.0, -1.0]]
        for over in (False, True):
            for arm in arms:
                if np.isfinite(arm).all():
                    self._draw(arm, colour if over else DARK, 2.0 if over else 4.0)

    def ring(self, at: NDArray[np.float64], colour: Colour, radius: float = 7.0) -> None:
        """Draw a circle about a point (2,)."""
        angle = np.linspace(0, 2 * np.pi, 33)
        self.line(at + radius * self.unit * np.stack([np.cos(angle), np.sin(angle)], axis=1), colour, width=2.0)

    def tint(self, where: NDArray[np.bool_], colour: Colour, share: float) -> None:
        """Mix a colour into the pixels (H, W)."""
        self.image[where] = np.rint(self.image[where] * (1 - share) + share * np.array(colour)).astype(np.uint8)

    def box(self, corner: tuple[float, float], size: tuple[float, float], colour: Colour) -> None:
        """Fill a rectangle of a size (width, height) px from its upper left corner."""
        start = np.rint(corner).astype(int)
        end = np.rint(np.add(corner, size)).astype(int)
        self.image[max(start[1], 0) : end[1], max(start[0], 0) : end[0]] = colour

    def text(
        self, text: str, at: tuple[float, float], colour: Colour = WHITE, *, size: float = 0.5, rim: bool = False
    ) -> None:
        """Write a line of text, its left end and the middle of its height at a point; what is not ASCII as ``?``."""
        plain = _plain(text)
        place = (round(at[0]), round(at[1] + 10 * size * self.unit))
        if rim:
            cv2.putText(self.image, plain, place, _FONT, size * self.unit, DARK, self._thickness(3.5), cv2.LINE_AA)
        cv2.putText(self.image, plain, place, _FONT, size * self.unit, colour, self._thickness(1.2), cv2.LINE_AA)

    def text_width(self, text: str, size: float = 0.5) -> float:
        """Width of a line of text, px."""
        return float(cv2.getTextSize(_plain(text), _FONT, size * self.unit, self._thickness(1.2))[0][0])

    def wrapped(self, text: str, width: float, size: float = 0.5) -> list[str]:
        """Break a text into lines no wider than ``width`` px, between words where that is possible."""
        lines = [""]
        for word in text.split():
            longer = f"{lines[-1]} {word}".strip()
            if lines[-1] and self.text_width(longer, size) > width:
                lines.append(word)
            else:
                lines[-1] = longer
        return lines

    def _thickness(self, width: float) -> int:
        return max(1, round(width * self.unit))

    def _stroke(self, points: NDArray[np.float64], colour: Colour, width: float, rim: bool) -> None:
        if rim:
            self._draw(points, DARK, width + 1.6)
        self._draw(points, colour, width)

    def _draw(self, points: NDArray[np.float64], colour: Colour, width: float) -> None:
        fixed = np.rint(points * 2**_SHIFT).astype(np.int32)
        cv2.polylines(self.image, [fixed], False, colour, self._thickness(width), cv2.LINE_AA, _SHIFT)

    def _inside(self, points: NDArray[np.float64]) -> Iterator[NDArray[np.float64]]:
        """Stretches of a polyline that are on the canvas or near it: OpenCV's coordinates overflow far outside."""
        size = np.array([self.image.shape[1], self.image.shape[0]])
        with np.errstate(invalid="ignore"):
            near = np.asarray(((points > -2 * size) & (points < 3 * size)).all(axis=1))
        for part in np.split(np.arange(len(points)), np.flatnonzero(np.diff(near.astype(int))) + 1):
            if len(part) > 1 and near[part[0]]:
                yield points[part]


def _dashed(points: NDArray[np.float64], dash: NDArray[np.float64], phase: float) -> Iterator[NDArray[np.float64]]:
    """Cut a polyline into strokes."""
    length = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    for start in np.arange(-(phase % dash.sum()), length[-1], dash.sum()):
        first, last = max(start, 0.0), min(start + dash[0], length[-1])
        if last > first:
            at = np.concatenate([[first], length[(length > first) & (length < last)], [last]])
            yield np.stack([np.interp(at, length, points[:, k]) for k in range(2)], axis=1)


def _plain(text: str) -> str:
    """OpenCV's letters are ASCII only."""
    return text.encode("ascii", "replace").decode("ascii")
