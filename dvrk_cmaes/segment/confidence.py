"""How far a mask that was found in an image can be trusted, without knowing the right one.

Three questions, each answered by a share of 1: do the colours just inside and just outside differ, pixel by pixel? Does
the image change across the outline, more than it does beside it? Is the mask shaped like an instrument in view?
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.evidence.outline_noise import sampled, signed_distance
from dvrk_cmaes.segment.colours import Colours
from dvrk_cmaes.segment.prompts import Prompts
from dvrk_cmaes.segment.regions import border_of, meets_border

Bool = NDArray[np.bool_]
Float32 = NDArray[np.float32]

GUESS = 0.5  # below, a mask is called a guess

_BAND = (2.0, 12.0)  # px from the outline, where colours are compared
_ACROSS = 4.0  # px from the outline, where the image is compared with itself
_FARTHER, _SHARP = 12.0, 0.5  # px, and the share of the change over that reach which an edge has over the shorter one
_BESIDE = 16.0  # px beside the outline, where the background is compared with itself
_CLEAR = 2.0  # times the background's own change, for an edge to be one
_LEAST_AREA, _LARGEST_AREA = 0.004, 0.6  # of the image
_MOST_SIDES = 2  # of the image, that an instrument comes in over
_FROM_NOWHERE = 0.45  # plausibility of what does not come in from the border: a guess
_ONE_PIECE = 0.8  # of the mask, in its largest region


@dataclass(frozen=True)
class Trust:
    """The three answers, 0 to 1 each, and in words what speaks against a mask.

    separation : how much better than chance colours tell inside from outside near the outline.
    edges : share of the outline across which the image changes clearly.
    plausibility : 1, lessened by each way in which the mask is not like an instrument in view.
    """

    separation: float
    edges: float
    plausibility: float
    notes: tuple[str, ...]

    @property
    def confidence(self) -> float:
        """All three together, 0 to 1: a mask is as good as the weakest, lessened by the others."""
        return float(np.clip(self.separation * np.sqrt(self.edges) * self.plausibility, 0, 1))


def trust(mask: Bool, window: tuple[slice, slice], odds: Float32, colours: Colours, *, prompts: Prompts) -> Trust:
    """Judge a mask.

    Parameters
    ----------
    mask
        (H, W).
    window
        Of the image, (h, w), that holds the mask and what is around it.
    odds
        (h, w), log-odds by the colours alone.
    colours
        The window's.
    prompts
        If somebody said where the instrument is, it need not come in from the border.
    """
    if not mask.any() or mask.all() or mask[window].all():
        return Trust(0.0, 0.0, 0.0, ("no instrument found",))
    away = signed_distance(mask[window])
    separation = _separation(odds, away)
    edges = _edges(away, colours)
    plausibility, notes = _plausibility(mask, prompts)
    if separation < 0.6:
        notes.append("colours inside and outside the mask hardly differ")
    if edges < 0.6:
        notes.append("much of the mask's outline follows no edge in the image")
    return Trust(separation, edges, plausibility, tuple(notes))


def _separation(odds: Float32, away: Float32) -> float:
    """How much better than chance the odds tell the two sides of the outline apart."""
    inside, outside = ((side > _BAND[0]) & (side < _BAND[1]) for side in (-away, away))
    if not inside.any() or not outside.any():
        return 0.0
    right = 0.5 * float((odds[inside] > 0).mean() + (odds[outside] < 0).mean())
    return max(2 * right - 1, 0.0)


def _edges(away: Float32, colours: Colours) -> float:
    """Share of the outline across which the image changes sharply, and clearly more than the background does."""
    across, farther = _changes(away, colours, 0.0, (_ACROSS, _FARTHER))
    if not len(across):
        return 0.0
    beside = _changes(away, colours, _BESIDE, (_ACROSS,))[0]
    own = float(np.median(beside)) if len(beside) else 0.0
    least = max(_CLEAR * own, 2 * colours.noise / max(float(np.median(colours.brightness)), 1.0))
    return float(((across > least) & (across > _SHARP * farther)).mean())


def _changes(away: Float32, colours: Colours, level: float, reaches: Sequence[float]) -> list[NDArray[np.float64]]:
    """Measure changes of the image, in logarithms of its colours, across a level line of the distance.

    One array (N,) for each reach, px, to either side of the same points of the line.
    """
    height, width = away.shape
    found, _ = cv2.findContours((away < level).astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    points = np.concatenate([chain[:, 0, :] for chain in found]).astype(np.float64)
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
    """Whether a mask is shaped like an instrument in view, and in words where not."""
    likely, notes = 1.0, []
    border, share = border_of(mask), float(mask.mean())
    if not prompts.given and not meets_border(mask, prompts.outside):
        likely *= _FROM_NOWHERE
        notes.append("the mask does not come in from the image's border, as instruments do")
    if border.sides > _MOST_SIDES:
        likely *= 0.5
        notes.append(f"the mask meets {border.sides} sides of the image")
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
