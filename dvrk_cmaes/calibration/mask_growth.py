"""Mean errors of a session's masks on some sides, such as the shadows of a lamp that is fixed beside the lens.

The errors of single frames average out; what all masks share on one side does not. It has six unknowns: the mean error
of each side of the shaft, and that of what faces right, left, down and up in the image. Shadows only add to a mask, so
none of them is negative. Their usual size is that which makes the session's outlines most likely: masks without such
errors hardly widen what is known of a session, and masks that do not fit its poses on one side do.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from dvrk_cmaes.calibration.blocks import OutlineOfView, SeenBlock
from dvrk_cmaes.calibration.linearise import Linearised
from dvrk_cmaes.calibration.session_masks import MARGIN, SessionMasks
from dvrk_cmaes.calibration.solve import marginalise
from dvrk_cmaes.camera import Camera
from dvrk_cmaes.geometry import Float64, Posed, apply
from dvrk_cmaes.instrument import Instrument
from dvrk_cmaes.pose.terms.shared_errors import DIRECTIONS, MEAN_ERRORS, SIDES, image_axis

GROWTH = "growth"
"""Name of the block."""

_STD = 2.0  # px, with which the outlines are linearised
_LEAST, _OF_MARGIN = 0.1, 0.5
"""Size beforehand, beside what the fits show: px of any mask, and share of the margin that is taken off."""
_LOG_STD = 0.7  # of the logarithm of the size beforehand
_SIZES = np.geomspace(0.03, 0.999 * _STD, 16)  # px
_NONE = 1e-3  # px, of an error that is not there
_OF_FOUND = 1 / 3
"""Share of the squares of the errors that were found in those that are expected, as they are not taken off.

Outlines hardly tell such an error from one of the arm or base: how much of what is found is the masks' may be anything
from none to all. In 19 made recordings with known truth the base was within 2.2 standard deviations in each direction
with all of the squares and with a third. A base less what all of the found errors do to it was farther off in each of
the six in which that was most.
"""
_MARGIN_PX = 0.08  # of all masks, beyond what the keyframes tell: rounded corners, a segmenter's threshold


class MaskGrowth(SeenBlock):
    """The errors (6,), px: of both sides of the shaft, and of what faces right, left, down and up in the image.

    Parameters
    ----------
    side_px
        By how much the masks lie outwards of a side of the shaft in the mean over the session's fits, px.
    margin_px
        The margin that was taken off the masks, px.
    """

    is_linear = True

    def __init__(self, side_px: float = 0.0, margin_px: float = 0.0) -> None:
        super().__init__(GROWTH, np.full(MEAN_ERRORS - 1, _STD))
        size = np.linalg.norm([_LEAST, side_px, _OF_MARGIN * margin_px])
        self.margin_px = margin_px
        self.usual_px = float(np.clip(size, _SIZES[0], _SIZES[-1]))

    def effect(self, outline: OutlineOfView) -> Float64:
        """Return the displacements of an outline's points by the errors."""
        return outline.view.mean_errors(outline.points, outline.at)[:, 1:]


@dataclass(frozen=True, eq=False)
class GrowthEstimate:
    """What a session tells of the errors on some sides, and what they do to it.

    ``px`` (6,) are their means, and ``std_px`` (6,) what is known of them beforehand: their usual size, and next to
    nothing where they would be negative. ``values`` (K + E,) and ``covariance`` (K + E, K + E) are those of the
    calibration, as changes, and all blocks with errors of this size. ``squares`` (7, 7) are the mean squares, px^2,
    of the margin that is left on the masks and of what of these errors may be the masks'. ``of_calibration`` (K, 7) and
    ``of_frames`` (N, D, 7) are the errors of the calibration and of the frames' poses that each of them causes, per px.
    """

    px: Float64
    std_px: Float64
    values: Float64
    covariance: Float64
    squares: Float64
    of_calibration: Float64
    of_frames: Float64


def estimate_growth(there: Linearised, growth: MaskGrowth, beside: Mapping[str, Float64 | float]) -> GrowthEstimate:
    """Tell the size of the errors on some sides, and what they do, from outlines that were linearised in them.

    Parameters
    ----------
    there
        The session with the block among its blocks.
    growth
        The block.
    beside
        Standard deviations beforehand of other blocks, by name, with which ``squares`` is told: a camera's file.
    """
    calibration, count = there.solution.calibration, there.solution.calibration.own
    place = calibration.place(GROWTH)
    of_outlines = np.linalg.inv(there.covariance[place, place])
    seen = there.value(GROWTH)
    std = np.full(
        len(seen), _likely_size(of_outlines - np.eye(len(seen)) / _STD**2, of_outlines @ seen, growth.usual_px)
    )
    for _ in range(len(seen)):
        known, spread = there.with_std({GROWTH: std})
        below = (known[place] < 0) & (std > _NONE)
        if not below.any():
            break
        std[below] = _NONE
    both = np.r_[calibration.place(MARGIN), place]
    left, of_errors = there.with_std({GROWTH: std, **beside})
    left[calibration.place(MARGIN)] -= growth.margin_px
    not_told = np.r_[left[calibration.place(MARGIN)], np.sqrt(_OF_FOUND) * left[place]]
    information = there.information
    of_calibration = np.asarray(np.linalg.solve(information[:count, :count], information[:count, both]), np.float64)
    frames = marginalise(there.model, there.fits, calibration)
    by_all = frames.gain @ there.model.jacobian(calibration)
    return GrowthEstimate(
        np.maximum(left[place], 0.0),
        std,
        known,
        spread,
        np.asarray(of_errors[np.ix_(both, both)] + np.outer(not_told, not_told), dtype=np.float64),
        of_calibration,
        by_all[:, :, :count] @ of_calibration - by_all[:, :, both],
    )


def _likely_size(information: Float64, slope: Float64, usual_px: float) -> float:
    """Return the size, px, of errors of which the outlines tell this, as the mean of its logarithm."""
    logs = []
    for size in _SIZES:
        whole = information + np.eye(len(slope)) / size**2
        likely = slope @ np.linalg.solve(whole, slope) - np.linalg.slogdet(whole)[1] - 2 * len(slope) * np.log(size)
        logs.append(0.5 * (likely - (np.log(size / usual_px) / _LOG_STD) ** 2))
    probability = np.exp(np.array(logs) - max(logs))
    return float(np.exp(probability @ np.log(_SIZES) / probability.sum()))


def change_by_margin(at: Posed, camera: Camera, instrument: Instrument) -> Float64:
    """Return the change (D,) of a pose, per px, by which an outline seems wider on every side: the tool is nearer.

    A shaft that looks wider by twice the margin is nearer in the same proportion.
    """
    along = np.zeros(6 + len(at.joints))
    if instrument.shaft is not None:
        tips = apply(at.pose, instrument.ends(at.joints)).mean(axis=0)
        width = camera.fx * 2 * instrument.shaft.radius / float(np.linalg.norm(tips))
        along[:3] = -at.pose[:3, :3].T @ tips * 2 / width
    return along


def changes_by_masks(at: Posed, camera: Camera, instrument: Instrument) -> Float64:
    """Return the changes (D, 7) of a pose that fits an outline, per px of the masks' margin and of each growth.

    Half of the error of a side of the shaft is a margin, which makes it seem nearer; half of it moves its axis aside.

    Parameters
    ----------
    at
        The pose.
    camera, instrument
        The camera that sees the instrument.
    """
    nearer = change_by_margin(at, camera, instrument)
    moves = np.zeros((len(nearer), MEAN_ERRORS))
    moves[:, 0] = nearer
    if instrument.shaft is None:
        return moves
    along, aside = image_axis(instrument, camera, at)
    across = np.array([-aside, along])
    sides = np.column_stack([np.eye(SIDES), np.maximum(np.array([across, -across]) @ DIRECTIONS, 0.0)])
    distance = float(np.linalg.norm(apply(at.pose, instrument.ends(at.joints)).mean(axis=0)))
    moved = at.pose[:3, :3].T @ [*across, 0.0] * distance / camera.fx
    moves[:, 1:] = np.outer(nearer, sides.mean(axis=0))
    moves[:3, 1:] += np.outer(moved, (sides[0] - sides[1]) / SIDES)
    return moves


def covariance_of_masks(masks: SessionMasks | None, own: Float64, by_calibration: Float64 | None = None) -> Float64:
    """Return the covariance (D, D) of a pose by the errors that all masks of a session share.

    Parameters
    ----------
    masks
        What the session tells of these errors; None where they were not estimated.
    own : (D, 7)
        Changes of the pose by the errors in its own mask, given the calibration, as of `changes_by_masks`.
    by_calibration : (D, K)
        Changes of the pose with the calibration, which the same errors have moved; None if it does not rest on one.
    """
    squares, moves = np.zeros((own.shape[1],) * 2), own
    squares[0, 0] = _MARGIN_PX**2
    if masks is not None:
        squares += masks.squares
        if by_calibration is not None and masks.by_errors:
            moves = own + by_calibration @ np.array(masks.by_errors)
    return np.asarray(moves @ squares @ moves.T)
