"""Consensus of the frames on one camera_from_base, with the mode of each frame's pose that it selects.

The method resembles RANSAC. A hypothesis is the calibration that follows from one mode of one frame and this frame's
readings. It predicts the other frames, and its score is the sum over these of a likelihood in which modes far from the
prediction are outliers. The hypothesis with the best score is chosen. Up to a third of the frames may be outliers.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from dvrk_cmaes.calibration.blocks import Calibration
from dvrk_cmaes.calibration.model import SessionModel
from dvrk_cmaes.errors import InputError
from dvrk_cmaes.geometry import Bool, Float64, Indices, Posed, adjoint, inverse
from dvrk_cmaes.instrument.arm import INSERTION_OFFSET, ROLL_OFFSET, ROLL_OFFSET_LONG
from dvrk_cmaes.results.result import Result, modes_of

_MAX_HYPOTHESIS_FRAMES = 60  # frames whose modes are used as hypotheses
_MAX_TEST_FRAMES = 240  # frames on which each hypothesis is scored
_ENOUGH = 0.5  # share of the frames that agree, from which on no other offset of roll is tried
_MAX_ROLLED_FRAMES = 20  # frames whose modes are tried, and scored, at other offsets of roll
_ROLL_STEP = np.deg2rad(20.0)  # between offsets of roll, and standard deviation of each frame's
_ROLLS = np.arange(-4, 5) * _ROLL_STEP
INLIER_MISFIT = 4.0
"""Squared Mahalanobis distance per degree of freedom below which a mode agrees with a prediction."""

_OUTLIER_ANGLE = np.deg2rad(30.0)
_OUTLIER_STD = np.array([0.02, 0.02, 0.02, _OUTLIER_ANGLE, _OUTLIER_ANGLE, 2 * _OUTLIER_ANGLE])
"""Standard deviations of an outlier's pose from the prediction, in the root's axes, m and rad."""


@dataclass(frozen=True, eq=False)
class ArmModes:
    """N frames of an arm, each estimated by itself: the ``model`` of their readings, and the modes of their poses.

    ``modes`` (N, M) are each frame's pose and its alternatives, ``counts`` (N,) their numbers. The last one of a frame
    with fewer than M is repeated, which changes neither the minimum over the frame's modes nor the first index at which
    it is reached. ``covariances`` (N, D, D), D = 6 + J, are of small changes of any of them.
    """

    model: SessionModel
    modes: Posed
    counts: Indices
    covariances: Float64

    @classmethod
    def of_results(cls, model: SessionModel, results: Sequence[Result]) -> ArmModes:
        """Return the frames by their own results: the modes are each pose with its alternatives."""
        every = [modes_of(result, model.names) for result in results]
        counts = np.array([len(own) for own in every])
        padded = [Posed.stacked(own + own[-1:] * (max(counts) - len(own))) for own in every]
        return cls(model, Posed.stacked(padded), counts, np.array([result.covariance for result in results]))

    def subset(self, index: Sequence[int] | Indices) -> Self:
        """Return the frames at some indices."""
        own = {name: getattr(self, name)[index] for name in ("modes", "counts", "covariances")}
        return replace(self, model=self.model.subset(index), **own)

    def mode(self, frames: Indices, numbers: Indices) -> Posed:
        """Return modes (K) by the frames' indices (K,), and the modes' numbers (K,)."""
        return Posed(self.modes.pose[frames, numbers], self.modes.joints[frames, numbers])


@dataclass(frozen=True, eq=False)
class Consensus:
    """A calibration with what N frames say of it, each by its most likely mode.

    ``chosen`` (N,) are the numbers of these modes. ``misfit`` (N,) is the squared Mahalanobis distance of the mode from
    the prediction divided by D. ``cost`` (N,) is twice the negative log-likelihood per degree of freedom, up to a
    constant, and at most that of an outlier. It includes the determinant of the covariance, since a hypothesis from an
    uncertain mode has a small misfit in every frame.
    """

    calibration: Calibration
    chosen: Indices
    misfit: Float64
    cost: Float64

    @property
    def agree(self) -> Bool:
        """Whether each frame has a mode that agrees with the calibration, (N,)."""
        return np.asarray(self.misfit < INLIER_MISFIT)

    @property
    def mean_misfit(self) -> float:
        """Mean of the frames' misfits, each at most `INLIER_MISFIT`."""
        return float(np.minimum(self.misfit, INLIER_MISFIT).mean())


def evenly_spaced(count: int, most: int) -> Indices:
    """Return at most ``most`` evenly spaced indices below ``count``, in increasing order."""
    return np.unique(np.linspace(0, count - 1, min(count, most)).round().astype(np.intp))


def find_consensus(
    arm: ArmModes,
    *,
    hypothesis_frames: int = _MAX_HYPOTHESIS_FRAMES,
    test_frames: int = _MAX_TEST_FRAMES,
    roll: float = 0.0,
) -> Consensus:
    """Find the calibration on which most frames agree.

    Parameters
    ----------
    arm
        The frames.
    hypothesis_frames, test_frames
        Largest numbers of frames whose modes are used as hypotheses, and on which each hypothesis is scored.
    roll
        Offset of roll of all hypotheses, rad.
    """
    tested, hypotheses = evenly_spaced(len(arm.counts), test_frames), _Hypotheses(arm, roll)
    proposing = evenly_spaced(len(arm.counts), hypothesis_frames).tolist()
    costs = np.array([hypotheses.tested(frame, tested)[-1].sum(axis=1) for frame in proposing])
    best, number = np.unravel_index(costs.argmin(), costs.shape)
    bases, offsets, *judged = hypotheses.tested(proposing[best], np.arange(len(arm.counts)))
    return Consensus(arm.model.calibration(bases[number], offsets[number]), *(one[number] for one in judged))


def agreement(arm: ArmModes, calibration: Calibration) -> Consensus:
    """Return what the frames of an arm say of a calibration, whose errors are not counted."""
    covariance = arm.model.covariance(calibration) + arm.covariances
    return Consensus(calibration, *_judged(arm.modes, arm.model.predict(calibration), covariance))


def find_consensus_at_any_roll(arm: ArmModes) -> Consensus:
    """Find the calibration on which most frames agree, at the usual offset of roll or at any.

    A tool that was not homed, or readings of another roll joint, turn all frames about their shafts. Where fewer than
    half of the frames agree, they need to agree on the remote centre and on the shafts' directions only: offsets of
    roll are tried all round, each frame's roll with a wide standard deviation.
    """
    usual, model = find_consensus(arm), arm.model
    if usual.agree.mean() >= _ENOUGH:
        return usual
    wide = model.offset_std.copy()
    wide[1] = _ROLL_STEP
    loose = replace(arm, model=replace(model, offset_std=wide))
    few = {"hypothesis_frames": _MAX_ROLLED_FRAMES, "test_frames": _MAX_ROLLED_FRAMES}
    tried = [find_consensus(loose, roll=roll, **few) for roll in _ROLLS]
    best = min(tried, key=lambda one: float(one.cost.sum()))
    if best.agree.sum() <= usual.agree.sum():
        return usual
    return replace(best, calibration=model.calibration(best.calibration.camera_from_base, best.calibration.offsets))


def _judged(modes: Posed, expected: Posed, covariance: Float64) -> tuple[Indices, Float64, Float64]:
    """Judge predictions (..., V) of frames by their modes (V, M): the most likely one's number, misfit and cost.

    ``covariance`` (..., V, D, D) is that of the modes about the predictions.
    """
    changes = modes.minus(Posed(expected.pose[..., None, :, :], expected.joints[..., None, :]))
    factor, dimension = np.linalg.cholesky(covariance), changes.shape[-1]
    misfits = np.square(np.linalg.solve(factor, np.swapaxes(changes, -1, -2))).mean(axis=-2)
    spread = 2 * np.log(np.diagonal(factor, axis1=-2, axis2=-1)).mean(axis=-1)
    outlier_std, misfit = np.append(_OUTLIER_STD, np.full(dimension - 6, _OUTLIER_ANGLE)), misfits.min(axis=-1)
    return misfits.argmin(axis=-1), misfit, np.minimum(misfit + spread, 2 * np.log(outlier_std).mean() + 1)


class _Hypotheses:
    """Calibrations that are made from single modes, and what other frames say of them."""

    def __init__(self, arm: ArmModes, roll: float) -> None:
        self._arm, self._model = arm, (model := arm.model)
        # All hypotheses have the same offsets of insertion and roll, so the kinematics and their errors are the same.
        self._offsets = np.zeros(len(model.offset_std))
        self._offsets[1] = roll
        same = replace(model, endoscope=None).calibration(np.eye(4), self._offsets)
        self._read = model.predict(same)  # as seen from the base
        self._relative = model.camera_from_base(model.calibration(np.eye(4), self._offsets))
        if (endoscope := model.endoscope) is not None:
            _, by_values, by_own = endoscope.relative(endoscope.start)
            self._by_endoscope = by_values * endoscope.loose, by_own
        self._root_from_base = inverse(self._read.pose)
        self._of_readings = model.covariance(same)
        self._of_readings[:, 5, 5] += model.offset_std[1] ** 2

    def tested(self, frame: int, test_frames: Indices) -> tuple[Float64, Float64, Indices, Float64, Float64]:
        """Test the calibrations that predict each of the M modes of a frame on test frames (V,).

        Returns their bases (M, 4, 4) and offsets (M, 2 + J), and what `_judged` returns, (M, V) each. The offsets of
        insertion and roll are the same for all; joints without a reading have an offset of zero, too.
        """
        at, read = self._arm.modes[frame], self._read[test_frames]
        offsets = np.tile(self._offsets, (len(at.pose), 1))
        offsets[:, 2:] = np.nan_to_num(at.joints - self._model.joints[frame])
        bases = inverse(self._relative[frame]) @ at.pose @ self._root_from_base[frame]
        pose = self._relative[test_frames] @ bases[:, None] @ read.pose
        expected = Posed(pose, read.joints + offsets[:, None, 2:])
        # covariance of the calibrations: of the mode that they were made from, and of that frame's readings
        own = self._arm.covariances[frame] + self._of_readings[frame]
        transport = np.tile(np.eye(len(own)), (len(test_frames), 1, 1))
        transport[:, :6, :6] = adjoint(self._root_from_base[test_frames] @ self._read.pose[frame])
        covariance = transport @ own @ np.swapaxes(transport, 1, 2)
        covariance += self._of_readings[test_frames] + self._arm.covariances[test_frames]
        if self._model.endoscope is not None:
            by_values, by_own = self._by_endoscope
            both = np.broadcast_arrays(by_own[test_frames], by_own[frame])
            moves = np.concatenate([by_values[test_frames] - by_values[frame], *both], axis=2)
            moves = adjoint(self._root_from_base[test_frames] @ inverse(bases)[:, None]) @ moves
            covariance = np.tile(covariance, (len(bases), 1, 1, 1))
            covariance[..., :6, :6] += moves @ np.swapaxes(moves, -1, -2)
        return bases, offsets, *_judged(self._arm.modes[test_frames], expected, covariance)


_STILL_RAD, _STILL_M = np.deg2rad(0.05), 2e-4  # standard deviation below which readings are constant
IMPROVEMENT = 0.5  # largest ratio of mean misfits at which another explanation replaces the first
_GOOD_MISFIT = 0.5  # mean misfit at which no other explanation is needed


def check_motion(model: SessionModel) -> None:
    """Refuse the readings of an arm that does not move, from which its base cannot be estimated.

    Raises
    ------
    InputError
        The readings of all outer joints are constant.
    """
    std = model.outer.std(axis=0)
    if (std[[0, 1, 3]] < _STILL_RAD).all() and std[2] < _STILL_M:
        raise InputError(
            "session: yaw, pitch, insertion, roll: expected readings of an arm that moves, got the same in all frames"
        )


def check_arm(arm: ArmModes, consensus: Consensus) -> None:
    """Refuse readings that only fit with the length of another arm or tool.

    Parameters
    ----------
    arm
        The frames.
    consensus
        The consensus of all frames.

    Raises
    ------
    InputError
        The consensus is clearly better with another length; the message states the difference, mm.
    """
    differences = ROLL_OFFSET_LONG - ROLL_OFFSET, INSERTION_OFFSET["si"] - INSERTION_OFFSET["classic"]
    misfit = consensus.mean_misfit
    if misfit < _GOOD_MISFIT:
        return
    for difference in differences:
        outer = arm.model.outer.copy()
        outer[:, 2] += difference
        other = find_consensus(replace(arm, model=replace(arm.model, outer=outer)))
        if other.mean_misfit < IMPROVEMENT * misfit and other.cost.sum() < consensus.cost.sum():
            than = "longer" if difference > 0 else "shorter"
            raise InputError(
                f"session: the readings fit an arm or tool {abs(difference) * 1e3:.0f} mm {than}"
                ": expected --arm, or the tool's own roll joint (--tool), to be the recorded one's"
            )
