"""When the solutions of keyframes are used: by the times of images, never by the clock."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

from dvrk_cmaes.track.solution_schedule import SECONDS_OF_FEW, SECONDS_OF_MANY, SolutionSchedule


class FakeTracker:
    """Has a number of keyframes, which are due once."""

    def __init__(self) -> None:
        self.keyframes, self.solution_due, self.used = 0, False, list[int]()
        self.unsolved_keyframes: list[str] = []

    def has(self, keyframes: int) -> None:
        self.keyframes, self.solution_due = keyframes, True

    def problem(self) -> Any:
        self.solution_due = False
        return SimpleNamespace(keyframes=[None] * self.keyframes)

    def use(self, solution: int) -> None:
        self.used.append(solution)


class FakeSolver:
    """A solution is the number of keyframes."""

    def __init__(self) -> None:
        self.asked: list[int] = []
        self.prepared: list[list[str]] = []

    def prepare(self, tasks: list[str]) -> None:
        self.prepared.append(list(tasks))

    def begin(self, problem: Any) -> None:
        self.asked.append(len(problem.keyframes))

    def solution(self) -> int:
        return self.asked.pop(0)


def test_solutions_are_used_a_fixed_time_of_images_later_in_their_order() -> None:
    tracker, solver = FakeTracker(), FakeSolver()
    schedule = SolutionSchedule(cast(Any, tracker), cast(Any, solver))
    used = {}
    for k in range(200):
        time = k / 30
        schedule.before_step(time)
        for count in tracker.used[len(used) :]:
            used[count] = k
        if k in (9, 20, 45):
            tracker.has({9: 4, 20: 8, 45: 32}[k])
        schedule.after_step(time)
    assert used == {4: 9 + 30 * SECONDS_OF_FEW, 8: 20 + 30 * SECONDS_OF_FEW, 32: 45 + 30 * SECONDS_OF_MANY}
    assert not schedule.waiting


def test_keyframes_are_estimated_ahead_of_the_solution_that_needs_them() -> None:
    tracker, solver = FakeTracker(), FakeSolver()
    schedule = SolutionSchedule(cast(Any, tracker), cast(Any, solver))
    tracker.unsolved_keyframes = ["0.1"]
    schedule.after_step(0.1)
    tracker.unsolved_keyframes = ["0.1", "0.4"]
    schedule.after_step(0.4)
    assert solver.prepared == [["0.1"], ["0.1", "0.4"]]
    assert not solver.asked


def test_solutions_are_waited_for_at_the_end() -> None:
    tracker, solver = FakeTracker(), FakeSolver()
    schedule = SolutionSchedule(cast(Any, tracker), cast(Any, solver))
    tracker.has(4)
    schedule.after_step(0.0)
    assert schedule.waiting
    schedule.finish()
    assert tracker.used == [4]
    assert not schedule.waiting
