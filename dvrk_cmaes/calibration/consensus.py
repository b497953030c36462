"""Which mode of which frame the session is to believe: the base that most frames can agree on.

Every frame brings its modes, each with a base of its own: a wrong one lies far off, each time elsewhere.
Each mode in turn is taken for right and predicts all frames; what counts is how many of these have a mode within what
the covariances allow. A third of the frames may be wrong in whatever way.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.calibration.model import Calibration, SessionModel
from dvrk_cmaes.geometry import change_between, inverse, shift_of_change

Float64 = NDArray[np.float64]

_MOST_PROPOSERS = 60  # frames whose modes propose a base
_MOST_VOTERS = 240  # frames that each proposal is tried on
CAP = 4.0
"""Squared misfit per degree of freedom beyond which a mode is another one."""

_ANY_ANGLE = np.deg2rad(30.0)
_ANYWHERE = np.array([0.02, 0.02, 0.02, _ANY_ANGLE, _ANY_ANGLE, 2 * _ANY_ANGLE])  # where wrong modes lie: m, rad


@dataclass(frozen=True, eq=False)
class Mode:
    """A pose (4, 4), joints (J,) and their covariance (D, D) in the root's axes; D = 6 + J."""

    camera_from_root: Float64
    joints: Float64
    covariance: Float64


@dataclass(frozen=True, eq=False)
class Consensus:
    """A base that frames agree on: its calibration, each frame's chosen mode (N,), and its squared misfit (N,) over D.

    ``agree`` (N,) says which frames have a mode that fits.
    """

    calibration: Calibration
    chosen: NDArray[np.intp]
    misfit: Float64

    @property
    def agree(self) -> NDArray[np.bool_]:
        """Frames with a mode that fits."""
        return np.asarray(self.misfit < CAP)


def _evenly(count: int, most: int) -> NDArray[np.intp]:
    return np.unique(np.linspace(0, count - 1, min(count, most)).round().astype(np.intp))


def find_consensus(model: SessionModel, modes: Sequence[Sequence[Mode]], offset_spread: Float64) -> Consensus:
    """Find the base that most frames agree on.

    ``modes`` are each frame's, the likeliest first; ``offset_spread`` (2 + J,) is how far offsets may be from zero.
    """
    flat = [(frame, k) for frame, own in enumerate(modes) for k in range(len(own))]
    voters = _evenly(len(modes), _MOST_VOTERS)
    proposers = set(_evenly(len(modes), _MOST_PROPOSERS).tolist())
    ballot = _Ballot(model, modes, offset_spread)
    best: Calibration | None = None
    least = np.inf
    for frame, k in flat:
        if frame not in proposers:
            continue
        proposal = ballot.proposal(frame, k)
        cost = float(ballot.vote(proposal, frame, k, voters).cost.sum())
        if cost < least:
            best, least, source = proposal, cost, (frame, k)
    assert best is not None
    votes = ballot.vote(best, *source, np.arange(len(modes)))
    return Consensus(best, votes.chosen, votes.misfit)


def choose_modes(
    model: SessionModel, modes: Sequence[Sequence[Mode]], calibration: Calibration
) -> tuple[list[Mode], Float64]:
    """Return each frame's mode nearest to what a calibration expects, and its squared misfit over D, (N,)."""
    poses, joints = model.predict(calibration)
    spread = model.covariance(calibration)
    chosen, misfit = [], []
    for own, pose, joint, expected in zip(modes, poses, joints, spread, strict=True):
        apart = [np.concatenate([change_between(pose, mode.camera_from_root), mode.joints - joint]) for mode in own]
        squares = [a @ np.linalg.solve(expected + mode.covariance, a) for a, mode in zip(apart, own, strict=True)]
        best = int(np.argmin(squares))
        chosen.append(own[best])
        misfit.append(squares[best] / len(apart[best]))
    return chosen, np.array(misfit)


@dataclass(frozen=True, eq=False)
class _Votes:
    """What V voters say of a proposal, by their best modes: ``cost`` (V,) is half a log-likelihood a degree of freedom.

    A proposer who hardly knows its own pose agrees with everybody, which its likelihood does not reward.
    """

    cost: Float64
    misfit: Float64
    chosen: NDArray[np.intp]


class _Ballot:
    """Tries a calibration that one frame proposes on the others."""

    def __init__(self, model: SessionModel, modes: Sequence[Sequence[Mode]], offset_spread: Float64) -> None:
        self._model = model
        self._modes = modes
        self._offsets = offset_spread
        most = max(len(own) for own in modes)
        padded = [list(own) + [own[-1]] * (most - len(own)) for own in modes]
        self._poses = np.array([[m.camera_from_root for m in own] for own in padded])
        self._joints = np.array([[m.joints for m in own] for own in padded])
        self._covariance = np.array([[m.covariance for m in own] for own in padded])

    def proposal(self, frame: int, k: int) -> Calibration:
        """Calibration under which one mode is just as its readings say, up to the instrument's joints' offsets."""
        mode, own = self._modes[frame][k], self._model.subset([frame])
        none = np.zeros(2 + len(mode.joints))
        none[2:] = np.nan_to_num(mode.joints - own.joints[0])
        return Calibration(mode.camera_from_root @ inverse(own.base_from_root(none)[0]), none)

    def vote(self, proposal: Calibration, frame: int, k: int, voters: NDArray[np.intp]) -> _Votes:
        """Ask the voters (V,) how well a proposal explains the best of their modes."""
        model = self._model.subset(voters)
        poses, joints = model.predict(proposal)
        dimension = 6 + joints.shape[1]
        # How wrong the proposer's own pose and readings may be, seen from each voter.
        proposer = self._model.subset([frame])
        own = self._covariance[frame, k] + proposer.covariance(proposal)[0]
        own[5, 5] += self._offsets[1] ** 2
        shift = np.tile(np.eye(dimension), (len(voters), 1, 1))
        there = inverse(model.base_from_root(proposal.offsets)) @ proposer.base_from_root(proposal.offsets)
        shift[:, :6, :6] = shift_of_change(there)
        spread = shift @ own @ np.swapaxes(shift, 1, 2) + model.covariance(proposal)
        spread[:, 5, 5] += self._offsets[1] ** 2
        apart = np.concatenate(
            [
                change_between(poses[:, None], self._poses[voters]),
                self._joints[voters] - joints[:, None],
            ],
            axis=-1,
        )
        total = spread[:, None] + self._covariance[voters]
        squared = np.einsum("vmi,vmi->vm", apart, np.linalg.solve(total, apart[..., None])[..., 0]) / dimension
        width = np.linalg.slogdet(total)[1] / dimension
        elsewhere = 2 * np.log(np.concatenate([_ANYWHERE, np.full(dimension - 6, _ANY_ANGLE)])).sum() / dimension + 1
        cost = np.minimum(squared + width, elsewhere)
        best = (squared + width).argmin(axis=1)
        mine = np.arange(len(voters)), best
        return _Votes(cost[mine], squared[mine], best)
