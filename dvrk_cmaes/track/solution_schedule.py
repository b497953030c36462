"""Keyframes of a tracker that are solved beside its steps, and when the solutions are used."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Final, Protocol

from dvrk_cmaes.track.keyframe_problem import KeyframeProblem, KeyframeTask, Solution
from dvrk_cmaes.track.tracker import Tracker

_FEW: Final = 20
SECONDS_OF_FEW: Final = 1.0
"""Time, s, from the image after which up to 20 keyframes are given to be solved to the one that their solution is used
from."""
SECONDS_OF_MANY: Final = 2.0
"""The same of more keyframes."""


class Solver(Protocol):
    """Solves keyframes beside the steps: what is asked for first is solved first."""

    def begin(self, problem: KeyframeProblem) -> None:
        """Begin with a problem, after those before it; returns at once."""

    def prepare(self, tasks: Sequence[KeyframeTask]) -> None:
        """Estimate keyframes by themselves ahead of a problem that has them, each once; returns at once.

        The solutions are the same without; they are there sooner.
        """

    @property
    def ready(self) -> bool:
        """Whether the next solution is there."""

    def solution(self) -> Solution:
        """Return the next solution, for which this waits."""


@dataclass
class SolutionSchedule:
    """Gives keyframes to a solver when that is due, and each solution to the tracker a fixed time of images later.

    What a step returns therefore does not depend on how long the solver takes: where it is not done in time, the next
    step waits for it.
    """

    tracker: Tracker
    solver: Solver
    _due: deque[float] = field(default_factory=deque)

    @property
    def waiting(self) -> bool:
        """Whether keyframes are being solved whose solution is not used yet."""
        return bool(self._due)

    def before_step(self, time: float) -> None:
        """Use the solutions whose time has come, before the step to the image of a time, s."""
        while self._due and time >= self._due[0]:
            self._use_next()

    def after_step(self, time: float) -> None:
        """Begin to solve the keyframes if that is due after the step to the image of a time, s.

        Until it is, new ones are estimated by themselves.
        """
        if self.tracker.solution_due:
            problem = self.tracker.problem()
            self.solver.begin(problem)
            due = time + (SECONDS_OF_FEW if len(problem.keyframes) <= _FEW else SECONDS_OF_MANY)
            self._due.append(max(due, self._due[-1]) if self._due else due)
        self.solver.prepare(self.tracker.unsolved_keyframes)

    def finish(self) -> None:
        """Wait for the solutions of all keyframes that are being solved, and use them."""
        while self._due:
            self._use_next()

    def _use_next(self) -> None:
        self._due.popleft()
        self.tracker.use(self.solver.solution())
