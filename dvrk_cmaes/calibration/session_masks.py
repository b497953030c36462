"""What a session tells of the errors that its masks share, and the margin by which they are too wide or too narrow.

A single frame cannot tell a margin from a shorter distance. In a session the arm moves along the optical axis by
amounts that its joints state, and a margin makes near and far shafts wider by the same number of pixels.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from dvrk_cmaes.calibration.blocks import Calibration, OutlineOfView, SeenBlock, ViewAsSeen
from dvrk_cmaes.calibration.linearise import ArmOutlines, linearise
from dvrk_cmaes.calibration.solve import ArmFrames, marginalise, solve_arms, solve_unchanged
from dvrk_cmaes.geometry import Float64, Posed
from dvrk_cmaes.io.encode import Document
from dvrk_cmaes.io.typed_document import Number, refused
from dvrk_cmaes.pose.terms.coverage import of_margin

if TYPE_CHECKING:
    from dvrk_cmaes.calibration.mask_growth import GrowthEstimate


MARGIN = "margin"
"""Name of the block."""

_STD = 1.0  # px beforehand
_CLEAR = 2.5  # standard deviations from zero, and ...
_LEAST_MARGIN = 0.15  # ... px, beyond which a margin is taken off the masks
_LEAST_STD = 0.12  # px; margins of parts of one real recording, 0.57 to 1.11, scatter by this beside their errors
_ON_SIDES = 6  # errors of both sides of the shaft, and of what faces four directions
_PASSES = 5  # largest number of linearisations
_MARGIN_STEPS = 2  # linearisations of the outlines from whole masks to those less the margin


class MaskMargin(SeenBlock):
    """The margin (1,), px, by which a segmenter makes all masks too wide, from where estimates ``start``."""

    shared = True

    def __init__(self, start: float = 0.0) -> None:
        super().__init__(MARGIN, np.array([_STD]), np.array([start]))

    @property
    def least_std(self) -> Float64:
        """Standard deviation (1,), px, by which margins of parts of one recording differ."""
        return np.array([_LEAST_STD])

    def seen(self, name: str, by: ViewAsSeen, values: Float64) -> ViewAsSeen:
        """Return a view whose mask has the margin."""
        return replace(by, margin=by.margin + float(values[0]))

    def effect(self, outline: OutlineOfView) -> Float64:
        """Return the displacements of an outline's points by the margin."""
        return of_margin(outline.points)[:, None]


@dataclass(frozen=True)
class Margin:
    """The margin by which all masks are too wide, its standard deviation, and whether it is taken off, px."""

    px: float
    std_px: float
    applied: bool

    @classmethod
    def of(cls, px: float, std_px: float) -> Margin:
        """Return a margin, which is taken off if it is clear."""
        return cls(px, std_px, abs(px) > max(_CLEAR * std_px, _LEAST_MARGIN))


@dataclass(frozen=True)
class SessionMasks(Document):
    """What a session's frames tell of the errors that its masks share.

    margin_px : by how much the masks are too wide all round; negative if too narrow. std_margin_px : its standard
    deviation. applied : whether the session was solved with masks less this margin. In a session of several views it is
    estimated in the first one.
    growth_px : mean errors, px, of both sides of the shaft (to the right of its direction towards the tip in the image,
    and to the left) and of what faces right, left, down and up, none below 0. rms_growth_px : the roots of their mean
    squares, with what is not known of them. error_squares : the mean squares (7, 7), px^2, of the margin that is left
    and of these errors. by_errors : what each of them, per px, does to the calibration, in the order of its covariance.
    """

    margin_px: Number
    std_margin_px: Number
    applied: bool
    growth_px: tuple[Number, ...] = ()
    rms_growth_px: tuple[Number, ...] = ()
    error_squares: tuple[tuple[Number, ...], ...] = ()
    by_errors: tuple[tuple[Number, ...], ...] = ()

    @classmethod
    def of(cls, margin: Margin, growth: GrowthEstimate | None = None) -> SessionMasks:
        """State the margin, and the errors that frames share."""
        stated = cls(margin.px, margin.std_px, margin.applied)
        if growth is None:
            return stated
        return replace(
            stated,
            growth_px=tuple(growth.px.tolist()),
            rms_growth_px=tuple(np.sqrt(np.diag(growth.squares)[1:]).tolist()),
            error_squares=_rows(growth.squares),
            by_errors=_rows(growth.of_calibration),
        )

    @property
    def squares(self) -> Float64:
        """Mean squares (7, 7), px^2, of the margin that is left on masks of this session, and of the errors on sides.

        What of the margin was found but is not clear counts as one more standard deviation, at most.
        """
        if self.error_squares:
            squares = np.array(self.error_squares)
            squares[0, 0] += _LEAST_STD**2
            return squares
        left = min(abs(self.margin_px - self.taken_off), self.std_margin_px)
        return np.asarray(np.diag([self.std_margin_px**2 + left**2, *np.zeros(_ON_SIDES)]))

    @property
    def taken_off(self) -> float:
        """Margin, px, that was taken off the masks."""
        return self.margin_px if self.applied else 0.0

    def check(self, where: str, unknowns: int) -> None:
        """Raise `InputError` unless the matrices of a document are those of a calibration with some unknowns.

        Parameters
        ----------
        where
            Where the document is from, for messages.
        unknowns
            Number of the calibration's unknowns, K.
        """
        for name, count in (("error_squares", 1 + _ON_SIDES), ("by_errors", unknowns)):
            rows = getattr(self, name)
            whole = len(rows) == count and all(len(row) == 1 + _ON_SIDES for row in rows)
            if (self.error_squares or self.by_errors) and not whole:  # older files have neither
                raise refused(where, f"masks.{name}", f"{count} rows of {1 + _ON_SIDES} numbers", rows)
        if any(row[i] < 0 for i, row in enumerate(self.error_squares)):
            raise refused(where, "masks.error_squares", "no negative mean square", self.error_squares)

    def after(self, change: Float64) -> SessionMasks:
        """Return the same for a calibration that is a linear function (K', K) of this session's.

        Parameters
        ----------
        change
            The matrix of that function.
        """
        return replace(self, by_errors=_rows(change @ np.array(self.by_errors))) if self.by_errors else self

    def describe(self) -> str:
        """Describe the margin and the errors on one side in words."""
        than, done = "wide" if self.margin_px > 0 else "narrow", "taken off" if self.applied else "left as they are"
        parts = [f"masks are {abs(self.margin_px):.2f} px (std {self.std_margin_px:.2f}) too {than} all round; {done}"]
        if self.rms_growth_px:
            parts.append(f"those that all masks share on one side are up to {max(self.rms_growth_px):.1f} px")
        return "; ".join(parts)


def estimate_margin(arms: Sequence[ArmOutlines]) -> tuple[Margin, list[Calibration], list[Posed]]:
    """Estimate the margin of the masks beside the calibrations and the camera, whose file counts as a measurement.

    Arguments are as in `linearise`; the outlines are those of one view, with the margin among their blocks. Also
    returns the calibration and the poses (N) of each arm with masks less the margin, if it is clear, and the camera of
    the file: a change of the camera that is estimated beside the margin is not used.
    """
    there = linearise(arms, solve_unchanged, [MARGIN], passes=_PASSES)[0]
    (std,) = (float(there.std(one)[0]) for one in arms[0].outlines.blocks if one.name == MARGIN)
    margin = Margin.of(float(there.value(MARGIN)[0]), std)
    at, calibrations = [arm.at for arm in arms], [arm.calibration for arm in arms]
    for _ in range(_MARGIN_STEPS if margin.applied else 0):
        zero = [{one.name: np.zeros(len(one.std)) for one in arm.outlines.blocks} for arm in arms]
        fits = [
            arm.outlines.near(here, none | {MARGIN: there.value(MARGIN)}).at_seen()
            for arm, here, none in zip(arms, at, zero, strict=True)
        ]
        frames = [
            ArmFrames(arm.model, *one) for arm, one in zip(arms, zip(fits, calibrations, strict=True), strict=True)
        ]
        calibrations = [own.calibration for own in solve_arms(frames)]
        moved = [marginalise(one.model, one.fits, own).own for one, own in zip(frames, calibrations, strict=True)]
        at = [here.moved(by) for here, by in zip(at, moved, strict=True)]
    return margin, calibrations, at


def _rows(matrix: Float64) -> tuple[tuple[float, ...], ...]:
    """Return a matrix as the document has it."""
    return tuple(map(tuple, matrix.tolist()))
