"""Following one instrument through the images of one camera, or of a rig of several."""

from __future__ import annotations

import time as clock
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.calibration.document import CALIBRATION_EXPECTED, SessionCalibration, check_made_for
from dvrk_cmaes.calibration.session_doubts import resting_on
from dvrk_cmaes.camera import Camera, Rig
from dvrk_cmaes.config import EstimateConfig
from dvrk_cmaes.errors import InputError
from dvrk_cmaes.instrument import Instrument
from dvrk_cmaes.instrument.arm import Arm, check_arm
from dvrk_cmaes.io.arguments import check_type, checked_number
from dvrk_cmaes.joints.lag import Unit
from dvrk_cmaes.pose.config_check import check_config
from dvrk_cmaes.results.result import Result
from dvrk_cmaes.results.tracked import TrackResult
from dvrk_cmaes.segment.segmentation import Hints
from dvrk_cmaes.silhouette import Body, Renderer
from dvrk_cmaes.silhouette.prepare import body_by, prepare
from dvrk_cmaes.track.document import calibration_of
from dvrk_cmaes.track.following import Following
from dvrk_cmaes.track.hypothesis import Follower, Hypothesis
from dvrk_cmaes.track.keyframe_problem import KeyframeProblem, KeyframeTask, Solution
from dvrk_cmaes.track.known_base import KnownBase
from dvrk_cmaes.track.lag import FoundLag
from dvrk_cmaes.track.motion import MotionModel
from dvrk_cmaes.track.outline_model import OutlineModel
from dvrk_cmaes.track.reading_buffer import ReadingBuffer
from dvrk_cmaes.track.readings import LaggedReadings
from dvrk_cmaes.track.recovery import GlobalSearch
from dvrk_cmaes.track.sight import EvidenceKind, Images, Masks, Seen, Sight
from dvrk_cmaes.track.sliced_following import SlicedFollowing
from dvrk_cmaes.track.smoother import Recorder

Float64 = NDArray[np.float64]

_LONGEST_GAP = 1.0  # s, over which what was followed is gone on with after a calibration that did not hold


class Tracker:
    """Follows one instrument by masks, images and joint readings.

    It reads no files, does nothing between its steps, and forgets the past. The same images, readings and settings give
    the same results.

    Parameters
    ----------
    camera
        The camera of all images; or a rig of several views, whose images of one time correct the pose together. Poses
        are in its first camera.
    instrument
        The instrument, as in `estimate`; prepare it once (`dvrk_cmaes.prepare`) for several trackers.
    calibration
        Calibration of the session: its base holds, its offsets are the start, and its lag is used.
    config
        All settings; those of following are ``track``.
    arm
        Kinematics of the arm, ``classic`` or ``si``; a calibration's own is used instead.
    lag
        Lag of the images behind the readings, s; if it is not given, it is that of the calibration, or it is found
        while following.
    evidence
        What of an image is used: ``masks``, ``images`` or ``both``, weighed by how far the edges of each have lain from
        the predictions so far; if it is not given, the mask of an image that has one, else its colours, which are
        learned wherever a pose is trusted.
    hints
        Where the instrument is in the first image, of the first view, if that has no mask.
    record
        Keep what `smoothed` needs of every image; memory then grows with the recording.
    keyframes
        Keep images with masks and readings that differ, at most 60. `solve` finds base, lag and offsets from them, and
        after `use` every image is fitted with these, as by `dvrk-cmaes track`; until then no pose is ok. A
        ``calibration`` is used in the same way.
    earlier
        The calibration is of an earlier run, since which the camera may have been moved: with ``keyframes``, no pose by
        it is ok before five images that differ agree with it, and it is given up if images contradict it.
    sliced
        No step waits for the search of an image: it goes on in the steps after it, a slice in each, and what it finds
        is followed to the image that is present then. Until the first pose, steps say ``searching``, or ``segmenting``
        while a mask is found in an image. The search is done in a thread, but only while a step waits for it.

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
        evidence: EvidenceKind | None = None,
        hints: Hints | None = None,
        record: bool = False,
        keyframes: bool = False,
        earlier: bool = False,
        sliced: bool = False,
    ) -> None:
        options: dict[str, Any] = {"arm": arm, "lag": lag, "evidence": evidence, "hints": hints, "record": record}
        options |= {"keyframes": keyframes, "earlier": earlier, "sliced": sliced}
        settings = EstimateConfig() if config is None else config
        check_config(settings)
        check_arm(arm)
        if calibration is not None:
            check_type("calibration", calibration, SessionCalibration, CALIBRATION_EXPECTED)
        if lag is not None:
            lag = checked_number("lag", lag, "a number of seconds")
        body = body_by(prepare(instrument), settings.silhouette.method)
        if calibration is not None:
            check_made_for("calibration", calibration, body.instrument.name, None if arm == "classic" else arm)
        self._config = settings
        rig = Rig.of(camera)
        self._inputs = (rig, body.instrument, calibration, settings), options
        self._names = body.instrument.joint_names
        self._arm: Arm = arm if calibration is None else calibration.arm
        track = settings.track
        self._readings = LaggedReadings(body.instrument, self._arm, track, calibration, lag)
        roll_offset, cables = body.instrument.roll_offset, self._readings.cables
        motion = MotionModel(track, len(self._names), self._arm, roll_offset, cables)
        follower = Follower(track, motion, OutlineModel(body, rig, track.points))
        self._sight = Sight(rig, track, evidence, hints)
        searched = replace(settings, threads=1) if sliced else settings
        solve = GlobalSearch(follower, self._sight, body, searched, calibration)
        self._following = Following(follower, rig, self._sight, solve, self._readings, settings, calibration)
        self._sliced = SlicedFollowing(self._following) if sliced else None
        known = KnownBase(rig, body, self._arm, settings, calibration, earlier=earlier) if keyframes else None
        self._known = known
        self._remarks, self._given = rig.remarks, calibration
        self._renderer = Renderer(body, rig.views[0].camera)
        self._time: float | None = None
        self._by_filter: float | None = None  # s, the last image that was followed without a calibration
        self._recorder = Recorder() if record else None

    def __reduce__(self) -> tuple[Any, ...]:
        """Copy and pickle by the arguments, the readings and the state, as of `checkpoint`."""
        return _again, (type(self), *self._inputs, self._readings.buffer, self._recorder, self.checkpoint())

    @property
    def lag(self) -> FoundLag | None:
        """Lag of the images behind the readings; None while it is not determined."""
        if self._known is not None and self._known.calibration is not None:
            return self._known.lag
        return self._readings.known_lag

    @property
    def camera_from_base(self) -> Float64 | None:
        """Pose of the arm's base in the camera (4, 4), m; None without readings of the outer joints."""
        if self._known is not None and self._known.calibration is not None:
            return self._known.calibration.camera_from_base
        best = self._best
        return None if best is None or not best.anchor.outer_read else best.state.camera_from_base

    @property
    def offsets(self) -> dict[str, float]:
        """Offsets of roll and of the joints, rad: true = reading + offset; empty before the first pose."""
        if self._known is not None and self._known.calibration is not None:
            return {name: self._known.calibration.offsets[name] for name in ("roll", *self._names)}
        best = self._best
        return {} if best is None else dict(zip(("roll", *self._names), best.state.offsets.tolist(), strict=True))

    def calibration(self, interval: float, unit: Unit = "s") -> SessionCalibration | None:
        """Return what was found as a session's calibration; None without readings of the outer joints.

        ``interval`` s is the time between images. If ``unit`` is frames, the lag is only given in frames.

        Parameters
        ----------
        interval
            Time between images, s.
        unit
            ``s`` or ``frames``: in which the lag is given.
        """
        if self._known is not None and self._known.calibration is not None:
            return self._known.calibration
        best = self._best
        if best is None or not best.anchor.outer_read:
            return None
        instrument = self._following.follower.instrument
        lag = self.lag
        found = calibration_of(best.state, lag, instrument, self._arm, self._config, interval=interval, unit=unit)
        given = self._session
        return replace(found, doubts=() if given is None else given.doubts, remarks=self._remarks)

    @property
    def _session(self) -> SessionCalibration | None:
        """The calibration that poses rest on; None where they rest on the images alone."""
        return self._given if self._known is None else self._known.calibration

    @property
    def searching(self) -> bool:
        """Whether the search of an image goes on in the next steps."""
        return self._sliced is not None and self._sliced.searching

    @property
    def _best(self) -> Hypothesis | None:
        """The mode that is believed; None before the first pose."""
        return self._following.best if self._sliced is None else self._sliced.best

    def checkpoint(self) -> dict[str, Any]:
        """Return the state as plain values; readings are not in it, and must be added again before `restore`.

        Nor is a search that is going on (`searching`): after `restore`, it is not gone on with, and a first image is
        searched anew.
        """
        return {
            "time": self._time,
            "by_filter": self._by_filter if self._sliced is None else self._sliced.followed_until(self._by_filter),
            **(self._following.state if self._sliced is None else self._sliced).checkpoint(),
            **self._readings.checkpoint(),
            "sight": self._sight.checkpoint(),
            "known": None if self._known is None else self._known.checkpoint(),
        }

    def restore(self, saved: Mapping[str, Any]) -> None:
        """Go on from the state of another tracker with the same camera, instrument and settings.

        Parameters
        ----------
        saved
            What `checkpoint` returned.

        Raises
        ------
        InputError
            The values are not those of `checkpoint`.
        """
        try:
            self._time = None if saved["time"] is None else float(saved["time"])
            self._by_filter = None if saved["by_filter"] is None else float(saved["by_filter"])
            (self._following if self._sliced is None else self._sliced).restore(saved)
            self._readings.restore(saved)
            self._sight.restore(saved["sight"])
            if self._known is not None:
                self._known.restore(saved["known"])
        except (KeyError, TypeError, ValueError, AttributeError, IndexError):
            raise InputError("checkpoint: expected the state of a tracker, got something else") from None

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
        self._readings.buffer.add(time, joints)
        if self._known is not None:
            self._known.store.add_readings(time, joints)

    @property
    def base_state(self) -> str:
        """How far the arm's base is known, in words; empty for a tracker that keeps no keyframes."""
        return "" if self._known is None else self._known.state

    @property
    def solution_due(self) -> bool:
        """Whether solving the keyframes anew pays: at some numbers of them, and where images disagree."""
        return self._known is not None and self._known.due

    def problem(self) -> KeyframeProblem:
        """Return what the keyframes pose to be solved, which another process can do (`KeyframeProblem.solve`).

        Raises
        ------
        InputError
            The tracker keeps no keyframes.
        """
        if self._known is None:
            raise InputError("problem: expected a tracker that keeps keyframes, got one without keyframes=True")
        return self._known.problem()

    @property
    def unsolved_keyframes(self) -> list[KeyframeTask]:
        """The keyframes that no solution has estimated by themselves yet; a solver may do that before one is due."""
        return [] if self._known is None else self._known.unsolved

    def solve(self) -> Solution:
        """Solve the keyframes together: base, lag, offsets. That takes seconds, and changes nothing until `use`.

        Raises
        ------
        InputError
            The tracker keeps no keyframes.
        """
        return self.problem().solve(self._following.solve.body)

    def use(self, solution: Solution) -> bool:
        """Follow by a solution from the next step on; returns whether it has a calibration that predicts its frames.

        Parameters
        ----------
        solution
            What `KeyframeProblem.solve` returned.

        Raises
        ------
        InputError
            The tracker keeps no keyframes.
        """
        check_type("use", solution, Solution, "what Tracker.solve returns")
        if self._known is None:
            raise InputError("use: expected a tracker that keeps keyframes, got one without keyframes=True")
        return self._known.use(solution)

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
        self._check_time(time)
        seen = None if image is None else self._sight.look(None, image, None)
        following = self._following
        if self._sliced is not None:
            self._sliced.forget()
        following.begin(result, following.starts(following.anchor(time), result))
        self._time = self._by_filter = time
        if seen is not None:
            following.learn(seen)

    def step(
        self,
        time: float,
        mask: Masks | None = None,
        image: Images | None = None,
        ignore: Masks | None = None,
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
        self._check_time(time)
        seen = self._sight.look(mask, image, ignore)
        result = self._with_sparse_readings(self._followed(time, seen))
        self._time = time
        base = None if self._known is None else self._known.known
        if self._known is not None:
            self._known.note(result)
        result = replace(result, seconds=clock.perf_counter() - started, base=base, remarks=self._remarks)
        result = replace(result, renderer=self._renderer)
        result = resting_on(result, self._session)
        if self._recorder is not None:
            late = self._sliced is not None and self._sliced.late
            self._recorder.add(self._following.last_step, None if late else self._best, result)
        return result

    def _followed(self, time: float, seen: Seen) -> TrackResult:
        """Follow to an image by the calibration, if there is one, and otherwise from the image before."""
        known, following = self._known, self._following
        if known is not None and known.can_follow(time, self._readings.buffer):
            lately = self._by_filter is not None and time - self._by_filter <= _LONGEST_GAP
            alone = lately and self._best is not None
            result = known.follow(time, self._readings.buffer, seen, self._sight, alone=alone)
            if known.calibration is None:  # contradicted
                following.forget_calibration()
                if not alone:
                    (following if self._sliced is None else self._sliced).forget()
            return result
        if self._sliced is not None:
            result = self._sliced.step(time, self._by_filter, seen)
        elif following.best is None or self._by_filter is None:
            result = following.first(time, seen)
        else:
            result = following.follow(time, time - self._by_filter, seen)
        self._by_filter = time
        if known is None:
            return result
        known.offer(time, self._readings.buffer.at(time), seen, self._sight)
        return known.unconfirmed(result, self._readings.buffer)

    def _with_sparse_readings(self, result: TrackResult) -> TrackResult:
        """Return a result as doubtful if readings near its image are too sparse for the motion, with that reason."""
        sparse = self._readings.buffer.at(result.time - (0.0 if self.lag is None else self.lag.seconds)).sparse
        if sparse is None or not sparse.reason:
            return result
        status = "doubtful" if result.status == "ok" else result.status
        return replace(result, status=status, reasons=(*result.reasons, sparse.reason))

    def smoothed(self) -> list[TrackResult]:
        """Return the results of all images given all images; status and reasons stay as they were.

        Raises
        ------
        InputError
            The tracker does not record.
        """
        if self._recorder is None:
            raise InputError("smoothed: expected a tracker that records, got one without record=True")
        return self._recorder.smoothed(self._following.follower)

    def _check_time(self, time: float) -> None:
        checked_number("time", time, "a finite number of seconds")
        if not np.isfinite(time) or (self._time is not None and time <= self._time):
            after = "" if self._time is None else f" later than {self._time:g} s"
            raise InputError(f"time: expected a finite number of seconds{after}, got {time}")


def _again(
    kind: type[Tracker],
    arguments: tuple[Any, ...],
    options: dict[str, Any],
    readings: ReadingBuffer,
    recorder: Recorder | None,
    saved: dict[str, Any],
) -> Tracker:
    """Make a tracker that was pickled."""
    tracker = kind(*arguments, **options)
    tracker._readings.buffer, tracker._recorder = readings, recorder
    tracker.restore(saved)
    return tracker
