"""What a session tells of the errors that its masks share, and the margin by which they are too wide or too narrow.

A single frame cannot tell a margin from a shorter distance. In a session the arm moves along the optical axis by
amounts that its joints state, and a margin makes near and far shafts wider by the same number of pixels.

The errors of single frames average out; what all masks share on one side does not. It has six unknowns: the mean error
of each side of the shaft, and that of what faces right, left, down and up in the image. Shadows only add to a mask, so
none of them is negative. Their usual size is that which makes the session's outlines most likely: masks without such
errors hardly widen what is known of a session, and masks that do not fit its poses on one side do.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from dvrk_cmaes.calibration.blocks import Calibration, OutlineOfView, SeenBlock, ViewAsSeen
from dvrk_cmaes.calibration.linearise import ArmOutlines, Linearised, linearise
from dvrk_cmaes.calibration.solve import ArmFrames, marginalise, solve_arms, solve_unchanged
from dvrk_cmaes.geometry import Float64, Posed
from dvrk_cmaes.io.encode import Document
from dvrk_cmaes.io.typed_document import Number, refused
from dvrk_cmaes.pose.terms.coverage import of_margin
from dvrk_cmaes.pose.terms.shared_errors import MEAN_ERRORS, SIDES

MARGIN, BIAS = "margin", "mask_bias"
"""Names of the blocks."""

_STD = 1.0  # px beforehand
_CLEAR = 2.5  # standard deviations from zero, and ...
_LEAST_MARGIN = 0.15  # ... px, beyond which a margin is taken off the masks
_LEAST_STD = 0.12  # px; margins of parts of one real recording, 0.57 to 1.11, scatter by this beside their errors
_ON_SIDES = MEAN_ERRORS - 1  # errors of both sides of the shaft, and of what faces four directions
_PASSES = 5  # largest number of linearisations
_MARGIN_STEPS = 2  # linearisations of the outlines from whole masks to those less the margin

_BIAS_STD = 2.0  # px, with which the outlines are linearised
_LEAST, _OF_MARGIN = 0.1, 0.5
"""Prior size besides what the fits show: px of any mask, and share of the margin that is taken off."""
_LOG_STD = 0.7  # of the prior of the logarithm of the size
_SIZES = np.geomspace(0.03, 0.999 * _BIAS_STD, 16)  # px
_SWEEPS = 3  # in which the sizes are estimated one after the other
_NONE = 1e-3  # px, of an error that is not there
_MARGIN_PX = 0.08  # of all masks, beyond what the keyframes tell: rounded corners, a segmenter's threshold


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

    @property
    def counted_px(self) -> float:
        """What counts of a margin that is left on masks: one standard deviation at most where it is not clear."""
        return self.px if self.applied else float(np.clip(self.px, -self.std_px, self.std_px))


class MaskBias(SeenBlock):
    """The errors (6,), px: of both sides of the shaft, and of what faces right, left, down and up in the image.

    Parameters
    ----------
    side_px
        By how much the masks lie outwards of a side of the shaft in the mean over the session's fits, px.
    margin_px
        The margin that was taken off the masks, px.
    """

    is_linear = (False,) * SIDES + (True,) * (_ON_SIDES - SIDES)

    def __init__(self, side_px: float = 0.0, margin_px: float = 0.0) -> None:
        super().__init__(BIAS, np.full(_ON_SIDES, _BIAS_STD))
        size = np.linalg.norm([_LEAST, side_px, _OF_MARGIN * margin_px])
        self.margin_px = margin_px
        self.usual_px = float(np.clip(size, _SIZES[0], _SIZES[-1]))

    def seen(self, name: str, by: ViewAsSeen, values: Float64) -> ViewAsSeen:
        """Return a view whose mask has the errors of the shaft's sides."""
        return replace(by, sides=tuple(values[:SIDES].tolist()))

    def effect(self, outline: OutlineOfView) -> Float64:
        """Return the displacements of an outline's points by the errors."""
        return outline.view.mean_errors(outline.points, outline.at)[:, 1:]


@dataclass(frozen=True, eq=False)
class BiasEstimate:
    """What a session tells of the errors on some sides, and what they do to it.

    ``px`` (6,) are their means, and ``std_px`` (6,) their prior: their usual size, and next to
    nothing where they would be negative. ``squares`` (7, 7) are the mean squares, px^2,
    of the margin that is left on the masks and of what of these errors may be the masks'. ``of_calibration`` (K, 7) and
    ``of_frames`` (N, D, 7) are the errors of the calibration and of the frames' poses that each of them causes, per px.
    """

    px: Float64
    std_px: Float64
    squares: Float64
    of_calibration: Float64
    of_frames: Float64


@dataclass(frozen=True)
class SessionMasks(Document):
    """What a session's frames tell of the errors that its masks share.

    margin_px : by how much the masks are too wide all round; negative if too narrow. std_margin_px : its standard
    deviation. applied : whether the session was solved with masks less this margin. In a session of several views it is
    estimated in the first one.
    bias_px : mean errors, px, of both sides of the shaft (to the right of its direction towards the tip in the image,
    and to the left) and of what faces right, left, down and up, none below 0. rms_bias_px : the roots of their mean
    squares, with what is not known of them. error_squares : the mean squares (7, 7), px^2, of the margin that is left
    and of these errors. by_errors : what each of them, per px, does to the calibration, in the order of its covariance.
    """

    margin_px: Number
    std_margin_px: Number
    applied: bool
    bias_px: tuple[Number, ...] = ()
    rms_bias_px: tuple[Number, ...] = ()
    error_squares: tuple[tuple[Number, ...], ...] = ()
    by_errors: tuple[tuple[Number, ...], ...] = ()

    @classmethod
    def of(cls, margin: Margin, bias: BiasEstimate | None = None) -> SessionMasks:
        """State the margin, and the errors that frames share."""
        stated = cls(margin.px, margin.std_px, margin.applied)
        if bias is None:
            return stated
        return replace(
            stated,
            bias_px=tuple(bias.px.tolist()),
            rms_bias_px=tuple(np.sqrt(np.diag(bias.squares)[1:]).tolist()),
            error_squares=_rows(bias.squares),
            by_errors=_rows(bias.of_calibration),
        )

    @property
    def squares(self) -> Float64:
        """Mean squares (7, 7), px^2, of the margin that is left on this session's masks, and of the errors on sides."""
        if self.error_squares:
            squares = np.array(self.error_squares)
            squares[0, 0] += _LEAST_STD**2
            return squares
        left = Margin.of(self.margin_px - self.taken_off, self.std_margin_px).counted_px
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
            if (self.error_squares or self.by_errors) and not whole:  # where nothing was estimated there is neither
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
        if self.rms_bias_px:
            parts.append(f"those that all masks share on one side are up to {max(self.rms_bias_px):.1f} px")
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


def estimate_bias(there: Linearised, bias: MaskBias, priors: Mapping[str, Float64 | float]) -> BiasEstimate:
    """Estimate the size of the errors on some sides, and what they do, from outlines that were linearised in them.

    Parameters
    ----------
    there
        The session with the block among its blocks.
    bias
        The block.
    priors
        Standard deviations of other blocks' priors, by name, given which ``squares`` is estimated: a camera's file.
    """
    calibration, count = there.solution.calibration, there.solution.calibration.own
    place = calibration.place(BIAS)
    of_outlines = np.linalg.inv(there.covariance[place, place])
    slope = of_outlines @ there.value(BIAS)
    std = _likely_sizes(of_outlines - np.eye(len(slope)) / _BIAS_STD**2, slope, bias.usual_px)
    both = np.r_[calibration.place(MARGIN), place]
    left, of_errors = there.with_std({BIAS: std, **priors})
    margin_std = np.hypot(np.sqrt(of_errors[both[0], both[0]]), _LEAST_STD)
    left[both[0]] = Margin.of(float(left[both[0]] - bias.margin_px), float(margin_std)).counted_px
    information = there.information
    of_calibration = np.asarray(np.linalg.solve(information[:count, :count], information[:count, both]), np.float64)
    frames = marginalise(there.model, there.fits, calibration)
    by_all = frames.gain @ there.model.jacobian(calibration)
    return BiasEstimate(
        np.maximum(left[place], 0.0),
        std,
        np.asarray(of_errors[np.ix_(both, both)] + np.outer(left[both], left[both]), dtype=np.float64),
        of_calibration,
        by_all[:, :, :count] @ of_calibration - by_all[:, :, both],
    )


def _likely_sizes(information: Float64, slope: Float64, usual_px: float) -> Float64:
    """Return the sizes (6,), px, of errors of which the outlines tell this, as means of their logarithms.

    Each is that of one error given the sizes of the others (automatic relevance determination); next to nothing where
    the error would be negative.
    """
    std = np.full(len(slope), usual_px)
    for i in [*range(len(slope))] * _SWEEPS:
        prior = std**-2.0
        prior[i] = 0.0
        covariance = np.linalg.inv(information + np.diag(prior))
        alone, variance = float(covariance[i] @ slope), _SIZES**2 + covariance[i, i]
        logs = -0.5 * (np.log(variance) + alone**2 / variance + (np.log(_SIZES / usual_px) / _LOG_STD) ** 2)
        probability = np.exp(logs - logs.max())
        std[i] = np.exp(probability @ np.log(_SIZES) / probability.sum()) if alone > 0 else _NONE
    return std


def covariance_of_masks(masks: SessionMasks | None, own: Float64, by_calibration: Float64 | None = None) -> Float64:
    """Return the covariance (D, D) of a pose by the errors that all masks of a session share.

    Parameters
    ----------
    masks
        What the session tells of these errors; None where they were not estimated.
    own : (D, 7)
        Changes of the pose by the errors in its own mask, px, given the calibration.
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
