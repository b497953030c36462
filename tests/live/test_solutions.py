"""Solutions beside the loop of `live`: when they are used, saved and taken up again."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, cast

import pytest
from helpers.page_calibrations import calibration

from dvrk_cmaes import DvrkCmaesError, InputError, prepare
from dvrk_cmaes.live.solutions import LiveSolutions
from dvrk_cmaes.runs.live_session import earlier_calibration, save_calibration


@dataclass
class FakeTracker:
    """Wants its keyframes solved as long as none were."""

    used: list[str] = field(default_factory=list)
    accepts: bool = True
    unsolved_keyframes: tuple[str, ...] = ("0.1", "0.4")

    @property
    def solution_due(self) -> bool:
        return not self.used

    def problem(self) -> str:
        return "problem"

    def use(self, solution: str) -> bool:
        self.used.append(solution)
        return self.accepts

    @property
    def calibration(self) -> str:
        return f"calibration by {self.used[-1]}"


@dataclass
class FakeSolver:
    """Is done when it is told to be."""

    ready: bool = False
    begun: int = 0
    error: Exception | None = None
    prepared: list[str] = field(default_factory=list)

    def prepare(self, tasks: tuple[str, ...]) -> None:
        self.prepared += [task for task in tasks if task not in self.prepared]

    def begin(self, problem: str) -> None:
        self.begun += 1

    def solution(self) -> str:
        self.ready = False
        if self.error is not None:
            raise self.error
        return f"solution {self.begun}"


def solutions_of(solver: FakeSolver, tracker: FakeTracker, lines: list[str], saved: list[Any]) -> LiveSolutions:
    made = LiveSolutions(cast(Any, solver), lines.append, saved.append)
    made.tracker = cast(Any, tracker)
    return made


def test_solution_is_used_and_saved_when_it_is_there_and_no_step_waits_for_it() -> None:
    solver, tracker, lines, saved = FakeSolver(), FakeTracker(), list[str](), list[Any]()
    solutions = solutions_of(solver, tracker, lines, saved)
    for _ in range(5):
        solutions.before_step(0.0)
        solutions.after_step(0.0)
    assert (solver.begun, tracker.used, saved) == (1, [], [])
    assert solver.prepared == ["0.1", "0.4"]
    solver.ready = True
    solutions.before_step(0.0)
    assert (tracker.used, saved) == (["solution 1"], ["calibration by solution 1"])
    assert solutions.earlier == saved[0]


def test_solution_for_a_tracker_that_began_anew_since_is_dropped() -> None:
    solver, tracker, saved = FakeSolver(), FakeTracker(), list[Any]()
    solutions = solutions_of(solver, tracker, [], saved)
    solutions.after_step(0.0)
    later = FakeTracker()
    solutions.tracker = cast(Any, later)
    solver.ready = True
    solutions.before_step(0.0)
    assert (tracker.used, later.used, saved) == ([], [], [])
    solutions.after_step(0.0)
    assert solver.begun == 2


def test_solver_that_fails_costs_one_line_and_is_not_asked_again_at_once() -> None:
    solver, lines = FakeSolver(error=DvrkCmaesError("its process died")), list[str]()
    solutions = solutions_of(solver, FakeTracker(), lines, [])
    solutions.after_step(0.0)
    solver.ready = True
    for _ in range(3):
        solutions.before_step(0.0)
        solutions.after_step(0.0)
    assert lines == ["keyframes could not be solved: its process died"]
    assert solver.begun == 1


def test_calibration_that_was_saved_is_taken_up_again(tmp_path: Path) -> None:
    found, instrument = calibration([]), prepare("lnd").instrument
    assert earlier_calibration(tmp_path / "kept", instrument, "classic") is None
    save_calibration(tmp_path / "kept", found)
    again = earlier_calibration(tmp_path / "kept", instrument, "classic")
    assert again is not None
    assert again.to_dict()["camera_from_base"] == found.to_dict()["camera_from_base"]
    assert again.offsets == pytest.approx(found.offsets, abs=1e-9)
    with pytest.raises(InputError, match="arm si, got one of lnd, classic: choose another --out"):
        earlier_calibration(tmp_path / "kept", instrument, "si")
