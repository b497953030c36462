"""Keyframes that are solved beside the loop, and the calibration that is found, saved, and taken up again."""

from __future__ import annotations

import time as clock
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

from dvrk_cmaes.calibration.document import SessionCalibration
from dvrk_cmaes.errors import DvrkCmaesError, one_line
from dvrk_cmaes.live.connection import Report
from dvrk_cmaes.track.solution_schedule import Solver
from dvrk_cmaes.track.tracker import Tracker

_AFTER_A_FAULT: Final = 60.0  # s without solving, after the solver has failed


@dataclass(eq=False)
class LiveSolutions:
    """Has the keyframes of the present tracker solved, and uses each solution as soon as it is there.

    ``earlier`` is the calibration with which the next tracker begins: that of an earlier run, or the last one found.
    ``save`` writes each calibration that is used; ``report`` takes lines for the user.
    """

    solver: Solver
    report: Report
    save: Callable[[SessionCalibration], None]
    earlier: SessionCalibration | None = None
    tracker: Tracker | None = None
    _asked: Tracker | None = None
    _not_before: float = 0.0

    @property
    def state(self) -> str:
        """How far the base is known, in words."""
        return "" if self.tracker is None else self.tracker.base_state

    def before_step(self) -> None:
        """Use a solution that has come, unless following has begun anew since."""
        if self._asked is None or not self.solver.ready:
            return
        asked, self._asked = self._asked, None
        try:
            solution = self.solver.solution()
        except Exception as error:
            self._not_before = clock.monotonic() + _AFTER_A_FAULT
            self.report(f"keyframes could not be solved: {one_line(error)}")
            return
        if asked is not self.tracker or not asked.use(solution):
            return
        self.earlier = asked.calibration(0.0)
        if self.earlier is not None:
            self._save(self.earlier)

    def after_step(self) -> None:
        """Begin to solve the keyframes if that is due; until it is, new ones are estimated by themselves."""
        tracker = self.tracker
        if tracker is None or clock.monotonic() < self._not_before:
            return
        if self._asked is None and tracker.solution_due:
            self.solver.begin(tracker.problem())
            self._asked = tracker
        self.solver.prepare(tracker.unsolved_keyframes)

    def _save(self, calibration: SessionCalibration) -> None:
        """Write a calibration; where that is not possible, the user is told."""
        try:
            self.save(calibration)
        except (DvrkCmaesError, OSError) as error:
            self.report(one_line(error))
