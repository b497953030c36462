"""Strips of text above and below an overlay: status and reasons; legend and joints."""

from __future__ import annotations

from collections.abc import Container

import numpy as np

from dvrk_cmaes.draw.canvas import (
    AXES,
    GREEN,
    GREY,
    ORANGE,
    PURPLE,
    SKY_BLUE,
    VERMILLION,
    WHITE,
    YELLOW,
    Colour,
    strip,
)
from dvrk_cmaes.geometry import Image
from dvrk_cmaes.results.result import Result

STATUS: dict[str, Colour] = {"ok": GREEN, "doubtful": ORANGE, "failed": VERMILLION, "lost": VERMILLION}

MASK, SILHOUETTE, FOUND, PROJECTED, SKELETON, STEADY = YELLOW, SKY_BLUE, ORANGE, PURPLE, WHITE, VERMILLION

_LEGEND = (
    ("mask", MASK),
    ("silhouette", SILHOUETTE),
    ("mask, off in a stretch", STEADY),
    ("shaft edges and tips found", FOUND),
    ("those of the pose", PROJECTED),
    ("skeleton", SKELETON),
    ("root axes", GREY),
)
_MOST_REASONS = 4


def header(result: Result, width: int, unit: float) -> Image:
    """Draw the strip with the tips' accuracy, the status, the quality of the fit, and the first reasons.

    Parameters
    ----------
    result
        The result.
    width
        Width of the strip, px.
    unit
        Pixels of a unit of the canvas.
    """
    colour, quality, error = STATUS[result.status], result.quality, result.expected_error
    first = [] if error is None else [(error.in_words, WHITE)]
    first += [(result.status.upper(), colour), (f"{result.frame}  {result.instrument}".strip(), WHITE)]
    if quality is not None:
        fit = f"contour {quality.contour_px_median:.1f} px median, {quality.contour_px_95:.1f} px at 95 %"
        first.append((f"IoU {quality.iou:.3f}, {fit}", WHITE))
    reasons = [f"- {text}" for text in result.reasons]
    if len(reasons) > _MOST_REASONS:
        reasons[_MOST_REASONS - 1 :] = ["- ... (all of them are in the result's JSON)"]
    return strip(width, unit, [first, *([(text, colour)] for text in reasons)])


def footer(result: Result, width: int, unit: float, absent: Container[Colour] = ()) -> Image:
    """Draw the strip with the legend, of a result with a pose, and the joints; other arguments as of `header`.

    The legend leaves out what has one of the ``absent`` colours.
    """
    shown = [(name, colour) for name, colour in _LEGEND if colour not in absent]
    legend = () if result.camera_from_root is None else (*shown, *AXES)
    return strip(width, unit, [legend, [(_joint(result, name), WHITE) for name in result.joints]])


def _joint(result: Result, name: str) -> str:
    """Return a joint's estimate, standard deviation, reading and correction, in degrees."""
    std = (result.std_joints_deg or {}).get(name)
    spread = "" if std is None else f" +- {std:.1f}"
    estimate, read = np.degrees(result.joints[name]), result.readings.get(name)
    read_text = "not read" if read is None else f"read {np.degrees(read):.1f}, {estimate - np.degrees(read):+z.1f}"
    return f"{name} {estimate:.1f}{spread} deg ({read_text})"
