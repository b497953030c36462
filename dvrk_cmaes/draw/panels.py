"""Strips of text above and below an overlay: status and reasons; legend and joints."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.draw.canvas import (
    AXES,
    DARK,
    GREEN,
    GREY,
    ORANGE,
    PURPLE,
    SKY_BLUE,
    VERMILLION,
    WHITE,
    YELLOW,
    Canvas,
    Colour,
    plain,
)
from dvrk_cmaes.results.result import Result

BADGES: dict[str, tuple[str, Colour]] = {
    "ok": ("OK", GREEN),
    "doubtful": ("DOUBTFUL", ORANGE),
    "failed": ("FAILED", VERMILLION),
}

MASK, SILHOUETTE, FOUND, PROJECTED, SKELETON, STEADY = YELLOW, SKY_BLUE, ORANGE, PURPLE, WHITE, VERMILLION

LEGEND = (
    ("mask", MASK, "line"),
    ("silhouette", SILHOUETTE, "line"),
    ("mask only", MASK, "area"),
    ("silhouette only", SILHOUETTE, "area"),
    ("mask, off in a stretch", STEADY, "line"),
    ("shaft edges, found", FOUND, "dash"),
    ("projected", PROJECTED, "dash"),
    ("tips, found", FOUND, "cross"),
    ("projected", PROJECTED, "ring"),
    ("skeleton", SKELETON, "line"),
    ("root axes", WHITE, "axes"),
)
"""Text, colour and kind of sample of each entry of the legend, which overlays with a pose have."""

Places = list[list[tuple[int, float]]]
"""Index and left end, px, of the entries of each row."""

_BACKGROUND: Colour = (52, 46, 43)
_LINE = 26.0  # units of the canvas from line to line
_MARGIN = 14.0  # units of the canvas
_MOST_REASONS = 4  # lines of reasons


def _strip(width: int, lines: int, unit: float) -> Canvas:
    return Canvas(plain(_height(lines, unit), width, _BACKGROUND), unit)


def _height(lines: int, unit: float) -> int:
    return max(1, round((lines * _LINE + 12) * unit))


def header(result: Result, width: int, unit: float) -> NDArray[np.uint8]:
    """Draw the strip above: accuracy, status, frame, IoU, contour distances and the reasons, (h, width, 3) BGR."""
    margin = _MARGIN * unit
    reasons = _reasons(result, width, unit)
    canvas = _strip(width, 1 + len(reasons), unit)
    middle = (6 + _LINE / 2) * unit
    left, right = margin, width - margin
    if result.expected_error is not None:
        canvas.text(result.expected_error.in_words, (left, middle), WHITE, size=0.6)
        left += canvas.text_width(result.expected_error.in_words, 0.6) + 14 * unit
    word, colour = BADGES[result.status]
    badge = canvas.text_width(word, 0.6) + 16 * unit
    canvas.box((left, middle - 11 * unit), (badge, 22 * unit), colour)
    canvas.text(word, (left + 8 * unit, middle), DARK, size=0.6)
    left += badge + 14 * unit
    if result.quality is not None:
        q = result.quality
        text = f"IoU {q.iou:.3f}   contour {q.contour_px_median:.1f} px median, {q.contour_px_95:.1f} px at 95 %"
        right -= canvas.text_width(text, 0.55)
        canvas.text(text, (right, middle), WHITE, size=0.55)
    name = f"{result.frame}  {result.instrument}".strip()
    while len(name) > 8 and left + canvas.text_width(name, 0.6) > right - 14 * unit:
        name = name[:-4] + "..."
    canvas.text(name, (left, middle), WHITE, size=0.6)
    for k, line in enumerate(reasons, start=1):
        canvas.text(line, (margin, middle + k * _LINE * unit), colour)
    return canvas.image


def footer(result: Result, width: int, unit: float) -> NDArray[np.uint8]:
    """Draw the strip below: the legend, and each joint's estimate and reading, (h, width, 3) BGR."""
    rows, columns = _rows(result, width, unit)
    joints = [_joint(result, name) for name in result.joints]
    below = len(rows)
    canvas = _strip(width, below + len(columns), unit)

    def middle(row: int) -> float:
        return (6 + _LINE * (row + 0.5)) * unit

    for row, places in enumerate(rows):
        for index, left in places:
            text, colour, kind = LEGEND[index]
            _sample(canvas, kind, colour, left, middle(row))
            canvas.text(text, (left + 34 * unit, middle(row)), GREY)
    for row, places in enumerate(columns):
        for index, left in places:
            canvas.text(joints[index], (left, middle(below + row)), WHITE)
    return canvas.image


def _reasons(result: Result, width: int, unit: float) -> list[str]:
    """Return the lines of a result's reasons, as many as are drawn."""
    probe = _strip(width, 1, unit)
    lines = [line for text in result.reasons for line in probe.wrapped(f"- {text}", width - 2 * _MARGIN * unit)]
    if len(lines) > _MOST_REASONS:
        lines[_MOST_REASONS - 1 :] = ["- ... (all of them are in the result's JSON)"]
    return lines


def _rows(result: Result, width: int, unit: float) -> tuple[Places, Places]:
    """Lay out the legend and the joints in rows, as `_flow`."""
    probe = _strip(width, 1, unit)
    legend = () if result.camera_from_root is None else LEGEND
    rows = _flow([probe.text_width(text) + 56 * unit for text, _, _ in legend], width, unit)
    joints = (_joint(result, name) for name in result.joints)
    return rows, _flow([probe.text_width(text) + 28 * unit for text in joints], width, unit)


def _joint(result: Result, name: str) -> str:
    """Return one joint as text: estimate and standard deviation, reading, and their difference."""
    std = (result.std_joints_deg or {}).get(name)
    spread = "" if std is None else f" +- {std:.1f}"
    estimate, read = np.degrees(result.joints[name]), result.readings.get(name)
    read_text = "not read" if read is None else f"read {np.degrees(read):.1f}, {estimate - np.degrees(read):+z.1f}"
    return f"{name} {estimate:.1f}{spread} deg ({read_text})"


def _flow(widths: Sequence[float], width: float, unit: float) -> Places:
    """Lay out entries of given widths, px, in rows; each row lists the index and the left end of its entries."""
    rows: Places = []
    left = np.inf
    for index, wide in enumerate(widths):
        if left + wide > width:
            rows.append([])
            left = _MARGIN * unit
        rows[-1].append((index, left))
        left += wide
    return rows


def _sample(canvas: Canvas, kind: str, colour: Colour, left: float, middle: float) -> None:
    """Draw the sample of a legend's entry, 26 units wide."""
    unit = canvas.unit
    ends = np.array([[left, middle], [left + 26 * unit, middle]])
    centre = ends.mean(axis=0)
    if kind == "area":
        shaded: Colour = (colour[0] // 2 + 30, colour[1] // 2 + 30, colour[2] // 2 + 30)
        canvas.box((left + 3 * unit, middle - 6 * unit), (20 * unit, 12 * unit), shaded)
    elif kind == "cross":
        canvas.cross(centre, colour, 5.0)
    elif kind == "axes":
        for k, (name, own) in enumerate(AXES):
            canvas.text(name, (left + 9 * k * unit, middle), own, size=0.6)
    elif kind == "ring":
        canvas.ring(centre, colour, 6.0)
    else:
        canvas.line(ends, colour, width=2.0, dash=(10, 6) if kind == "dash" else None, rim=False)
