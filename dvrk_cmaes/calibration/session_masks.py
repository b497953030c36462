"""What a session tells of the margin by which its masks are too wide or too narrow.

A single frame cannot tell a margin from a shorter distance. In a session the arm moves along the optical axis by
amounts that its joints state, and a margin makes near and far shafts wider by the same number of pixels.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final, NamedTuple

import numpy as np

from dvrk_cmaes.calibration.blocks import Calibration, OutlineOfView, SeenBlock, ViewAsSeen
from dvrk_cmaes.calibration.linearise import ArmOutlines, Linearised, linearise, with_mixture
from dvrk_cmaes.calibration.solve import marginalise
from dvrk_cmaes.config import SessionConfig
from dvrk_cmaes.geometry import Float64, Posed
from dvrk_cmaes.io.encode import Document
from dvrk_cmaes.io.typed_document import Number
from dvrk_cmaes.pose.terms.coverage import of_margin

MARGIN: Final = "margin"
"""Name of the block."""

_STD, _WIDE_SHARE = 1.0, 0.2  # px, of the prior, and the share of segmenters with it
_USUAL_STD = 0.05  # px, the same of the others, in images 640 px wide; recordings of `fleet.py make` show no more
_FREE = 100.0  # px, of a prior that does not count
_LEAST_STD = 0.12  # px; margins of parts of one real recording, 0.57 to 1.11, scatter by this beside their errors
_PASSES = 5  # largest number of linearisations
_HELD = 1e-3  # of the prior standard deviations of a camera that is held at its file
_MARGIN_PX = 0.08  # of all masks, beyond what the keyframes tell: rounded corners, a segmenter's threshold


class MaskMargin(SeenBlock):
    """The margin (1,), px, by which a segmenter makes all masks too wide, from where estimates ``start``."""

    shared = True

    def __init__(self, start: float = 0.0) -> None:
        super().__init__(MARGIN, np.array([_STD]), np.array([start]))
        self.least_std = np.array([_LEAST_STD])

    def seen(self, name: str, by: ViewAsSeen, values: Float64) -> ViewAsSeen:
        """Return a view whose mask has the margin."""
        return replace(by, margin=by.margin + float(values[0]))

    def effect(self, outline: OutlineOfView) -> Float64:
        """Return the displacements of an outline's points by the margin."""
        return of_margin(outline.points)[:, None]


class MarginEffect(NamedTuple):
    """What a margin of all masks does, per px: to the K unknowns of a calibration (K,), and to N frames' poses (N, D).

    ``px`` and ``std_px`` are the margin that the same outlines show.
    """

    px: float
    std_px: float
    of_calibration: Float64
    of_frames: Float64

    @classmethod
    def of(cls, there: Linearised) -> MarginEffect:
        """Return it by outlines that were linearised with the margin among the blocks."""
        calibration, count = there.solution.calibration, there.solution.calibration.own
        place, of_calibration = calibration.place(MARGIN), -there.moved_by(MARGIN)
        frames = marginalise(there.model, there.fits, calibration)
        by_all = frames.gain @ there.model.jacobian(calibration)
        of_frames = by_all[:, :, :count] @ of_calibration - by_all[:, :, place]
        std = np.hypot(np.sqrt(there.covariance[place, place].item()), _LEAST_STD)
        return cls(there.value(MARGIN).item(), float(std), of_calibration[:, 0], of_frames[:, :, 0])

    def stated(self, masks: SessionMasks | None) -> SessionMasks:
        """Return what is stated of the masks with this effect, whose margin is left as it is where none is stated."""
        known = SessionMasks(self.px, self.std_px, applied=False) if masks is None else masks
        return replace(known, by_margin=tuple(self.of_calibration.tolist()))


@dataclass(frozen=True)
class SessionMasks(Document):
    """What a session's frames tell of the margin of its masks.

    margin_px : by how much the masks are too wide all round; negative if too narrow. std_margin_px : its standard
    deviation. applied : whether the session was solved with masks less this margin. In a session of several views it is
    estimated in the first one.
    by_margin : what the margin, per px, does to the calibration, in the order of its covariance.
    """

    margin_px: Number
    std_margin_px: Number
    applied: bool
    by_margin: tuple[Number, ...] = ()

    @property
    def square(self) -> float:
        """Mean square, px^2, of the margin that is left on masks of this session."""
        return self.std_margin_px**2 + (self.margin_px - self.taken_off) ** 2

    @property
    def taken_off(self) -> float:
        """Margin, px, that was taken off the masks."""
        return self.margin_px if self.applied else 0.0

    def after(self, change: Float64) -> SessionMasks:
        """Return the same for a calibration that is a linear function (K', K) of this session's.

        Parameters
        ----------
        change
            The matrix of that function.
        """
        return replace(self, by_margin=tuple((change @ self.by_margin).tolist())) if self.by_margin else self

    def describe(self) -> str:
        """Describe the margin in words."""
        than, done = "wide" if self.margin_px > 0 else "narrow", "taken off" if self.applied else "left as they are"
        return f"masks are {abs(self.margin_px):.2f} px (std {self.std_margin_px:.2f}) too {than} all round; {done}"


def estimate_margin(
    arms: Sequence[ArmOutlines], config: SessionConfig
) -> tuple[SessionMasks, list[tuple[Calibration, Posed]]]:
    """Estimate the margin of the masks beside the calibrations and the camera, whose file counts as a measurement.

    Arguments are as in `linearise`; the outlines are those of one view, with the margin among their blocks. Also
    returns the calibration and the poses (N) of each arm with masks less the margin and the camera of the file: a
    change of the camera that is estimated beside the margin is not used.
    """
    there, moved = linearise(arms, config, [MARGIN], passes=_PASSES), []
    place, camera = there[0].solution.calibration.place(MARGIN), arms[0].camera
    shown, spread = there[0].with_std({MARGIN: _FREE})
    priors = (1 - _WIDE_SHARE, np.array([_USUAL_STD * camera.pixel_scale])), (_WIDE_SHARE, np.array([_STD]))
    mean, square = with_mixture(shown[place], spread[place, place] + _LEAST_STD**2, priors)
    px, std = mean.item(), float(np.sqrt(square.item() - mean.item() ** 2))
    for one, arm in zip(there, arms, strict=True):
        held = {block.name: _HELD * block.std for block in arm.blocks if block.name != MARGIN}
        at_file = one.solution.calibration
        at_file = at_file.changed(one.with_std(held)[0] - np.append(np.zeros(at_file.own), at_file.further))
        poses = marginalise(one.model, one.fits, at_file).own
        moved.append((at_file.alone(), one.fits.at.moved(poses)))
    return SessionMasks(px, std, applied=True), moved


def covariance_of_margin(masks: SessionMasks | None, own: Float64, by_calibration: Float64 | None = None) -> Float64:
    """Return the covariance (D, D) of a pose by the margin of all masks of a session.

    Parameters
    ----------
    masks
        What the session tells of the margin; None where it was not estimated.
    own : (D,)
        Change of the pose by the margin of its own mask, px, given the calibration.
    by_calibration : (D, K)
        Changes of the pose with the calibration, which the same margin has moved; None if it does not rest on one.
    """
    square, moves = _MARGIN_PX**2, own
    if masks is not None:
        square += masks.square
        if by_calibration is not None and masks.by_margin:
            moves = own + by_calibration @ masks.by_margin
    return np.asarray(square * np.outer(moves, moves))
