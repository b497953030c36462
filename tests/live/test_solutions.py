"""Solutions of keyframes beside the steps of an arm that is followed live: when they are used and saved."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from concurrent.futures import Future
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any, cast

import pytest
from helpers.moving_worlds import MovingWorld, moving_world

from dvrk_cmaes import DvrkCmaesError, EstimateConfig, KeyframeProblem, Rig, Solution
from dvrk_cmaes.config import TrustConfig
from dvrk_cmaes.export.frames import FrameNames
from dvrk_cmaes.live.follow import ArmSetup, FollowedArm

pytestmark = pytest.mark.usefixtures("searches_short")

CONFIG = EstimateConfig(trust=TrustConfig(tip_mm=3.0))  # small images tell less about the depth


@dataclass
class FakeSolver:
    """Has solved a problem when a test says so."""

    problems: list[KeyframeProblem] = field(default_factory=list)
    futures: list[Future[Solution]] = field(default_factory=list)
    wanted: list[str] = field(default_factory=list)

    def begin(self, problem: KeyframeProblem) -> Future[Solution]:
        self.problems.append(problem)
        self.futures.append(Future())
        return self.futures[-1]

    def prepare(self, tasks: Sequence[KeyframeProblem]) -> None:
        self.wanted = [task.keyframes[0].name for task in tasks]


@dataclass
class Live:
    """An arm that is followed, with its solver, and what it reports and saves."""

    world: MovingWorld
    solver: FakeSolver = field(default_factory=FakeSolver)
    lines: list[str] = field(default_factory=list)
    saved: list[Mapping[str, Any]] = field(default_factory=list)

    def __post_init__(self) -> None:
        @contextmanager
        def solver() -> Any:
            yield self.solver

        body = self.world.body
        setup = ArmSetup(FrameNames("PSM1"), body, solver=cast(Any, solver), save=self.saved.append, config=CONFIG)
        self.arm = FollowedArm(setup, self.lines.append).begin(Rig.of(self.world.camera))

    def step(self, k: int) -> None:
        """Follow to an image."""
        k %= len(self.world.masks)
        masks = {"left": self.world.masks[k]}
        self.arm.step([(self.world.time(k), self.world.readings[k])], self.world.time(k), masks)


@pytest.fixture
def live() -> Live:
    """Images of which some are kept as keyframes, whose problem is asked for."""
    found = Live(moving_world(right=0.004))
    for k in range(len(found.world.masks)):
        found.step(k)
        time.sleep(0.05)  # for the search of the first image, in the background
        if found.solver.problems:
            break
    return found


def test_solution_is_used_and_saved_when_it_is_there_and_no_step_waits_for_it(live: Live) -> None:
    solver, last = live.solver, 30
    assert len(solver.problems) == 1
    assert solver.wanted[: len(solver.problems[0].keyframes)]
    live.step(last)
    assert live.saved == []
    solution = solver.problems[0].solve(live.world.body)
    better = Solution(solution.calibration, "", 40, solution.alone, solution.base, 0.5)
    solver.futures[0].set_result(better)
    live.step(last + 1)
    assert solution.calibration is not None
    assert live.saved == [solution.calibration.to_dict()]


def test_solution_for_a_tracker_that_began_anew_since_is_dropped(live: Live) -> None:
    live.arm.begin(Rig.of(live.world.camera))
    live.solver.futures[0].set_result(Solution(None, "of the tracker before", 40, {}))
    live.step(-1)
    assert "of the tracker before" not in live.arm.state
    assert live.saved == []


def test_solver_that_fails_costs_one_line(live: Live) -> None:
    live.solver.futures[0].set_exception(DvrkCmaesError("its process died"))
    for k in (-3, -2, -1):
        live.step(k)
    assert live.lines == ["solution of keyframes: its process died"]
