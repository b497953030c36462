"""Search for what a session's frames agree on where its endoscope moves: the camera in its tip, or pieces."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.calibration.blocks import ENDOSCOPE, Calibration
from dvrk_cmaes.calibration.consensus import INLIER_MISFIT, Consensus, Mode, agreement, evenly_spaced, find_consensus
from dvrk_cmaes.calibration.endoscope import Pieces, Steered
from dvrk_cmaes.calibration.model import SessionModel
from dvrk_cmaes.calibration.session_frame import SessionFrame
from dvrk_cmaes.calibration.solve import Solved, solve_with_modes
from dvrk_cmaes.geometry import inverse

Float64 = NDArray[np.float64]
Indices = NDArray[np.intp]

_HYPOTHESIS_FRAMES, _TEST_FRAMES = 10, 60  # of each consensus of the search
_TRIED: Final = 4  # cameras in the tip by which the frames agree best, that are refined
_FOUND: Final = 0.3  # of the deviations beforehand: those of a refined camera in the tip
LEAST_PIECE: Final = 3
"""Frames that agree on the base of a piece."""
_LEAST_WINDOW, _MOST_WINDOWS = 4, 30  # frames of a run that is solved by itself, and number of these
_AGREE: Final = 0.75  # share of a run's frames that agree on one base
_CHANGE: Final = 12.0  # penalty for a change of the base, where a frame that is off costs at most 4
_MOST_SEARCHES: Final = 6


def find_hand_eye(model: SessionModel, modes: Sequence[Sequence[Mode]], steered: Steered) -> Steered:
    """Find the camera in the endoscope's tip by which the frames' modes agree best, at any turn about the axis.

    Parameters
    ----------
    model, modes
        As in `find_consensus`.
    steered
        The endoscope in all frames, whose camera is not known yet.
    """
    few = evenly_spaced(len(modes), _TEST_FRAMES)
    modes = [modes[i] for i in few]
    model = replace(model, endoscope=steered).subset(few)
    tried: list[tuple[float, Steered, Consensus]] = []
    for offered in steered.hand_eyes():
        of_few = replace(model, endoscope=offered.subset(few))
        consensus = find_consensus(of_few, modes, hypothesis_frames=_HYPOTHESIS_FRAMES)
        tried.append((consensus.mean_misfit, offered, consensus))
    refined: list[tuple[float, Steered]] = []
    for _, offered, consensus in sorted(tried, key=lambda one: one[0])[:_TRIED]:
        of_few = replace(model, endoscope=offered.subset(few))
        solution = solve_with_modes(of_few, modes, consensus.calibration)
        values = solution.calibration.endoscope
        assert values is not None
        there = replace(offered, start=values, loose=_FOUND * offered.loose)
        of_few = replace(model, endoscope=there.subset(few))
        again = find_consensus(of_few, modes, hypothesis_frames=_HYPOTHESIS_FRAMES)
        refined.append((float(again.cost.mean()), there))
    return min(refined, key=lambda one: one[0])[1]


def find_pieces(
    model: SessionModel,
    modes: Sequence[Sequence[Mode]],
    consensus: Consensus,
    *,
    alike: float = 1.0,
) -> Pieces | None:
    """Find the pieces of a session whose base or camera moved without readings that show, None if it stood still.

    A change-point search: the pieces are those of least cost, the sum of the frames' robust costs at the base of their
    piece and of a penalty for each change. Bases to choose from are at first those of short runs of consecutive frames,
    solved by themselves; then those of the pieces found, solved with shared offsets, until the pieces stay.

    Parameters
    ----------
    model, modes
        As in `find_consensus`, of N frames in the order they were taken.
    consensus
        The consensus of all frames.
    alike
        Number of frames that count as one, because their masks err alike: what they cost counts as much less.

    Returns
    -------
    Pieces or None
        The pieces of all frames, of which that with most frames is the reference.
    """
    if not _disagree_together(consensus.agree):
        return None
    bases = _bases_of_runs(model, modes, float(consensus.calibration.offsets[1]))
    pieces = np.zeros(0, np.intp)
    for _ in range(_MOST_SEARCHES if bases else 0):
        costs = np.array([agreement(model, modes, base).cost for base in bases]) / alike
        before, (pieces, cameras, solution) = pieces, _solved(model, modes, bases, _fewest_changes(costs))
        if np.array_equal(before, pieces):
            break
        found = solution.calibration.alone(without=ENDOSCOPE)
        bases = [found, *(found.with_blocks(base=move @ found.camera_from_base) for move in cameras)]
    return Pieces.of(pieces, cameras) if pieces.any() else None


def _solved(
    model: SessionModel, modes: Sequence[Sequence[Mode]], bases: Sequence[Calibration], place: Indices
) -> tuple[Indices, Float64, Solved]:
    """Solve N frames, each of which is at one of some bases (N,), with all else shared.

    Returns the numbers of their pieces (N,), that with most frames first, the reference camera in the others (P, 4, 4),
    and the solution.
    """
    held, number, counts = np.unique(place, return_inverse=True, return_counts=True)
    order = np.argsort(-counts, kind="stable")
    pieces, start = np.argsort(order)[number], bases[held[order[0]]]
    moves = [bases[k].camera_from_base @ inverse(start.camera_from_base) for k in held[order[1:]]]
    cut = Pieces.of(pieces, np.array(moves).reshape(-1, 4, 4))
    if not moves:
        return pieces, cut.start.poses, solve_with_modes(model, modes, start)
    start = start.with_blocks(cut.block, endoscope=cut.start)
    solution = solve_with_modes(replace(model, endoscope=cut), modes, start)
    values = solution.calibration.endoscope
    assert values is not None
    return pieces, values.poses, solution


def _agreeing(solution: Solved) -> NDArray[np.bool_]:
    """Return which frames (N,) agree with the base of their piece."""
    return np.asarray(solution.misfit < INLIER_MISFIT * (4 + len(solution.calibration.offsets)))


def _bases_of_runs(model: SessionModel, modes: Sequence[Sequence[Mode]], roll: float) -> list[Calibration]:
    """Return the bases of short runs of consecutive frames that agree on one; arguments as in `find_pieces`."""
    count, found = len(modes), list[Calibration]()
    length = max(_LEAST_WINDOW, -(-count // _MOST_WINDOWS))
    for first in range(0, max(count - length, 0) + 1, max(length // 2, 1)):
        index = list(range(first, min(first + length, count)))
        own, own_modes = model.subset(index), [modes[i] for i in index]
        start = find_consensus(own, own_modes, roll=roll).calibration
        solution = solve_with_modes(own, own_modes, start)
        agree = _agreeing(solution)
        if agree.sum() >= max(LEAST_PIECE, _AGREE * len(agree)):
            found.append(solution.calibration)
    return found


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
    """Return which of B bases holds for each of N consecutive frames, by their costs (B, N) and those of changes.

    Found by dynamic programming.
    """
    bases, frames = costs.shape
    total, came = costs[:, 0].copy(), np.zeros((frames, bases), np.intp)
    for frame in range(1, frames):
        best = int(total.argmin())
        stays = total <= total[best] + _CHANGE
        came[frame] = np.where(stays, np.arange(bases), best)
        total = np.minimum(total, total[best] + _CHANGE) + costs[:, frame]
    out = np.empty(frames, np.intp)
    out[-1] = total.argmin()
    for frame in range(frames - 1, 0, -1):
        out[frame - 1] = came[frame, out[frame]]
    return out
