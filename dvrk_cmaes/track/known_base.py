"""A tracker's keyframes, and following by the calibration that they give."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from dvrk_cmaes.calibration.document import SessionCalibration
from dvrk_cmaes.calibration.prediction import FoundLag, lag_and_std, lag_of
from dvrk_cmaes.instrument.arm import OUTER_JOINTS
from dvrk_cmaes.joints.names import ECM_JOINTS
from dvrk_cmaes.pose.doubts import (
    NO_OUTER_READINGS,
    base_not_known,
    base_uncertain,
    readings_too_sparse,
    reasons,
    too_few_keyframes,
)
from dvrk_cmaes.results.result import Result
from dvrk_cmaes.results.tracked import BaseKnown, TrackResult, doubted
from dvrk_cmaes.track.follower import Followed, Follower
from dvrk_cmaes.track.keyframe_problem import KeyframeProblem, KeyframeTask, Solution
from dvrk_cmaes.track.keyframes import NEW_AT_MOST, SOLVED_AT, KeyframeStore
from dvrk_cmaes.track.reading_buffer import ReadingAt, ReadingBuffer
from dvrk_cmaes.track.view_segmenter import Seen

_BY_THE_BASE = 1.3  # of the error of the tips that is ok: the most that a first solution may leave, before any image
_LAG_STD = 0.055  # s, largest standard deviation of a lag that keyframes tell
_OWN_IS_ENOUGH = 32  # keyframes, from which on their solution is used although they do not tell the lag
_SOON = 1.0  # s, since following by a calibration began
_NEW_THAT_DISAGREE = 5  # keyframes, of the largest number, with which they are solved anew if images disagree


class CalibratedFollower:
    """Keeps keyframes, and follows by the calibration that was found from them or given; arguments as of `Tracker`."""

    def __init__(self, given: Followed, calibration: SessionCalibration | None, readings: ReadingBuffer) -> None:
        self.store = KeyframeStore(given.rig, given.instrument.joint_names, readings)
        self._given = given
        self._alone: dict[str, Result] = {}
        self._solved = Solution(None, "", 0, {})  # the last one
        self._taken = 0  # keyframes that had been kept when some were last given to be solved
        self._asked: frozenset[str] = frozenset()  # names of these
        self._bases = 0  # that were given up
        self._own = False  # whether the calibration is that of the keyframes
        self._following = None if calibration is None else self._by(calibration)

    @property
    def calibration(self) -> SessionCalibration | None:
        """The calibration by which images are followed; None while there is none."""
        return None if self._following is None else self._following.calibration

    @property
    def lag(self) -> FoundLag | None:
        """The lag of the calibration; None if it does not tell one."""
        return None if self._following is None else self._following.lag

    @property
    def known(self) -> BaseKnown:
        """How far the base is known, in numbers."""
        tip_mm = self._solved.tip_mm if np.isfinite(self._solved.tip_mm) else None
        return BaseKnown(len(self.store), self._solved.keyframes, tip_mm, self.calibration is not None)

    @property
    def state(self) -> str:
        """How far the base is known, in words: by the error of the tips that it leaves."""
        count = f"{len(self.store)} keyframe{'' if len(self.store) == 1 else 's'}"
        tip_mm = self._solved.tip_mm
        known = f"base +- {tip_mm:.2g} mm" if np.isfinite(tip_mm) else "base not known yet"
        if self.calibration is None:
            return f"calibrating: {count}, {known}"
        if not self._own:
            return f"calibration given: {count}"
        return f"{'calibrated' if self._solved.keyframes >= SOLVED_AT[-1] else 'calibrating'}: {count}, {known}"

    @property
    def due(self) -> bool:
        """Whether there are more keyframes than when they were last solved, by enough that it pays.

        A calibration that was given is not replaced as long as it holds. Where the last images disagree with one that
        was found, one more keyframe is enough. When there are as many as are kept, a third of them must be new, or some
        where images disagree.
        """
        if self.calibration is not None and not self._own:
            return False
        given, new = self._most_given, self.store.taken - self._taken
        waiting = given > self._solved.keyframes
        if self._following is not None and self._following.disagrees and not waiting and len(self.store) > SOLVED_AT[0]:
            return new >= (_NEW_THAT_DISAGREE if len(self.store) >= SOLVED_AT[-1] else 1)
        if given >= SOLVED_AT[-1] and new >= NEW_AT_MOST:
            return True
        return any(given < count <= self._most for count in SOLVED_AT)

    @property
    def _most_given(self) -> int:
        """Most keyframes that were solved, or given to be."""
        return max(self._solved.keyframes, len(self._asked))

    @property
    def _most(self) -> int:
        """Most keyframes to solve next: twice those before, since more would take too long to be used soon."""
        return min(len(self.store), max(SOLVED_AT[0], 2 * self._most_given))

    def problem(self) -> KeyframeProblem:
        """Return what the keyframes pose to be solved; of many new ones, those that are farthest from each other.

        They test the camera file, which takes long, once as many as are kept have been solved without that.
        """
        keyframes, config = self.store.spread(self._most, self._asked), self._given.config
        self._asked, self._taken = frozenset(one.name for one in keyframes), self.store.taken
        if self._solved.keyframes < SOLVED_AT[-1]:
            config = replace(config, session=replace(config.session, test_camera=False))
        keyframes, given = sorted(keyframes, key=lambda one: one.time), self._given
        alone = {one.name: self._alone[one.name] for one in keyframes if one.name in self._alone}
        series = self.store.series(keyframes)
        return KeyframeProblem(tuple(keyframes), series, given.rig, given.arm, config, alone, self._bases)

    @property
    def unsolved(self) -> list[KeyframeTask]:
        """The keyframes that no solution has estimated by themselves yet, first those that are solved next."""
        if all(name in self._alone for name in self.store.names):
            return []
        keyframes, given = self.store.spread(len(self.store), self._asked), self._given
        return [KeyframeTask(one, given.rig, given.config) for one in keyframes if one.name not in self._alone]

    def use(self, solution: Solution) -> bool:
        """Follow by a solution, if it has a calibration that predicts its frames; returns whether it has.

        One of keyframes of a base that was given up since is not used.
        """
        if solution.base != self._bases or solution.keyframes < self._solved.keyframes:
            return False
        known = self._alone | dict(solution.alone)
        self._alone = {name: known[name] for name in self.store.names if name in known}
        self._solved = solution
        if solution.calibration is None or solution.reason:
            return False
        if self.calibration is None and not self._is_useful(solution):
            return False
        self._own = True
        self._following = self._by(solution.calibration)
        return True

    def _is_useful(self, solution: Solution) -> bool:
        """Whether images are to be followed by a first solution, and not any longer from image to image.

        Not by one whose error is too large, nor by few keyframes that do not tell the lag: the arm may have been slow.
        """
        assert solution.calibration is not None
        _, std = lag_and_std(solution.calibration, self._given.config.track.lag_std)
        known = std <= _LAG_STD or solution.keyframes >= _OWN_IS_ENOUGH
        return known and solution.tip_mm <= self._given.config.trust.tip_mm * _BY_THE_BASE

    def _by(self, calibration: SessionCalibration) -> Follower:
        """Return what follows by a calibration."""
        lag = lag_of(calibration, self._given.config.track.lag_std)
        return Follower(self._given, calibration, lag, uncertain=self._is_of_few)

    def can_follow(self, time: float, readings: ReadingBuffer, seen: Seen) -> bool:
        """Whether an image of a time, s, can be followed by a calibration.

        There must be one, the outer joints must have been read at an image or be read now, and masks must be there, or
        colours by which they are found.
        """
        following = self._following
        if following is None or not self._given.segmenter.is_ready(seen):
            return False
        return following.has_readings or readings.at(time - following.late).has_outer

    def follow(self, time: float, readings: ReadingBuffer, seen: Seen) -> TrackResult:
        """Fit an image by the calibration; if too many in a row contradict it, it does not hold any more.

        Fewer are enough, soon after it was found, for one of few keyframes.
        """
        following = self._following
        assert following is not None
        result = following.follow(time, readings.at(time - following.late), seen, shows_well=self.store.shows_well)
        soon = self._is_of_few and following.seconds <= _SOON
        if following.contradicted or (soon and following.explains_little):
            self._give_up()
            return replace(result, status="doubtful" if result.status == "ok" else result.status)
        self.offer(time, readings.at(time), seen, following)
        if result.status == "ok" and self._own:
            result = doubted(result, reasons(too_few_keyframes(self._solved.tip_mm, self._solved.keyframes)))
        if result.status == "doubtful" and self._own:
            result = doubted(result, self._how_far(result.tip_std_mm, self._given.config.trust.tip_mm))
        return result

    @property
    def _is_of_few(self) -> bool:
        """Whether the calibration is that of few keyframes."""
        return self._own and self._solved.keyframes < _OWN_IS_ENOUGH

    def _how_far(self, std_mm: float | None, most: float) -> list[str]:
        """Say how far the base is known by the last solution, if tips are known to ``std_mm``, and not to ``most``."""
        return reasons(base_uncertain(self._solved.tip_mm, self._solved.keyframes, std_mm, most))

    def _give_up(self) -> None:
        """Follow by the calibration no longer: images contradict it.

        The base may have moved: the keyframes are forgotten. Those that are to be solved once more are not, since a
        solution of few may have been wrong itself, nor those of an endoscope whose readings say where it is.
        """
        few = self._is_of_few and len(self.store) > self._solved.keyframes
        self._following, self._solved, self._asked = None, Solution(None, "", 0, {}), frozenset()
        if not few and not self.store.steered:
            self._bases += 1
            self._alone.clear()
            self.store.clear()
        self._own = False

    def offer(self, time: float, reading: ReadingAt, seen: Seen, following: Follower | None) -> bool:
        """Keep an image as a keyframe, if it is worth that; returns whether it is.

        Where it has no masks, they are found about the pose to which it was followed, if that explains it. Where
        readings are too sparse for the motion, they do not tell what the image shows.
        """
        names = (*OUTER_JOINTS, *self._given.instrument.joint_names)
        if reading.still or (reading.sparse is not None and readings_too_sparse(reading.sparse) is not None):
            return False
        values = zip(names, [*reading.outer.tolist(), *reading.joints.tolist()], strict=True)
        readings = {name: value for name, value in values if not np.isnan(value)}
        if reading.ecm is not None:
            readings |= dict(zip(ECM_JOINTS, reading.ecm.tolist(), strict=True))
        rates = dict(zip(names, [*reading.outer_rate.tolist(), *reading.joint_rate.tolist()], strict=True))
        segmenter = self._given.segmenter
        masks = segmenter.given(seen)
        if not masks and following is not None and following.explained and self.store.is_new(time, readings):
            masks = following.masks_of(seen)
        return bool(masks) and self.store.offer(time, masks, segmenter.ignored(seen), readings, rates)

    def unconfirmed(self, result: TrackResult) -> TrackResult:
        """Return the result of an image that is not followed by a calibration, whether readings tell the base or not.

        It is not ok.
        """
        if result.status == "lost":
            return result
        tips = "" if result.tip_std_mm is None else f", tips to {result.tip_std_mm:.1f} mm if this one is right"
        far = self._how_far(np.inf, 0.0) if np.isfinite(self._solved.tip_mm) else []
        why = "".join(f" ({text})" for text in ([self._solved.reason] if self._solved.reason else far))
        known = self.calibration is not None
        return doubted(result, [NO_OUTER_READINGS if known else base_not_known(len(self.store), tips + why)])
