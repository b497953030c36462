"""Keyframes of a tracker, solved in this process, for figures that no other process is to change."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

from dvrk_cmaes.results.result import Result
from dvrk_cmaes.silhouette import Body
from dvrk_cmaes.track.keyframe_problem import KeyframeProblem, KeyframeTask, Solution


@dataclass
class SolverHere:
    """Solves keyframes at once, in this process; ``seconds`` is what that took of its time.

    Problems that are posed again, when a recording is followed again, are not solved again.
    """

    body: Body
    seconds: float = 0.0
    _solutions: deque[Solution] = field(default_factory=deque)
    _alone: dict[str, Result] = field(default_factory=dict)
    _known: dict[tuple[str, ...], Solution] = field(default_factory=dict)

    def begin(self, problem: KeyframeProblem) -> None:
        """Solve a problem."""
        began = time.process_time()
        names = tuple(keyframe.name for keyframe in problem.keyframes)
        if names not in self._known:
            alone = {name: self._alone[name] for name in names if name in self._alone}
            self._known[names] = replace(problem, alone={**alone, **problem.alone}).solve(self.body)
            self._alone = dict(self._known[names].alone)
        self._solutions.append(replace(self._known[names], base=problem.base))
        self.seconds += time.process_time() - began

    def prepare(self, tasks: Sequence[KeyframeTask]) -> None:
        """Do nothing: `begin` estimates the keyframes that it needs."""

    @property
    def ready(self) -> bool:
        """Whether the next solution is there."""
        return bool(self._solutions)

    def solution(self) -> Solution:
        """Return the next solution."""
        return self._solutions.popleft()
