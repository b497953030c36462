"""Search for what a session's frames agree on where its endoscope moves: the camera in its tip, or pieces."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Final

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.calibration.consensus import INLIER_MISFIT, Consensus, Mode, agreement, evenly_spaced, find_consensus
from dvrk_cmaes.calibration.endoscope import Endoscope, Pieces, Place, Steered
from dvrk_cmaes.calibration.frame_task import SessionFrame
from dvrk_cmaes.calibration.lasting_errors import frames_alike
from dvrk_cmaes.calibration.model import Calibration, SessionModel, ecm_readings
from dvrk_cmaes.calibration.session_state import SessionState
from dvrk_cmaes.calibration.solve import Solved, robust_costs, solve_with_modes
from dvrk_cmaes.geometry import inverse

Float64 = NDArray[np.float64]
Indices = NDArray[np.intp]

_HYPOTHESIS_FRAMES, _TEST_FRAMES = 10, 60  # of each consensus of the search
_TRIED: Final = 4  # cameras in the tip by which the frames agree best, that are refined
_FOUND: Final = 0.3  # of the deviations beforehand: those of a refined camera in the tip
LEAST_PIECE: Final = 3
"""Frames that agree on the base of a piece."""
_LEAST_WINDOW, _MOST_WINDOWS = 4, 30  # frames of a run that is solved by itself, and number of these
_JOIN: Final = 40.0  # increase of the robust cost up to which one base explains two runs
_NEEDED: Final = 70.0  # the same of two pieces, with shared offsets: some frames while the endoscope moves are none
_AGREE: Final = 0.75  # share of a run's frames that agree on one base
_UNTOLD: Final = 0.5  # of such a cost, within which frames do not tell between which of them the base changes
_CUT: Final = 4.0  # cost of a change of the base from one frame to the next


def with_readings(state: SessionState, places: Sequence[Place] = ()) -> SessionState:
    """Return the session with its endoscope where the arm that holds it is read and moves, else as it is.

    ``places`` are those at which it stands, where they are known.
    """
    read = ecm_readings([frame.result.readings for frame in state.frames])
    steered = Steered.of(read, places)
    if steered is None:
        return state
    state.problem.progress("finding the camera in the endoscope", len(state.frames))
    found = find_hand_eye(state.model, state.modes, state.problem.offset_std, state.problem.prior, steered)
    problem = replace(state.problem, endoscope_prior=found.start.information)
    return replace(state, model=replace(state.model, endoscope=found), problem=problem)


def with_pieces(state: SessionState, consensus: Consensus | None = None) -> SessionState | None:
    """Return the session in the pieces in which its base stands still; None if it is not to be cut.

    ``consensus`` is that of all frames, if it is known.
    """
    problem = state.problem
    if not problem.may_cut:
        return None
    if consensus is None:
        consensus = find_consensus(state.model, state.modes, problem.offset_std)
    alike = float(np.median(frames_alike(state.times, problem.config.session.alike_seconds)))
    found = find_pieces(state.model, state.modes, problem.offset_std, problem.prior, consensus, alike=alike)
    if found is None:
        return None
    pieces, _ = found
    return replace(
        state,
        model=replace(state.model, endoscope=pieces),
        problem=replace(problem, endoscope_prior=pieces.start.information),
    )


def without_pieces(state: SessionState) -> SessionState:
    """Return a session that was cut into pieces in one again."""
    problem = replace(state.problem, endoscope_prior=np.zeros((0, 0)))
    return replace(state, model=replace(state.model, endoscope=None), problem=problem)


def find_hand_eye(
    model: SessionModel,
    modes: Sequence[Sequence[Mode]],
    offset_std: Float64,
    prior: Float64,
    steered: Steered,
) -> Steered:
    """Find the camera in the endoscope's tip by which the frames' modes agree best, at any turn about the axis.

    Parameters
    ----------
    model, modes, offset_std
        As in `find_consensus`.
    prior
        As in `solve`, without the endoscope.
    steered
        The endoscope in all frames, whose camera is not known yet.
    """
    few = evenly_spaced(len(modes), _TEST_FRAMES)
    modes = [modes[i] for i in few]
    model = replace(model, endoscope=steered).subset(few)
    tried: list[tuple[float, Steered, Consensus]] = []
    for offered in steered.hand_eyes():
        of_few = replace(model, endoscope=offered.subset(few))
        consensus = find_consensus(of_few, modes, offset_std, hypothesis_frames=_HYPOTHESIS_FRAMES)
        tried.append((consensus.mean_misfit, offered, consensus))
    prior = with_prior_of(steered, prior)
    refined: list[tuple[float, Steered]] = []
    for _, offered, consensus in sorted(tried, key=lambda one: one[0])[:_TRIED]:
        of_few = replace(model, endoscope=offered.subset(few))
        solution = solve_with_modes(of_few, modes, consensus.calibration, prior)
        values = solution.calibration.endoscope
        assert values is not None
        there = offered.with_start(values, _FOUND * offered.loose)
        again = find_consensus(
            replace(model, endoscope=there.subset(few)), modes, offset_std, hypothesis_frames=_HYPOTHESIS_FRAMES
        )
        refined.append((float(again.cost.mean()), there))
    return min(refined, key=lambda one: one[0])[1]


def with_prior_of(endoscope: Endoscope, prior: Float64) -> Float64:
    """Return a prior's information (K, K) with that of the M unknowns of an endoscope, (K + M, K + M)."""
    count = len(prior)
    out = np.pad(prior, (0, len(endoscope.start.information)))
    out[count:, count:] = endoscope.start.information
    return out


def find_pieces(
    model: SessionModel,
    modes: Sequence[Sequence[Mode]],
    offset_std: Float64,
    prior: Float64,
    consensus: Consensus,
    *,
    alike: float = 1.0,
) -> tuple[Pieces, Indices] | None:
    """Find the pieces of a session whose base or camera moved without readings that tell, None if it stood still.

    Short runs of consecutive frames are solved by themselves. Those whose frames agree are joined with their neighbours
    where one base explains both as well, and each base so found then holds for consecutive frames. Runs differ in their
    offsets as well, as where cables wander. So all pieces are then solved with shared offsets, two are joined where one
    base explains all frames nearly as well, and the frames between which the base moved are found again.

    Parameters
    ----------
    model, modes, offset_std
        As in `find_consensus`, of N frames in the order they were taken.
    prior
        As in `solve`.
    consensus
        The consensus of all frames.
    alike
        Number of frames that count as one, because their masks err alike: what they cost counts as much less.

    Returns
    -------
    (Pieces, (N,)) or None
        The pieces of all frames, of which that with most frames is the reference, and which frames (K,) agree with
        their piece.
    """
    if not _disagree_together(consensus.agree):
        return None

    roll = float(consensus.calibration.offsets[1])

    def solved(index: Indices, *starts: Calibration) -> _Run:
        own, own_modes = model.subset(index), [modes[i] for i in index]
        starts = starts or (find_consensus(own, own_modes, offset_std, roll=roll).calibration,)
        found = [solve_with_modes(own, own_modes, start, prior) for start in starts]
        return min((_Run(index, one) for one in found), key=lambda run: run.cost)

    count = len(modes)
    length = max(_LEAST_WINDOW, -(-count // _MOST_WINDOWS))
    starts = range(0, max(count - length, 0) + 1, max(length // 2, 1))
    runs = [run for start in starts if (run := solved(np.arange(start, min(start + length, count)))).agrees]
    joined = [_joined(*pair, solved) for pair in pairwise(runs)]
    while joined:
        gains = [
            one.cost - before.cost - after.cost for one, (before, after) in zip(joined, pairwise(runs), strict=True)
        ]
        best = int(np.argmin(gains))
        if gains[best] > _JOIN * alike:
            break
        runs[best : best + 2] = [joined[best]]
        first = max(best - 1, 0)
        joined[first : best + 2] = [_joined(*pair, solved) for pair in pairwise(runs[first : best + 2])]
    found = [agreement(model, modes, offset_std, run.solution.calibration) for run in runs]
    if not found:
        return None
    place = _fewest_changes(np.array([one.cost for one in found]) / alike)
    cut = _Cut.of(model, modes, prior, [run.solution.calibration for run in runs], place)

    def placed(cut: _Cut) -> _Cut:
        bases = cut.bases
        costs = np.array([agreement(model, modes, offset_std, base).cost for base in bases]) / alike
        return _Cut.of(model, modes, prior, bases, _in_the_middle(_fewest_changes(costs), costs))

    while cut.pieces is not None:
        piece, bases = cut.pieces.piece, cut.bases
        pairs = {(int(one), int(other)) for one, other in pairwise(piece) if one != other}
        places = [np.where(np.isin(piece, pair), held, piece) for pair in sorted(pairs) for held in pair]
        less = min((_Cut.of(model, modes, prior, bases, place) for place in places), key=lambda one: one.cost)
        if less.cost - cut.cost > _NEEDED * alike:
            break
        cut = placed(less)
    cut = placed(cut)
    return None if cut.pieces is None else (cut.pieces, np.flatnonzero(cut.agree))


@dataclass(frozen=True, eq=False)
class _Cut:
    """All frames solved with a base for each piece, and all else shared; ``pieces`` is None where there is one."""

    pieces: Pieces | None
    solution: Solved

    @classmethod
    def of(
        cls,
        model: SessionModel,
        modes: Sequence[Sequence[Mode]],
        prior: Float64,
        bases: Sequence[Calibration],
        place: Indices,
    ) -> _Cut:
        """Solve frames, each of which is at one of some bases (N,); the piece with most frames is the reference."""
        held, number, counts = np.unique(place, return_inverse=True, return_counts=True)
        order = np.argsort(-counts, kind="stable")
        start, pieces = bases[held[order[0]]], None
        if len(held) > 1:
            cameras = [bases[k].camera_from_base @ inverse(start.camera_from_base) for k in held[order[1:]]]
            pieces = Pieces.of(np.argsort(order)[number], np.array(cameras))
            start, prior = replace(start, endoscope=pieces.start), with_prior_of(pieces, prior)
        solution = solve_with_modes(replace(model, endoscope=pieces), modes, start, prior)
        return cls(pieces, solution)

    @property
    def bases(self) -> list[Calibration]:
        """The base of each piece, with the shared offsets."""
        found = replace(self.solution.calibration, endoscope=None)
        values = self.solution.calibration.endoscope
        moves = [] if values is None else list(values.poses)
        return [found, *(replace(found, camera_from_base=move @ found.camera_from_base) for move in moves)]

    @property
    def cost(self) -> float:
        """Robust cost of the frames."""
        return float(robust_costs(self.solution.misfit, self._dimension).sum())

    @property
    def agree(self) -> NDArray[np.bool_]:
        """Which frames (N,) agree with the base of their piece."""
        return np.asarray(self.solution.misfit < INLIER_MISFIT * self._dimension)

    @property
    def _dimension(self) -> int:
        return 4 + len(self.solution.calibration.offsets)


@dataclass(frozen=True, eq=False)
class _Run:
    """Consecutive frames and what they tell by themselves."""

    index: Indices
    solution: Solved

    @property
    def cost(self) -> float:
        """Robust cost of the frames."""
        return float(robust_costs(self.solution.misfit, self.dimension).sum())

    @property
    def dimension(self) -> int:
        return 4 + len(self.solution.calibration.offsets)

    @property
    def agrees(self) -> bool:
        """Whether most frames agree on one base."""
        agree = self.solution.misfit < INLIER_MISFIT * self.dimension
        return bool(agree.sum() >= max(LEAST_PIECE, _AGREE * len(agree)))


def _joined(before: _Run, after: _Run, solved: Callable[..., _Run]) -> _Run:
    """Solve two runs together, from what either tells by itself."""
    return solved(np.concatenate([before.index, after.index]), before.solution.calibration, after.solution.calibration)


def _disagree_together(agree: NDArray[np.bool_]) -> bool:
    """Whether some consecutive frames, at least three, disagree with the consensus."""
    runs = np.convolve(~agree, np.ones(LEAST_PIECE), "valid") if len(agree) >= LEAST_PIECE else np.zeros(0)
    return bool((runs == LEAST_PIECE).any())


def describe_pieces(pieces: Pieces, frames: Sequence[SessionFrame]) -> str:
    """Say between which frames the base or the camera moved."""
    cuts = np.flatnonzero(np.diff(pieces.piece)).tolist()
    between = ", ".join(f"{frames[i].name} and {frames[i + 1].name}" for i in cuts)
    return (
        f"the arm's base or the camera moved between frames {between}: {len(pieces.start.poses) + 1} bases, and all "
        "else is shared"
    )


def _fewest_changes(costs: Float64) -> Indices:
    """Return which of B bases holds for each of N consecutive frames, by their costs (B, N), with few changes."""
    bases, frames = costs.shape
    total, came = costs[:, 0].copy(), np.zeros((frames, bases), np.intp)
    for frame in range(1, frames):
        best = int(total.argmin())
        stays = total <= total[best] + _CUT
        came[frame] = np.where(stays, np.arange(bases), best)
        total = np.minimum(total, total[best] + _CUT) + costs[:, frame]
    out = np.empty(frames, np.intp)
    out[-1] = total.argmin()
    for frame in range(frames - 1, 0, -1):
        out[frame - 1] = came[frame, out[frame]]
    return out


def _in_the_middle(held: Indices, costs: Float64) -> Indices:
    """Return which of B bases holds for each of N frames, with each change amid the frames that do not tell its place.

    ``held`` (N,) is that with fewest costs (B, N). Frames while the camera moves fit neither base.
    """
    out, ends = held.copy(), [-1, *np.flatnonzero(np.diff(held)).tolist(), len(held) - 1]
    for before, last, after in zip(ends, ends[1:], ends[2:], strict=False):
        one, other = held[last], held[last + 1]
        more = np.cumsum(costs[one, before + 1 : after] - costs[other, before + 1 : after])  # if it changes after each
        at = last - before - 1
        untold = more > more[at] + _UNTOLD
        first = at - int(np.argmax(untold[: at + 1][::-1])) + 1 if untold[: at + 1].any() else 0
        beyond = at + int(np.argmax(untold[at:])) - 1 if untold[at:].any() else len(more) - 1
        middle = before + 1 + (first + beyond) // 2
        out[min(last, middle) + 1 : last + 1], out[last + 1 : max(last, middle) + 1] = other, one
    return out
