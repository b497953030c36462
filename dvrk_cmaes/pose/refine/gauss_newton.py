"""Local refinement with subpixel accuracy: damped Gauss-Newton on the sum of an outline's term and others.

Several poses are refined together, because drawing eight costs little more than drawing one. An iteration minimises the
approximation of the terms by several short steps, then draws one silhouette with its outline. (For the coverage, that
is iteratively reweighted least squares, whose short steps would otherwise each cost a silhouette.)
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Final, Generic, Literal, TypeVar

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.config import OutlineConfig
from dvrk_cmaes.geometry import Posed
from dvrk_cmaes.pose.refine.selection import ALL, Selection
from dvrk_cmaes.pose.search.modes import Candidate
from dvrk_cmaes.pose.terms.outline_term import OutlineTerm
from dvrk_cmaes.pose.terms.term import Approximation, Quadratic, Term, sum_of_costs, sum_of_locals

Float64 = NDArray[np.float64]
A = TypeVar("A", bound=Approximation)

_DAMPING = (1e-4, 1e-2, 10.0)  # least, first and largest of the Levenberg-Marquardt steps
_DAMPING_STEP = 8.0  # factor on the damping by which it grows or falls
_SMALL_GAIN = 0.1  # of the tolerance
_AT_HALF_SIZE, _AT_SMALLER_SIZE = 4.0, 10.0  # factors on the tolerance where a refinement at a larger size follows
_SOLVED = 0.01  # length of a step, in standard deviations per parameter, below which an approximation's minimum is met
_LEAST_DAMPING: Final = 1e-9, 1e-12  # of steps that are not damped: of each diagonal element, and of the largest one


@dataclass(frozen=True, eq=False)
class Fit(Candidate):
    """A refined pose.

    ``information`` (D, D) is that of the small changes from all terms. ``score`` is a negative log-likelihood up to a
    constant that is the same for all modes of a frame, ``outline_score`` the part of it that comes from the outline.
    ``drawn`` is what the outline's term drew last, of the pose ``drawn_at``, from which at most one step that was not
    tested leads to the refined pose.
    """

    outline_score: float
    information: Float64
    drawn: Any
    drawn_at: Posed


@dataclass(frozen=True)
class Steps:
    """How a refinement goes on.

    iterations : largest number of drawings of each pose. inner : steps on each approximation. tolerance : length of a
    step, in standard deviations per parameter, below which a refinement stops. tested : which steps are drawn, and
    undone if they raise the sum of squares: all; those longer than the tolerance; or none, which are then not damped
    either, but at most ``largest`` standard deviations long. continued : whether another refinement goes on from where
    this one ends, which then finds what was drawn there.
    """

    iterations: int
    inner: int = 1
    tolerance: float = 0.05
    tested: Literal["all", "long", "none"] = "all"
    largest: float = np.inf
    continued: bool = False

    @staticmethod
    def of(config: OutlineConfig, shrink: int, iterations: int | None = None, *, continued: bool = False) -> Steps:
        """Return the steps on the coverage at 1 / ``shrink`` of the image size, where modes only need to be told apart.

        ``iterations`` replaces the largest number of these. A step within the tolerance, with which a refinement ends,
        is taken without drawing it.
        """
        most = config.iterations if iterations is None else iterations
        if shrink == 1:
            return Steps(most, config.inner_steps, config.tolerance, "long", continued=continued)
        tolerance = (_AT_HALF_SIZE if shrink == 2 else _AT_SMALLER_SIZE) * config.tolerance
        return Steps(most, max(config.inner_steps // 3, 1), tolerance, "long", continued=continued)


@dataclass(frozen=True, eq=False)
class _Part(Generic[A]):
    """The approximation near one of several poses: ``group`` is that near all of them, ``index`` the pose's place."""

    group: A
    index: int

    @staticmethod
    def joined(parts: Sequence[_Part[A]]) -> A:
        """Return the approximation near several poses together; of one group, nothing is copied pose by pose."""
        groups = list({id(part.group): part.group for part in parts}.values())
        if len(groups) == 1:
            chosen = [part.index for part in parts]
            whole = len(chosen) == groups[0].count and chosen == list(range(len(chosen)))
            return groups[0] if whole else groups[0].select(chosen)
        return type(groups[0]).joined([part.group.select([part.index]) for part in parts])


@dataclass(eq=False)
class _State:
    """State of the refinement of one pose: what was drawn there, and the last approximation that was computed.

    ``others`` is the sum of squares of the other terms, ``weight`` the factor on that of the outline. ``drawn_at`` is
    where the state was drawn last: elsewhere after a step that was not tested.
    """

    at: Posed
    drawn: Any
    others: float
    weight: float = 1.0
    near: _Part[Any] = field(init=False)
    quadratic: _Part[Quadratic] = field(init=False)
    information: Float64 = field(init=False)
    damping: float = _DAMPING[1]
    moved: bool = True
    finished: bool = False
    drawn_at: Posed = field(init=False)

    def __post_init__(self) -> None:
        self.drawn_at = self.at

    @property
    def stale(self) -> bool:
        """Whether the state moved on from where it was drawn."""
        return self.at is not self.drawn_at


def refine(
    outline: OutlineTerm[Any], terms: Sequence[Term], starts: Posed, steps: Steps, selection: Selection = ALL
) -> list[Fit]:
    """Refine C starts on the sum of the outline's term and other ``terms``; returns their fits in the same order.

    ``selection`` tells which of the poses take part in each iteration.
    """
    return _Refinement(outline, tuple(terms), steps).run(starts, selection)


def assess(outline: OutlineTerm[Any], terms: Sequence[Term], at: Posed) -> Fit:
    """Score one pose without refining it."""
    return refine(outline, terms, type(at).stacked([at]), Steps(0))[0]


@dataclass(frozen=True, eq=False)
class _Refinement:
    """The sum of terms, and how it is made small."""

    outline: OutlineTerm[Any]
    terms: tuple[Term, ...]
    steps: Steps

    def run(self, starts: Posed, selection: Selection) -> list[Fit]:
        """Refine C starts."""
        begun = zip(self.outline.draw(starts), sum_of_costs(self.terms, starts).tolist(), strict=True)
        states = [_State(starts[k], drawn, others) for k, (drawn, others) in enumerate(begun)]
        self._approximate(states)
        kept = float(len(states))
        for left in reversed(range(self.steps.iterations)):
            outline_scores = [self.outline.score_of(state.drawn) for state in states]
            scores = [alone + 0.5 * state.others for alone, state in zip(outline_scores, states, strict=True)]
            chosen = [states[i] for i in selection.continuing(scores, outline_scores, kept)]
            active = [state for state in chosen if not state.finished]
            if not active:
                break
            self._approximate([state for state in active if state.moved])
            self._advance(active, last=left == 0 and not self.steps.continued)
            kept *= selection.share
        return [self._fit(state) for state in states]

    def _approximate(self, states: Sequence[_State]) -> None:
        """Compute the approximation of the terms, and the information about the changes of states at their poses."""
        if not states:
            return
        stale = [state for state in states if state.stale]
        for state, drawn in zip(stale, self.outline.draw(_poses(stale)) if stale else (), strict=True):
            state.drawn, state.drawn_at = drawn, state.at
        at = _poses(states)
        near = self.outline.near([state.drawn for state in states], at)
        others = sum_of_locals(self.terms, at).padded(near.dimension)
        information, _ = near.normal_equations(np.zeros((len(states), near.dimension)))
        for k, state in enumerate(states):
            state.weight = self.outline.weight_of(state.drawn)
            state.near, state.quadratic = _Part(near, k), _Part(others, k)
            state.information = state.weight * information[k] + others.information[k]
            state.moved = False
            # where the outline tells nothing, nothing holds back a step that is not tested
            state.finished |= self.steps.tested == "none" and not information[k].any()

    def _advance(self, active: Sequence[_State], *, last: bool) -> None:
        """Take one step from each state; one that is tested is kept if it lowers the sum of squares.

        After the ``last`` no derivatives are needed.
        """
        states = [state for state in active if not state.finished]
        if not states:
            return
        changes = self._changes(states)
        at = _poses(states).moved(changes)
        if self.steps.tested == "none":
            for term in self.terms:
                at = term.allowed(at)
        others = sum_of_costs(self.terms, at).tolist()
        small = [self._is_small(state, change) for state, change in zip(states, changes, strict=True)]
        tested = []
        for k, state in enumerate(states):
            if self.steps.tested == "all" or (self.steps.tested == "long" and not small[k]):
                tested.append(k)
            else:
                state.at, state.others, state.finished = at[k], others[k], small[k]
                state.moved = True
        if not tested:
            return
        for k, drawn in zip(tested, self.outline.draw(at[tested], derivatives=not last), strict=True):
            self._test(states[k], at[k], drawn, others[k], small=small[k])

    def _test(self, state: _State, at: Posed, drawn: Any, others: float, *, small: bool) -> None:
        """Move a state to a trial pose if that lowers the sum of squares; otherwise increase its damping."""
        loss = self.outline.cost_of(drawn)
        gain = state.weight * (self.outline.cost_of(state.drawn) - loss) + state.others - others
        if gain <= 0:
            state.damping *= _DAMPING_STEP
            state.finished = small or state.damping > _DAMPING[2]
            return
        state.finished = small or gain < _SMALL_GAIN * self.steps.tolerance
        state.at = state.drawn_at = at
        state.drawn, state.others, state.moved = drawn, others, True
        state.damping = max(state.damping / _DAMPING_STEP, _DAMPING[0])

    def _is_small(self, state: _State, change: Float64) -> bool:
        """Return whether a change (D,) of a state is shorter than the tolerance."""
        return bool(change @ state.information @ change < self.steps.tolerance**2 * len(change))

    def _changes(self, states: Sequence[_State]) -> Float64:
        """Return the changes (C, D) of C states that minimise the approximations of their terms."""
        near = _Part.joined([state.near for state in states])
        others = _Part.joined([state.quadratic for state in states])
        weight = np.array([state.weight for state in states])
        damping = None if self.steps.tested == "none" else np.array([state.damping for state in states])
        changes = minimise(near, weight, others, damping, self.steps.inner)
        if self.steps.largest < np.inf:
            information = np.stack([state.information for state in states])
            sizes = np.sqrt(np.einsum("ci,cij,cj->c", changes, information, changes))
            changes = changes * np.minimum(1.0, self.steps.largest / np.maximum(sizes, 1e-12))[:, None]
        return changes

    def _fit(self, state: _State) -> Fit:
        """Return the refined pose of a state with its score."""
        alone = self.outline.score_of(state.drawn, final=True)
        score = alone + 0.5 * state.others
        return Fit(state.at, score, alone, state.information, state.drawn, state.drawn_at)


def _poses(states: Sequence[_State]) -> Posed:
    """Return the poses of C states together."""
    return type(states[0].at).stacked([state.at for state in states])


def minimise(
    near: Approximation, weight: Float64, others: Quadratic, damping: Float64 | None, iterations: int
) -> Float64:
    """Find the changes (C, D) that minimise ``weight`` (C,) times an approximation together with other terms.

    ``damping`` (C,) times the diagonal of the information at no change keeps the changes small (Levenberg-Marquardt).
    Without, only as little is added as makes it invertible: nothing may tell a hidden joint.
    """
    count, dimension = others.slope.shape
    change, held = np.zeros((count, dimension)), None
    for _ in range(iterations):
        information, slope = near.normal_equations(change)
        full = weight[:, None, None] * information + others.information
        if held is None:
            held = _held_back(np.diagonal(full, axis1=1, axis2=2), damping)
        full = full + held[:, :, None] * np.eye(dimension)
        slope = weight[:, None] * slope + others.slope
        slope = slope + np.einsum("cij,cj->ci", others.information, change) + held * change
        step = -np.linalg.solve(full, slope[:, :, None])[:, :, 0]
        change = change + step
        if (np.einsum("ci,cij,cj->c", step, full, step) < _SOLVED**2 * dimension).all():
            break
    return np.asarray(change * near.share_that_holds(change)[:, None])


def _held_back(diagonal: Float64, damping: Float64 | None) -> Float64:
    """Return what is added to the diagonal (C, D) of an information, with or without damping (C,)."""
    if damping is not None:
        return damping[:, None] * (diagonal + 1e-9)
    of_each, of_largest = _LEAST_DAMPING
    return np.asarray(of_each * diagonal + of_largest * np.maximum(diagonal.max(axis=1, keepdims=True), 1.0))
