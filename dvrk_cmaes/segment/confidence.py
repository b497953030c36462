"""Confidence in a mask that was found in an image, estimated without the true mask.

Three measures from 0 to 1 are multiplied: how well the colours inside and outside the outline are separated; the share
of the outline that lies on an edge of the image; and a plausibility by the mask's size, position and number of pieces.
"""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.evidence.outline_noise import sampled, signed_distance
from dvrk_cmaes.geometry import Bool, Float32
from dvrk_cmaes.segment.colours import Colours
from dvrk_cmaes.segment.prompts import Prompts
from dvrk_cmaes.segment.regions import meets_border, sides_met

_BAND = (2.0, 12.0)  # px, distances from the outline between which colours are compared
_ACROSS = 4.0  # px, distance of the two points on either side of the outline whose difference is measured
_FARTHER, _SHARP = 12.0, 0.5  # px; least ratio of the difference over _ACROSS to that over _FARTHER at an edge
_FARTHER_OUT = 16.0  # px from the outline, of the level line along which the background's differences are measured
_CLEAR = 2.0  # least ratio of the difference at an edge to the median difference in the background
_LEAST_AREA, _LARGEST_AREA = 0.004, 0.6  # fractions of the image
_MOST_SIDES = 2  # largest number of the image's sides that an instrument meets
_NO_BORDER_CONTACT = 0.45  # factor for a mask that does not meet the border; below GUESS
_ONE_PIECE = 0.8  # least share of the mask's area in its largest region


def assess_mask(
    mask: Bool, window: tuple[slice, slice], odds: Float32, colours: Colours, *, prompts: Prompts
) -> tuple[float, tuple[str, ...]]:
    """Return the confidence in a mask, 0 to 1, and messages for the user about what speaks against it.

    The confidence is the separation, which is 2 a - 1 for a balanced accuracy a of classifying pixels near the outline
    by colour, times the square root of the share of the outline on an edge of the image times the plausibility.

    Parameters
    ----------
    mask
        (H, W).
    window
        Rows and columns of the image, (h, w), that hold the mask and its surroundings.
    odds
        (h, w), log-odds of instrument by the colours alone.
    colours
        Colours of the window.
    prompts
        With a box or points on the instrument, a mask that is small or does not meet the border is not implausible.
    """
    if not mask.any() or mask.all() or mask[window].all():
        return 0.0, ("no instrument found",)
    away = signed_distance(mask[window])
    separation = _separation(odds, away)
    edges = _edges(away, colours)
    plausibility, notes = _plausibility(mask, prompts)
    if separation < 0.6:
        notes.append("colours inside and outside the mask hardly differ")
    if edges < 0.6:
        notes.append("much of the mask's outline follows no edge in the image")
    return float(np.clip(separation * np.sqrt(edges) * plausibility, 0, 1)), tuple(notes)


def _separation(odds: Float32, away: Float32) -> float:
    """Return 2 a - 1, at least 0, for the balanced accuracy a of the log-odds' sign on the outline's two sides.

    ``away`` (h, w) is the signed distance from the outline, px, positive outside.
    """
    inside, outside = ((side > _BAND[0]) & (side < _BAND[1]) for side in (-away, away))
    if not inside.any() or not outside.any():
        return 0.0
    right = 0.5 * float((odds[inside] > 0).mean() + (odds[outside] < 0).mean())
    return max(2 * right - 1, 0.0)


def _edges(away: Float32, colours: Colours) -> float:
    """Return the share of the outline's points across which the image changes sharply and more than the background."""
    across, farther = _changes(away, colours, 0.0, (_ACROSS, _FARTHER))
    if not len(across):
        return 0.0
    around = _changes(away, colours, _FARTHER_OUT, (_ACROSS,))[0]
    own = float(np.median(around)) if len(around) else 0.0
    least = max(_CLEAR * own, 2 * colours.noise / max(float(np.median(colours.brightness)), 1.0))
    return float(((across > least) & (across > _SHARP * farther)).mean())


def _changes(away: Float32, colours: Colours, level: float, reaches: Sequence[float]) -> list[NDArray[np.float64]]:
    """Measure differences of the image's features across a level line of the signed distance.

    Returns one array (N,) for each reach, px: norms of the differences between points at this distance on either side
    of the line, at the same N points of the line.
    """
    height, width = away.shape
    chains, _ = cv2.findContours((away < level).astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    points = np.concatenate([chain[:, 0, :] for chain in chains]).astype(np.float64)
    keep = (points > _ACROSS).all(axis=1) & (points < [width - 1 - _ACROSS, height - 1 - _ACROSS]).all(axis=1)
    points = points[keep][::3]
    soft = cv2.GaussianBlur(away, (0, 0), 2)
    gradient = [cv2.Sobel(soft, cv2.CV_32F, *order) for order in ((1, 0), (0, 1))]
    normal = np.stack([sampled(np.asarray(part, np.float32), points) for part in gradient], axis=1)
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-9)
    features = cv2.GaussianBlur(colours.features, (0, 0), 1.5)
    parts = [np.ascontiguousarray(features[..., k], dtype=np.float32) for k in range(3)]

    def change(reach: float) -> NDArray[np.float64]:
        ahead, behind = points + reach * normal, points - reach * normal
        differences = np.stack([sampled(part, ahead) - sampled(part, behind) for part in parts])
        return np.asarray(np.linalg.norm(differences, axis=0))

    return [change(reach) for reach in reaches]


def _plausibility(mask: Bool, prompts: Prompts) -> tuple[float, list[str]]:
    """Return the plausibility of a mask, 0 to 1, by size, border contact and pieces; and a message for each defect."""
    likely, notes = 1.0, []
    sides, share = sides_met(mask), float(mask.mean())
    if not prompts.given and not meets_border(mask, prompts.outside):
        likely *= _NO_BORDER_CONTACT
        notes.append("the mask does not come in from the image's border, as instruments do")
    if sides > _MOST_SIDES:
        likely *= 0.5
        notes.append(f"the mask meets {sides} sides of the image")
    if not prompts.given and share < _LEAST_AREA:
        likely *= 0.5
        notes.append(f"the mask is small: {100 * share:.2g} % of the image")
    if share > _LARGEST_AREA:
        likely *= 0.5
        notes.append(f"the mask is large: {100 * share:.0f} % of the image")
    count, _, measures, _ = cv2.connectedComponentsWithStats(mask.astype(np.uint8), connectivity=8)
    if count > 2 and measures[1:, cv2.CC_STAT_AREA].max() < _ONE_PIECE * mask.sum():
        likely *= 0.7
        notes.append("the mask is in pieces")
    return likely, notes
