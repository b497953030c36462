"""Keyframes, each by itself and together: the problem that they pose, base, lag and offsets, and its solution."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping, Sequence
from concurrent.futures import Future
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Final, Protocol

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.calibration.calibrate import calibrate_session
from dvrk_cmaes.calibration.document import SessionCalibration
from dvrk_cmaes.calibration.frame_fit import LINES_PER_PIXEL
from dvrk_cmaes.calibration.model import ecm_readings
from dvrk_cmaes.calibration.prediction import Prediction, endoscope_in, lag_and_std
from dvrk_cmaes.calibration.session_doubts import bad_predictions
from dvrk_cmaes.calibration.session_frame import SessionFrame
from dvrk_cmaes.camera import Rig
from dvrk_cmaes.config import EstimateConfig
from dvrk_cmaes.errors import InputError
from dvrk_cmaes.estimation.one_tool import FrameMethod, estimate_views
from dvrk_cmaes.frames.frame import FrameData
from dvrk_cmaes.frames.seen_view import PackedMask, seen_views
from dvrk_cmaes.geometry import Bool
from dvrk_cmaes.instrument import Instrument
from dvrk_cmaes.instrument.arm import OUTER_JOINTS, Arm
from dvrk_cmaes.joints.series import ReadingSeries
from dvrk_cmaes.pose.expected_error import expected_error
from dvrk_cmaes.results.result import Result
from dvrk_cmaes.silhouette import Body

if TYPE_CHECKING:
    from dvrk_cmaes.track.tracker import Tracker


@dataclass(frozen=True, eq=False)
class Keyframe:
    """An image that is kept: its time, s, masks and ignored pixels (H, W) by view as packed bits, and readings.

    ``rates`` are those of the readings, per s.
    """

    time: float
    masks: Mapping[str, NDArray[np.uint8]]
    ignored: Mapping[str, NDArray[np.uint8]]
    readings: Mapping[str, float]
    rates: Mapping[str, float]

    @property
    def name(self) -> str:
        """Name of the frame in a calibration."""
        return f"{self.time:.6f}"

    def data(self, rig: Rig) -> FrameData:
        """Return the frame as it was given.

        Parameters
        ----------
        rig
            The rig whose views the keyframe has.
        """

        def arrays(packed: Mapping[str, NDArray[np.uint8]]) -> dict[str, Bool]:
            sizes = {name: (rig.view(name).camera.height, rig.view(name).camera.width) for name in packed}
            return {name: PackedMask(sizes[name], bits.tobytes()).restored() for name, bits in packed.items()}

        return FrameData(seen_views(arrays(self.masks), rig, arrays(self.ignored) or None))


@dataclass(frozen=True, eq=False)
class Solution:
    """What keyframes determine together: the calibration, or why there is none.

    ``keyframes`` is their number, ``alone`` their own results by name, so that none is solved twice. ``base`` counts
    the bases of the tracker before the one that the keyframes are of. ``tip_mm`` is the expected error of the tips, mm,
    that the calibration and its lag leave where the keyframes are, in the median: how far the base is known.
    """

    calibration: SessionCalibration | None
    reason: str
    keyframes: int
    alone: Mapping[str, Result]
    base: int = 0
    tip_mm: float = np.inf


@dataclass(frozen=True, eq=False)
class KeyframeProblem:
    """Keyframes and all that is needed to solve them by themselves or together, in this or in another process.

    ``series`` are the readings; None for keyframes that are only estimated by themselves. ``alone`` are results of
    keyframes that were solved by themselves before, by name; ``base`` is as in `Solution`.
    """

    keyframes: tuple[Keyframe, ...]
    series: ReadingSeries | None
    rig: Rig
    arm: Arm
    config: EstimateConfig
    alone: Mapping[str, Result] = field(default_factory=dict)
    base: int = 0

    def estimate(self, body: Body, threads: int = 1) -> dict[str, Result]:
        """Estimate the keyframes by themselves, by name; results do not depend on the number of threads.

        Parameters
        ----------
        body
            The instrument.
        threads
            Number of threads.

        Raises
        ------
        InputError
            As `dvrk_cmaes.estimate`.
        """
        config, alone = replace(self.config, threads=threads), dict(self.alone)
        for keyframe in self.keyframes:
            if keyframe.name not in alone:
                views, method = keyframe.data(self.rig).views, FrameMethod("classic", config)
                found = estimate_views(views, keyframe.readings, body, method, named=True)
                alone[keyframe.name] = Result.from_dict(found.to_dict())  # in the digits of its document
        return {keyframe.name: alone[keyframe.name] for keyframe in self.keyframes}

    def solve(self, body: Body, threads: int = 1) -> Solution:
        """Estimate the keyframes by themselves, and find base, lag and offsets from all of them.

        The solution does not depend on the number of threads.

        Parameters
        ----------
        body
            The instrument.
        threads
            Number of threads.
        """
        session, refine = replace(self.config.session, shadows=True), self.config.refine
        refine = replace(refine, outline=replace(refine.outline, lines_per_pixel=LINES_PER_PIXEL))
        config = replace(self.config, threads=threads, session=session, refine=refine)
        alone = self.estimate(body, threads)
        frames = [
            SessionFrame(one.name, one.data(self.rig), alone[one.name], None, one.time, brief=True)
            for one in self.keyframes
        ]
        try:
            solved = calibrate_session(frames, body, series=self.series, arm=self.arm, config=config)
        except InputError as error:
            return Solution(None, str(error), len(frames), alone, self.base)
        found = SessionCalibration.from_dict(solved.calibration.to_dict())  # in the digits of its document
        tip_mm = self._tip_error(found, body.instrument)
        return Solution(found, bad_predictions(found), len(frames), alone, self.base, tip_mm)

    def _tip_error(self, calibration: SessionCalibration, instrument: Instrument) -> float:
        """Return the expected error of the tips, mm, in the median of the keyframes by the calibration alone."""
        if not self.keyframes:
            return np.inf
        names = (*OUTER_JOINTS, *instrument.joint_names)
        values = np.array([[keyframe.readings.get(name, np.nan) for name in names] for keyframe in self.keyframes])
        rates = np.array([[keyframe.rates.get(name, 0.0) for name in names] for keyframe in self.keyframes])
        _, std = lag_and_std(calibration, self.config.track.lag_std)
        outer, joints = np.split(values, [len(OUTER_JOINTS)], axis=1)
        read = ecm_readings([one.readings for one in self.keyframes])
        moments = [one.time for one in self.keyframes], [one.name for one in self.keyframes]
        endoscope = endoscope_in(calibration, *moments, read)
        of_all = calibration, outer, joints, instrument.joint_names
        known = Prediction.of(*of_all, endoscope=endoscope)
        late = Prediction.of(*of_all, late=std * np.nan_to_num(rates), endoscope=endoscope)
        covariance = known.shared + late.prior - known.prior
        errors = [expected_error(instrument, known.at[k], own).of_tips_mm for k, own in enumerate(covariance)]
        return float(np.median(errors))


_FEW: Final = 20
SECONDS_OF_FEW: Final = 1.0
"""Time, s, from the image after which up to 20 keyframes are given to be solved to the one that their solution is used
from."""
SECONDS_OF_MANY: Final = 2.0
"""The same of more keyframes."""


class Solver(Protocol):
    """Solves keyframes while images are followed: of the problems, what is asked for first is solved first."""

    def begin(self, problem: KeyframeProblem) -> Future[Solution]:
        """Begin with a problem, after those before it; returns at once."""

    def prepare(self, tasks: Sequence[KeyframeProblem]) -> None:
        """Estimate keyframes, of one task each, by themselves ahead of a problem that has them; returns at once.

        The solutions are the same without; they are there sooner.
        """


@dataclass
class SolutionSchedule:
    """Gives keyframes to a solver, if there is one, when that is due, and each solution to the tracker.

    A solution is used a fixed time of images later, so that what a step returns does not depend on how long the solver
    takes: where it is not done in time, the next step waits for it. With ``at_once`` it is used as soon as it is there,
    and one problem is solved at a time.
    """

    tracker: Tracker
    solver: Solver | None
    at_once: bool = False
    _asked: deque[tuple[float, Future[Solution]]] = field(default_factory=deque)

    def before_step(self, time: float) -> bool:
        """Use the solutions whose time has come, before the step to the image of a time, s.

        Returns whether images are followed by a new calibration. Raises what solving the keyframes raised.
        """
        used = False
        while self._asked and (self._asked[0][1].done() if self.at_once else time >= self._asked[0][0]):
            used |= self.tracker.use(self._asked.popleft()[1].result())
        return used

    def after_step(self, time: float) -> None:
        """Begin to solve the keyframes if that is due after the step to the image of a time, s.

        Until it is, new ones are estimated by themselves.
        """
        if self.solver is None:
            return
        if self.tracker.solution_due and not (self.at_once and self._asked):
            problem = self.tracker.problem()
            due = time + (SECONDS_OF_FEW if len(problem.keyframes) <= _FEW else SECONDS_OF_MANY)
            due = max(due, self._asked[-1][0]) if self._asked else due
            self._asked.append((due, self.solver.begin(problem)))
        self.solver.prepare(self.tracker.unsolved_keyframes)

    def finish(self) -> None:
        """Wait for the solutions of all keyframes that are being solved, and use them."""
        self.before_step(np.inf)
