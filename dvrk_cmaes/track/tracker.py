"""Following one instrument through the images of one camera, or of a rig of several."""

from __future__ import annotations

import threading
import time as clock
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from dvrk_cmaes.calibration.document import CALIBRATION_EXPECTED, SessionCalibration, check_made_for
from dvrk_cmaes.calibration.prediction import FoundLag, lag_of
from dvrk_cmaes.camera import Camera, Rig
from dvrk_cmaes.config import EstimateConfig
from dvrk_cmaes.errors import InputError
from dvrk_cmaes.geometry import Float64
from dvrk_cmaes.instrument import Instrument
from dvrk_cmaes.instrument.arm import Arm, check_arm
from dvrk_cmaes.io.arguments import check_type, checked_number
from dvrk_cmaes.pose.config_check import check_config
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
from dvrk_cmaes.silhouette import Body, Renderer
from dvrk_cmaes.silhouette.prepare import prepare
from dvrk_cmaes.track.follower import Followed, Follower
from dvrk_cmaes.track.keyframe_problem import KeyframeProblem, Solution
from dvrk_cmaes.track.keyframes import RELIABLE, SOLVED_AT, Keyframes
from dvrk_cmaes.track.reading_buffer import ReadingBuffer
from dvrk_cmaes.track.unknown_base import UnknownBase
from dvrk_cmaes.track.view_segmenter import Images, Masks, Seen, ViewSegmenter

_GIVEN_LAG_STD = 1e-6  # s, of a lag that is given
_BY_THE_BASE = 1.3  # of the error of the tips that is ok: the most that a first solution may leave, before any image


class Tracker:
    """Follows one instrument by masks, images and joint readings.

    The mask of an image that has one is used. In other images masks are found by colours, which are learned wherever a
    pose explains an image.

    It keeps images with masks and readings that differ, at most 60 keyframes. `solve` finds base, lag and offsets from
    them, and after `use` every image is fitted with these, as by `dvrk-cmaes track`; until then no pose is ok. A
    ``calibration`` is used in the same way, until images contradict it. It reads no files, and does nothing between its
    steps. The same images, readings, solutions and settings give the same results. Calls of `add_readings`, `step`,
    `start` and `use` from several threads, such as callbacks of ROS, wait for each other.

    Parameters
    ----------
    camera
        The camera of all images; or a rig of several views, whose images of one time correct the pose together. Poses
        are in its first camera.
    instrument
        The instrument, as in `estimate`; prepare it once (`dvrk_cmaes.prepare`) for several trackers.
    calibration
        Calibration of the session: its base and offsets hold, and its lag is taken out of the readings.
    config
        All settings; those of following are ``track``.
    arm
        Kinematics of the arm, ``classic`` or ``si``; a calibration's own is used instead.
    lag
        Lag of the images behind the readings, s; if it is not given, it is that of the calibration, or found from the
        keyframes.
    background
        No step waits for the search of an image: it is done in a thread while the next steps go on, and what it finds
        is followed to the image that is present then. Until the first pose, steps say ``searching``. Otherwise the
        step of an image that is searched returns what that finds.

    Raises
    ------
    InputError
        An argument of another kind, which the message names, or settings outside their range.
    """

    def __init__(
        self,
        camera: Camera | Rig,
        instrument: Instrument | Body | str | Path,
        calibration: SessionCalibration | None = None,
        config: EstimateConfig | None = None,
        *,
        arm: Arm = "classic",
        lag: float | None = None,
        background: bool = False,
    ) -> None:
        settings = EstimateConfig() if config is None else config
        check_config(settings)
        check_arm(arm)
        if calibration is not None:
            check_type("calibration", calibration, SessionCalibration, CALIBRATION_EXPECTED)
        if lag is not None:
            lag = checked_number("lag", lag, "a number of seconds")
            settings = replace(settings, track=replace(settings.track, lag_std=_GIVEN_LAG_STD))
            calibration = None if calibration is None else replace(calibration, lag=None, lag_curve=None)
        self._body = prepare(instrument)
        if calibration is not None:
            check_made_for("calibration", calibration, self._body.instrument.name, None if arm == "classic" else arm)
        used_arm: Arm = arm if calibration is None else calibration.arm
        rig, track = Rig.of(camera), settings.track
        self._names = self._body.instrument.joint_names
        self._given_lag, self._remarks = lag, rig.remarks
        self._readings = ReadingBuffer(self._names, track.reading_gap, track.still_seconds)
        self._segmenter = ViewSegmenter(rig, self._body, track)
        self._given = Followed(rig, self._body, used_arm, settings, self._segmenter)
        self._keyframes = Keyframes(self._given, self._readings)
        self._unknown = UnknownBase(self._given, background)
        self._own = False  # whether the calibration is that of the keyframes
        self._following = None if calibration is None else self._by(calibration)
        self._renderer = Renderer(self._body, rig.views[0].camera)
        self._time: float | None = None
        self._turn = threading.RLock()

    def __repr__(self) -> str:
        """Show the instrument, the time of the last image, and whether it follows by a calibration."""
        base = "not known" if self._following is None else "known"
        return f"Tracker({self._body.instrument.name!r}, time={self._time}, base {base})"

    def __getstate__(self) -> dict[str, Any]:
        """Pickle all but the lock."""
        return {**self.__dict__, "_turn": None}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Restore a pickled tracker."""
        self.__dict__.update(state, _turn=threading.RLock())

    def _by(self, calibration: SessionCalibration) -> Follower:
        """Return what follows by a calibration."""
        lag = lag_of(calibration, self._given.config.track.lag_std)
        return Follower(self._given, calibration, lag, uncertain=self._is_of_few)

    @property
    def _is_of_few(self) -> bool:
        """Whether the calibration is that of few keyframes."""
        return self._own and self._keyframes.solved.keyframes < RELIABLE

    @property
    def lag(self) -> FoundLag | None:
        """Lag of the images behind the readings; None while it is not determined."""
        found, given = None if self._following is None else self._following.lag, self._given_lag
        if given is None:
            return found
        return FoundLag(given, 0.0) if found is None else FoundLag(given + found.seconds, found.std)

    @property
    def calibration(self) -> SessionCalibration | None:
        """The calibration by which images are followed; None while there is none."""
        return None if self._following is None else self._following.calibration

    @property
    def camera_from_base(self) -> Float64 | None:
        """Pose of the arm's base in the camera (4, 4), m; None without a calibration."""
        return None if self.calibration is None else self.calibration.camera_from_base

    @property
    def offsets(self) -> dict[str, float]:
        """Offsets of roll and of the joints, rad: true = reading + offset; empty without a calibration."""
        known = self.calibration
        return {} if known is None else {name: known.offsets[name] for name in ("roll", *self._names)}

    @property
    def searching(self) -> bool:
        """Whether the search of an image goes on in the background."""
        return self._unknown.searching

    def add_readings(self, time: float, joints: Mapping[str, float]) -> None:
        """Add the readings of one time, s: joints by name, rad (insertion: m), any of which may be missing.

        Parameters
        ----------
        time
            Time of the readings, s.
        joints
            Readings by joint, rad (insertion: m).

        Raises
        ------
        InputError
            A value is not finite or in another unit, or a joint is unknown.
        """
        late = checked_number("time", time, "a finite number of seconds") + (self._given_lag or 0.0)
        with self._turn:
            self._readings.add(late, joints)

    @property
    def base_state(self) -> str:
        """How far the arm's base is known, in words: by the error of the tips that it leaves."""
        solved, kept = self._keyframes.solved, len(self._keyframes)
        count = f"{kept} keyframe{'' if kept == 1 else 's'}"
        known = f"base +- {solved.tip_mm:.2g} mm" if np.isfinite(solved.tip_mm) else "base not known yet"
        if self._following is None:
            return f"calibrating: {count}, {known}"
        if not self._own:
            return f"calibration given: {count}"
        return f"{'calibrated' if solved.keyframes >= SOLVED_AT[-1] else 'calibrating'}: {count}, {known}"

    @property
    def solution_due(self) -> bool:
        """Whether solving the keyframes anew pays: at some numbers of them, and where images disagree.

        A calibration that was given is not replaced as long as it holds.
        """
        following = self._following
        if following is None:
            return self._keyframes.due(disagrees=False)
        return self._own and self._keyframes.due(disagrees=following.is_inconsistent)

    def problem(self) -> KeyframeProblem:
        """Return what the keyframes pose to be solved, which another process can do (`KeyframeProblem.solve`)."""
        with self._turn:
            return self._keyframes.problem()

    @property
    def unsolved_keyframes(self) -> list[KeyframeProblem]:
        """The keyframes that no solution has estimated by themselves yet; a solver may do that before one is due."""
        return self._keyframes.unsolved

    def solve(self) -> Solution:
        """Solve the keyframes together: base, lag, offsets. That takes seconds, and changes nothing until `use`."""
        return self.problem().solve(self._body)

    def use(self, solution: Solution) -> bool:
        """Follow by a solution from the next step on; returns whether it has a calibration that predicts its frames.

        Parameters
        ----------
        solution
            What `KeyframeProblem.solve` returned.
        """
        check_type("use", solution, Solution, "what Tracker.solve returns")
        with self._turn:
            calibration = self._keyframes.take(solution)
            most = self._given.config.trust.tip_mm * _BY_THE_BASE  # else from image to image
            if calibration is None or (self._following is None and solution.tip_mm > most):
                return False
            self._own = True
            self._following = self._by(calibration)
            return True

    def start(self, time: float, result: Result, image: Images | None = None) -> None:
        """Start, or start again, from the result of a single frame taken at a time, s.

        Colours are learned from its ``image`` (H, W, 3), BGR, or those of the views, if that is given.

        Parameters
        ----------
        time
            Time of the image, s; later than that of the step before.
        result
            The result of the frame.
        image
            (H, W, 3) uint8, BGR, or the images of the views by name.

        Raises
        ------
        InputError
            The result has no pose or no covariance, or is of an instrument with other joints.
        """
        check_type("start", result, Result, "a Result")
        if result.camera_from_root is None or result.covariance is None or tuple(result.joints) != self._names:
            raise InputError(
                f"start: expected a result with a pose, a covariance and the joints {', '.join(self._names)}, got "
                f"status {result.status} with {', '.join(result.joints) or 'no joints'}"
            )
        with self._turn:
            self._check_time(time)
            seen = None if image is None else self._segmenter.look(None, image, None)
            self._unknown.start(time, result, seen)
            self._time = time

    def step(
        self, time: float, mask: Masks | None = None, image: Images | None = None, ignore: Masks | None = None
    ) -> TrackResult:
        """Follow the instrument to the image of a later time.

        With a rig of several views, mask, image and ignore are given by name of the view or in the rig's order, None
        for a view that is missing.

        Parameters
        ----------
        time
            Of the image, s; later than that of the step before.
        mask
            (H, W) bool, True on the instrument; None if there is none for this image.
        image
            (H, W, 3) uint8, BGR; None if there is none. A grey one, (H, W), is only tested for being black.
        ignore
            (H, W) bool, pixels that count neither way.

        Raises
        ------
        InputError
            The time is not later than the last, an array has another size than the camera's images, or there is no such
            view.
        """
        started = clock.perf_counter()
        with self._turn:
            self._check_time(time)
            seen = self._segmenter.look(mask, image, ignore)
            result = self._known(time, seen) if self._can_follow(time, seen) else self._from_image_to_image(time, seen)
            self._time = time
            sparse = self._readings.at(time - (0.0 if self.lag is None else self.lag.seconds)).sparse
            kept, solved, used = len(self._keyframes), self._keyframes.solved, self._following is not None
        if sparse is not None:
            result = doubted(result, reasons(readings_too_sparse(sparse)))
        base = BaseKnown(kept, solved.keyframes, solved.tip_mm if np.isfinite(solved.tip_mm) else None, used)
        remarks, seconds = tuple(dict.fromkeys((*self._remarks, *result.remarks))), clock.perf_counter() - started
        return replace(result, seconds=seconds, base=base, remarks=remarks, renderer=self._renderer)

    def _can_follow(self, time: float, seen: Seen) -> bool:
        """Whether an image of a time, s, can be followed by a calibration.

        There must be one, the outer joints must have been read at an image or be read now, and masks must be there, or
        colours by which they are found.
        """
        following = self._following
        if following is None or not self._segmenter.is_ready(seen):
            return False
        return following.has_readings or self._readings.at(time - following.late).has_outer

    def _known(self, time: float, seen: Seen) -> TrackResult:
        """Follow to an image by the calibration; if too many in a row contradict it, it does not hold any more.

        Fewer are enough, soon after it was found, for one of few keyframes.
        """
        following, keyframes, most = self._following, self._keyframes, self._given.config.trust.tip_mm
        assert following is not None
        self._unknown.forget()
        reading = self._readings.at(time - following.late)
        result = following.follow(time, reading, seen, shows_well=keyframes.shows_well)
        if following.contradicted or (self._is_of_few and following.fails_early):
            keyframes.give_up(few=self._is_of_few)
            self._following, self._own = None, False
            return replace(result, status="doubtful" if result.status == "ok" else result.status)
        keyframes.offer(time, self._readings.at(time), seen, following)
        solved = keyframes.solved
        if result.status == "ok" and self._own:
            result = doubted(result, reasons(too_few_keyframes(solved.tip_mm, solved.keyframes)))
        if result.status == "doubtful" and self._own:
            uncertain = base_uncertain(solved.tip_mm, solved.keyframes, result.tip_std_mm, most)
            result = doubted(result, reasons(uncertain))
        return result

    def _from_image_to_image(self, time: float, seen: Seen) -> TrackResult:
        """Follow to an image without a calibration; no pose is ok, whether readings determine the base or not."""
        following, solved = self._following, self._keyframes.solved
        late = 0.0 if following is None else following.late
        result = self._unknown.step(time, self._readings.at(time - late), seen, self.calibration)
        self._keyframes.offer(time, self._readings.at(time), seen, self._unknown.following)
        if result.status == "lost":
            return result
        if following is not None:
            return doubted(result, [NO_OUTER_READINGS])
        tips = "" if result.tip_std_mm is None else f", tips to {result.tip_std_mm:.1f} mm if this one is right"
        far = base_uncertain(solved.tip_mm, solved.keyframes, np.inf, 0.0) if np.isfinite(solved.tip_mm) else None
        why = solved.reason or far
        return doubted(result, [base_not_known(len(self._keyframes), f"{tips} ({why})" if why else tips)])

    def _check_time(self, time: float) -> None:
        checked_number("time", time, "a finite number of seconds")
        if not np.isfinite(time) or (self._time is not None and time <= self._time):
            after = "" if self._time is None else f" later than {self._time:g} s"
            raise InputError(f"time: expected a finite number of seconds{after}, got {time}")
