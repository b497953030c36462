"""Keyframes of a tracker that are solved beside its steps, and when the solutions are used."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Protocol

from dvrk_cmaes.track.keyframe_store import KeyframeProblem, Solution
from dvrk_cmaes.track.tracker import Tracker

_FEW: Final = 8
SECONDS_OF_FEW: Final = 1.0
"""Time, s, from the image after which up to 8 keyframes are given to be solved to the one that their solution is used
from."""
SECONDS_OF_MANY: Final = 2.0
"""The same of more keyframes."""


class Solver(Protocol):
    """Solves keyframes beside the steps, one problem at a time."""

    def begin(self, problem: KeyframeProblem) -> None:
        """Begin with a problem; returns at once."""

    @property
    def ready(self) -> bool:
        """Whether the solution of the last problem is there."""

    def solution(self) -> Solution:
        """Return the solution of the last problem, for which this waits."""


@dataclass
class SolutionSchedule:
    """Gives keyframes to a solver when that is due, and each solution to the tracker a fixed time of images later.

    What a step returns therefore does not depend on how long the solver takes: where it is not done in time, the next
    step waits for it.
    """

    tracker: Tracker
    solver: Solver
    _due: float | None = None

    @property
    def waiting(self) -> bool:
        """Whether keyframes are being solved whose solution is not used yet."""
        return self._due is not None

    def before_step(self, time: float) -> None:
        """Use a solution whose time has come, before the step to the image of a time, s."""
        if self._due is not None and time >= self._due:
            self.finish()

    def after_step(self, time: float) -> None:
        """Begin to solve the keyframes if that is due after the step to the image of a time, s."""
        if self._due is None and self.tracker.solution_due:
            problem = self.tracker.problem()
            self.solver.begin(problem)
            self._due = time + (SECONDS_OF_FEW if len(problem.keyframes) <= _FEW else SECONDS_OF_MANY)

    def finish(self) -> None:
        """Wait for the solution, if keyframes are being solved, and use it."""
        if self._due is not None:
            self._due = None
            self.tracker.use(self.solver.solution())
