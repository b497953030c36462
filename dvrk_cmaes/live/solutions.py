"""Keyframes that are solved in another process, and the calibration that is found, saved, and taken up again."""

from __future__ import annotations

import time as clock
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

from dvrk_cmaes.calibration.document import SessionCalibration
from dvrk_cmaes.camera import Rig
from dvrk_cmaes.errors import DvrkCmaesError, one_line
from dvrk_cmaes.live.connection import Report
from dvrk_cmaes.track.keyframe_problem import Solver
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
    save: Callable[[SessionCalibration], None] | None
    earlier: SessionCalibration | None = None
    tracker: Tracker | None = None
    _rig: Rig | None = None
    _asked: Tracker | None = None
    _not_before: float = 0.0

    def earlier_of(self, rig: Rig) -> SessionCalibration | None:
        """Return the calibration with which a tracker begins; that of other cameras is forgotten."""
        if self._rig is not None and self._rig is not rig:
            self.earlier = None
        self._rig = rig
        return self.earlier

    def before_step(self, time: float) -> None:
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
        self.earlier = asked.calibration
        try:
            if self.save is not None and self.earlier is not None:
                self.save(self.earlier)
        except (DvrkCmaesError, OSError) as error:
            self.report(one_line(error))

    def after_step(self, time: float) -> None:
        """Begin to solve the keyframes if that is due; until it is, new ones are estimated by themselves."""
        tracker = self.tracker
        if tracker is None or clock.monotonic() < self._not_before:
            return
        if self._asked is None and tracker.solution_due:
            self.solver.begin(tracker.problem())
            self._asked = tracker
        self.solver.prepare(tracker.unsolved_keyframes)
