"""Local refinement with subpixel accuracy: damped Gauss-Newton on the sum of an outline's term and others.

Several poses are refined together, because drawing eight costs little more than drawing one. An iteration minimises the
approximation of the terms by several short steps, then draws one silhouette with its outline. (For the coverage, that
is iteratively reweighted least squares, whose short steps would otherwise each cost a silhouette.)
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final, Literal

import numpy as np

from dvrk_cmaes import _kernel
from dvrk_cmaes.config import OutlineConfig
from dvrk_cmaes.geometry import Bool, Float64, Indices, Posed
from dvrk_cmaes.pose.refine.information import ALL, Selection
from dvrk_cmaes.pose.search.starts import PoseCandidate
from dvrk_cmaes.pose.terms.coverage import Profiles
from dvrk_cmaes.pose.terms.sized_view import Derivatives, OutlineTerm
from dvrk_cmaes.pose.terms.term import Approximation, Quadratic, Term, sum_of_costs, sum_of_locals

_DAMPING = (1e-4, 1e-2, 10.0)  # least, first and largest of the Levenberg-Marquardt steps
_DAMPING_STEP = 8.0  # factor on the damping by which it grows or falls
_SMALL_GAIN = 0.1  # of the tolerance
_AT_HALF_SIZE, _AT_SMALLER_SIZE = 4.0, 10.0  # factors on the tolerance where a refinement at a larger size follows
_LARGEST_SHIFT = 3.0  # px; beyond it an outline has left the samples of the approximation
_SOLVED = 0.01  # length of a step, in standard deviations per parameter, below which an approximation's minimum is met
_LEAST_DAMPING: Final = 1e-9, 1e-12  # of steps that are not damped: of each diagonal element, and of the largest one


@dataclass(frozen=True, eq=False)
class Fit(PoseCandidate):
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
    def of(config: OutlineConfig, shrink: int, iterations: int | None = None) -> Steps:
        """Return the steps on the coverage at 1 / ``shrink`` of the image size, which only has to distinguish modes.

        ``iterations`` replaces the largest number of these, and another refinement continues then. A step within the
        tolerance, with which a refinement ends, is taken without drawing it.
        """
        most, continued = config.iterations if iterations is None else iterations, iterations is not None
        if shrink == 1:
            return Steps(most, config.inner_steps, config.tolerance, "long", continued=continued)
        tolerance = (_AT_HALF_SIZE if shrink == 2 else _AT_SMALLER_SIZE) * config.tolerance
        return Steps(most, max(config.inner_steps // 3, 1), tolerance, "long", continued=continued)


@dataclass(eq=False)
class _States:
    """The state of each of C poses that are refined together.

    at : the poses. drawn : what was drawn of each, at the pose in ``drawn_at``, which is another one after a step that
    was not tested (``stale``). outline : the score of what was drawn. others : sum of squares of the other terms.
    weight : factor on that of the outline. information : that of the sum, about each pose. moved : whether the pose has
    moved on since its approximation was computed, of which ``quadratic`` are the other terms. ``finished`` poses stay.
    """

    at: Posed
    drawn: list[Any]
    others: Float64
    information: Float64
    quadratic: Quadratic

    def __post_init__(self) -> None:
        count = len(self.at)
        self.drawn_at = self.at[np.arange(count)]
        self.outline, self.weight = np.zeros(count), np.ones(count)
        self.damping = np.full(count, _DAMPING[1])
        self.moved, self.stale, self.finished = np.ones(count, bool), np.zeros(count, bool), np.zeros(count, bool)

    @staticmethod
    def put(at: Posed, index: Indices, those: Posed) -> None:
        """Replace some of several poses."""
        at.pose[index], at.joints[index] = those.pose, those.joints


def refine(
    outline: OutlineTerm[Any],
    terms: Sequence[Term],
    starts: Posed,
    steps: Steps,
    selection: Selection = ALL,
    derivatives: Derivatives = "closed-form",
) -> list[Fit]:
    """Refine C starts on the sum of the outline's term and other ``terms``; returns their fits in the same order.

    ``selection`` is which of the poses take part in each iteration, ``derivatives`` how those of the outline are
    found.
    """
    return _Refinement(outline, tuple(terms), steps, derivatives).run(starts, selection)


def assess(outline: OutlineTerm[Any], terms: Sequence[Term], at: Posed) -> list[Fit]:
    """Score C poses without refining them."""
    return refine(outline, terms, at, Steps(0))


@dataclass(frozen=True, eq=False)
class _Refinement:
    """The sum of terms, and how it is made small."""

    outline: OutlineTerm[Any]
    terms: tuple[Term, ...]
    steps: Steps
    derivatives: Derivatives

    def run(self, starts: Posed, selection: Selection) -> list[Fit]:
        """Refine C starts."""
        drawn, count = self.outline.draw(starts, derivatives=self.derivatives), len(starts)
        nothing = Quadratic.zero(count, 6 + starts.joints.shape[1])
        every = np.arange(count)
        states = _States(starts[every], drawn, sum_of_costs(self.terms, starts), nothing.information.copy(), nothing)
        states.outline[:] = [self.outline.score_of(one) for one in drawn]
        self._approximate(states, every)
        kept = float(count)
        for left in reversed(range(self.steps.iterations)):
            chosen = selection.continuing(states.outline + 0.5 * states.others, states.outline, kept)
            active = np.array([k for k in chosen if not states.finished[k]], dtype=np.intp)
            if not len(active):
                break
            self._approximate(states, active[states.moved[active]])
            self._advance(states, active[~states.finished[active]], last=left == 0 and not self.steps.continued)
            kept *= selection.share
        alone = [self.outline.score_of(one, final=True) for one in states.drawn]
        scores = (alone + 0.5 * states.others).tolist()
        return [
            Fit(states.at[k], scores[k], alone[k], states.information[k], states.drawn[k], states.drawn_at[k])
            for k in range(count)
        ]

    def _draw(self, states: _States, index: Indices, at: Posed, drawn: Sequence[Any]) -> None:
        """Note what was drawn of some states, at the poses where they are."""
        _States.put(states.drawn_at, index, at)
        for k, one in zip(index, drawn, strict=True):
            states.drawn[k], states.outline[k], states.stale[k] = one, self.outline.score_of(one), False

    def _approximate(self, states: _States, index: Indices) -> None:
        """Compute the information about the changes of some states at their poses, and draw those that are stale."""
        if not len(index):
            return
        stale = index[states.stale[index]]
        if len(stale):
            drawn = self.outline.draw(states.at[stale], derivatives=self.derivatives)
            self._draw(states, stale, states.at[stale], drawn)
        near = self.outline.near([states.drawn[k] for k in index], states.at[index])
        others = sum_of_locals(self.terms, states.at[index])
        information, _ = near.normal_equations(np.zeros_like(others.slope))
        states.weight[index] = [self.outline.weight_of(states.drawn[k]) for k in index]
        states.quadratic.information[index], states.quadratic.slope[index] = others.information, others.slope
        states.information[index] = states.weight[index, None, None] * information + others.information
        states.moved[index] = False
        if self.steps.tested == "none":  # where the outline has no information, nothing limits a step
            states.finished[index] |= ~information.any(axis=(1, 2))

    def _advance(self, states: _States, index: Indices, *, last: bool) -> None:
        """Take one step from some states; one that is tested is kept if it lowers the sum of squares.

        After the ``last`` no derivatives are needed.
        """
        if not len(index):
            return
        changes = self._changes(states, index)
        at = states.at[index].moved(changes)
        if self.steps.tested == "none":
            for term in self.terms:
                at = term.allowed(at)
        others = sum_of_costs(self.terms, at)
        square = np.einsum("ci,cij,cj->c", changes, states.information[index], changes)
        small = square < self.steps.tolerance**2 * changes.shape[1]
        tested = np.full(len(index), self.steps.tested == "all") | (~small if self.steps.tested == "long" else False)
        taken = index[~tested]
        _States.put(states.at, taken, at[~tested])
        states.others[taken], states.finished[taken] = others[~tested], small[~tested]
        states.moved[taken] = states.stale[taken] = True
        if tested.any():
            self._test(states, index[tested], at[tested], others[tested], small[tested], last=last)

    def _test(self, states: _States, index: Indices, at: Posed, others: Float64, small: Bool, *, last: bool) -> None:
        """Move states to trial poses where that lowers the sum of squares; otherwise increase their damping."""
        # differences cost twenty silhouettes: they are taken only once a pose is kept
        later = last or self.derivatives == "differences"
        drawn = self.outline.draw(at, derivatives=None if later else self.derivatives)
        fall = [
            self.outline.cost_of(states.drawn[k]) - self.outline.cost_of(one)
            for k, one in zip(index, drawn, strict=True)
        ]
        gain = states.weight[index] * fall + states.others[index] - others
        better = gain > 0
        worse, moved = index[~better], index[better]
        states.damping[worse] *= _DAMPING_STEP
        states.finished[worse] = small[~better] | (states.damping[worse] > _DAMPING[2])
        states.finished[moved] = (small | (gain < _SMALL_GAIN * self.steps.tolerance))[better]
        _States.put(states.at, moved, at[better])
        self._draw(states, moved, at[better], [one for one, is_better in zip(drawn, better, strict=True) if is_better])
        states.others[moved], states.moved[moved] = others[better], True
        states.stale[moved] = later and not last
        states.damping[moved] = np.maximum(states.damping[moved] / _DAMPING_STEP, _DAMPING[0])

    def _changes(self, states: _States, index: Indices) -> Float64:
        """Return the changes (C, D) of C states that minimise the approximations of their terms."""
        near = self.outline.near([states.drawn[k] for k in index], states.at[index])
        others = states.quadratic.select(index)
        damping = None if self.steps.tested == "none" else states.damping[index]
        changes = minimise(near, states.weight[index], others, damping, self.steps.inner)
        if self.steps.largest < np.inf:
            sizes = np.sqrt(np.einsum("ci,cij,cj->c", changes, states.information[index], changes))
            changes = changes * np.minimum(1.0, self.steps.largest / np.maximum(sizes, 1e-12))[:, None]
        return changes


def minimise(
    near: Approximation, weight: Float64, others: Quadratic, damping: Float64 | None, iterations: int
) -> Float64:
    """Find the changes (C, D) that minimise ``weight`` (C,) times an approximation together with other terms.

    ``damping`` (C,) times the diagonal of the information at no change keeps the changes small (Levenberg-Marquardt).
    Without, only as little is added as makes it invertible: a hidden joint may be unobservable.
    """
    compared: Sequence[_kernel.Comparison] = ()
    factors: Sequence[float] = (1.0,)
    density, cauchy = factors, 1.0
    if isinstance(near, Profiles):
        compared, factors, density, cauchy = near.compared, near.factors, near.density, near.cauchy
    else:
        assert isinstance(near, Quadratic)
        others = others + near.times(weight)
    return _kernel.minimise(
        compared,
        factors,
        density,
        cauchy,
        weight,
        others.information,
        others.slope,
        damping,
        iterations,
        _SOLVED**2 * others.dimension,
        _LEAST_DAMPING,
        _LARGEST_SHIFT,
    )
