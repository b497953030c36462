"""Following one instrument through the images of one camera, or of a rig of several."""

from __future__ import annotations

import time as clock
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.calibration.document import SessionCalibration
from dvrk_cmaes.camera import Camera, Rig
from dvrk_cmaes.config import EstimateConfig
from dvrk_cmaes.errors import InputError
from dvrk_cmaes.instrument.arm import Arm, base_from_root
from dvrk_cmaes.joints.lag import Unit
from dvrk_cmaes.pose.config_check import check_config
from dvrk_cmaes.results.result import Result
from dvrk_cmaes.results.tracked import TrackResult, TrackStatus
from dvrk_cmaes.segment.segmentation import Hints
from dvrk_cmaes.silhouette import Body
from dvrk_cmaes.silhouette.prepare import body_by
from dvrk_cmaes.track.cables import CableMemory
from dvrk_cmaes.track.checkpoint import plain_hypothesis, read_hypothesis
from dvrk_cmaes.track.confirmation import CHANGED, UNCONFIRMED, Confirmation
from dvrk_cmaes.track.describe import described, without_pose
from dvrk_cmaes.track.document import calibration_of
from dvrk_cmaes.track.hypothesis import Follower, Hypothesis, Located
from dvrk_cmaes.track.judge import doubts_of_fit, doubts_of_pose, is_supported
from dvrk_cmaes.track.lag import LAGS, FoundLag, LagSearch
from dvrk_cmaes.track.modes import decide
from dvrk_cmaes.track.motion import Anchor, MotionModel
from dvrk_cmaes.track.reading_buffer import ReadingBuffer
from dvrk_cmaes.track.recovery import GlobalSearch, explains, has_jumped, is_certain, same_base, search_around
from dvrk_cmaes.track.rig_outline import RigEvidence, RigOutlines
from dvrk_cmaes.track.rig_sight import Images, Masks, RigSeen, RigSight
from dvrk_cmaes.track.searching import WORSE, Searching, is_better
from dvrk_cmaes.track.sight import EvidenceKind
from dvrk_cmaes.track.smoother import FilterStep, Recorder
from dvrk_cmaes.track.start import based_on_arm, rebased, starting_hypotheses
from dvrk_cmaes.track.update import Fit

Float64 = NDArray[np.float64]


class Tracker:
    """Follows one instrument by masks, images and joint readings.

    It reads no files, starts no threads, and forgets the past. The same images, readings and settings give the same
    results.

    Parameters
    ----------
    camera
        The camera of all images; or a rig of several views, whose images of one time correct the pose together. Poses
        are in its first camera.
    body
        The instrument, prepared for rendering (`dvrk_cmaes.prepare`).
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
        What of an image is used: ``masks``, ``images`` or ``both``; if it is not given, the mask of an image that has
        one, else its colours, which are learned wherever a pose is trusted.
    hints
        Where the instrument is in the first image, of the first view, if that has no mask.
    record
        Keep what `smoothed` needs of every image; memory then grows with the recording.
    """

    def __init__(
        self,
        camera: Camera | Rig,
        body: Body,
        calibration: SessionCalibration | None = None,
        config: EstimateConfig | None = None,
        *,
        arm: Arm = "classic",
        lag: float | None = None,
        evidence: EvidenceKind | None = None,
        hints: Hints | None = None,
        record: bool = False,
    ) -> None:
        settings = EstimateConfig() if config is None else config
        check_config(settings)
        body = body_by(body, settings.silhouette.method)
        self._config = settings
        self._rig = rig = Rig.of(camera)
        self._calibration = calibration
        self._names = body.instrument.joint_names
        self._arm: Arm = arm if calibration is None else calibration.arm
        used = self._arm
        track = settings.track
        roll_offset = body.instrument.roll_offset
        self._cables = CableMemory.of(calibration)
        model = None if self._cables is None else self._cables.model
        motion = MotionModel(track, len(self._names), used, roll_offset, model)
        self._follower = Follower(track, motion, RigOutlines(body, rig, track.points))
        self._buffer = ReadingBuffer(self._names, track.reading_gap, track.still_seconds)
        self._lags = LagSearch(lambda outer: base_from_root(outer, used, roll_offset=roll_offset))
        if lag is None and calibration is not None and calibration.lag is not None:
            lag = calibration.lag.seconds
        self._lag_given = lag is not None
        self._lag = FoundLag(0.0, track.lag_std) if lag is None else FoundLag(float(lag), 0.0)
        self._time: float | None = None
        self._hypotheses: list[Hypothesis] = []
        self._search = Searching()
        self._confirmation = Confirmation()
        self._sight = RigSight(rig, track, evidence, hints)
        self._solve = GlobalSearch(self._follower, self._sight, body, settings, calibration)
        self._recorder = Recorder() if record else None
        self._step: FilterStep | None = None

    @property
    def lag(self) -> FoundLag | None:
        """Lag of the images behind the readings; None while it is not determined."""
        return self._lag if self._lag_given or self._lag.std < self._config.track.lag_std else None

    @property
    def camera_from_base(self) -> Float64 | None:
        """Pose of the arm's base in the camera (4, 4), m; None without readings of the outer joints."""
        best = self._hypotheses[0] if self._hypotheses else None
        return None if best is None or not best.anchor.outer_read else best.state.camera_from_base

    @property
    def offsets(self) -> dict[str, float]:
        """Offsets of roll and of the joints, rad: true = reading + offset; empty before the first pose."""
        if not self._hypotheses:
            return {}
        values = self._hypotheses[0].state.offsets.tolist()
        return dict(zip(("roll", *self._names), values, strict=True))

    def calibration(self, interval: float, unit: Unit = "s") -> SessionCalibration | None:
        """Return what was found as a session's calibration; None without readings of the outer joints.

        ``interval`` s is the time between images. If ``unit`` is frames, the lag is only given in frames.
        """
        best = self._hypotheses[0] if self._hypotheses else None
        if best is None or not best.anchor.outer_read:
            return None
        instrument = self._follower.instrument
        lag = self.lag
        return calibration_of(best.state, lag, instrument, self._arm, self._config, interval=interval, unit=unit)

    def checkpoint(self) -> dict[str, Any]:
        """Return the state as plain values; readings are not in it, and must be added again before `restore`."""
        return {
            "time": self._time,
            "hypotheses": [plain_hypothesis(one) for one in self._hypotheses],
            "lag": [self._lag.seconds, self._lag.std],
            "lags": self._lags.checkpoint(),
            "search": [self._search.unsupported, self._search.wait, self._search.usual, self._search.astray],
            "confirmation": [self._confirmation.credit, self._confirmation.left, self._confirmation.wait],
            "sight": self._sight.checkpoint(),
            "cables": None if self._cables is None else self._cables.checkpoint(),
        }

    def restore(self, saved: Mapping[str, Any]) -> None:
        """Go on from the state of another tracker with the same camera, instrument and settings.

        Raises
        ------
        InputError
            The values are not those of `checkpoint`.
        """
        try:
            self._time = None if saved["time"] is None else float(saved["time"])
            self._hypotheses = [read_hypothesis(one, self._follower.model) for one in saved["hypotheses"]]
            self._lag = FoundLag(*(float(value) for value in saved["lag"]))
            self._lags.restore(saved["lags"])
            unsupported, wait, usual, astray = saved["search"]
            usual = None if usual is None else float(usual)
            self._search = Searching(float(unsupported), float(wait), usual, int(astray))
            credit, left, wait = saved["confirmation"]
            self._confirmation = Confirmation(float(credit), int(left), int(wait))
            if self._cables is not None:
                self._cables.restore(saved["cables"])
            self._sight.restore(saved["sight"])
        except (KeyError, TypeError, ValueError, AttributeError, IndexError):
            raise InputError("checkpoint: expected the state of a tracker, got something else") from None

    def add_readings(self, time: float, joints: Mapping[str, float]) -> None:
        """Add the readings of one time, s: joints by name, rad (insertion: m), any of which may be missing.

        Raises
        ------
        InputError
            A value is not finite or in another unit, or a joint is unknown.
        """
        self._buffer.add(time, joints)

    def start(self, time: float, result: Result, image: Images | None = None) -> None:
        """Start, or start again, from the result of a single frame taken at a time, s.

        Colours are learned from its ``image`` (H, W, 3), BGR, or those of the views, if that is given.

        Raises
        ------
        InputError
            The result has no pose or no covariance, or is of an instrument with other joints.
        """
        if result.camera_from_root is None or result.covariance is None or tuple(result.joints) != self._names:
            raise InputError(
                f"start: expected a result with a pose, a covariance and the joints {', '.join(self._names)}, got "
                f"status {result.status} with {', '.join(result.joints) or 'no joints'}"
            )
        self._check_time(time)
        seen = None if image is None else self._sight.look(None, image, None)
        self._begin(time, result, self._starts(time, result))
        if seen is not None:
            self._learn(seen)

    def step(
        self,
        time: float,
        mask: Masks | None = None,
        image: Images | None = None,
        ignore: Masks | None = None,
    ) -> TrackResult:
        """Follow the instrument to the image of a later time.

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

        With a rig of several views, each of them is given by name of the view or in the rig's order, None for a view
        that is missing.

        Raises
        ------
        InputError
            The time is not later than the last, an array has another size than the camera's images, or there is no such
            view.
        """
        started = clock.perf_counter()
        self._check_time(time)
        seen = self._sight.look(mask, image, ignore)
        result = self._follow(time, seen) if self._hypotheses else self._first(time, seen)
        self._time = time
        result = replace(result, seconds=clock.perf_counter() - started)
        if self._recorder is not None:
            self._recorder.add(self._step, self._hypotheses[0] if self._hypotheses else None, result)
        return result

    def smoothed(self) -> list[TrackResult]:
        """Return the results of all images given all images; status and reasons stay as they were.

        Raises
        ------
        InputError
            The tracker does not record.
        """
        if self._recorder is None:
            raise InputError("smoothed: expected a tracker that records, got one without record=True")
        return self._recorder.smoothed(self._follower)

    def _check_time(self, time: float) -> None:
        if not np.isfinite(time) or (self._time is not None and time <= self._time):
            after = "" if self._time is None else f" later than {self._time:g} s"
            raise InputError(f"time: expected a finite number of seconds{after}, got {time}")

    def _anchor(self, time: float) -> Anchor:
        """Return the readings at the time of an image less the lag, based on those before."""
        before = self._hypotheses[0].anchor if self._hypotheses else Anchor.none(len(self._names))
        reading = self._buffer.at(time - self._lag.seconds)
        expected = None if self._cables is None else self._cables.expected(reading)
        return before.then(reading, moving=not reading.still, expected=expected)

    def _first(self, time: float, seen: RigSeen) -> TrackResult:
        """Solve the first image by itself."""
        if seen.problem is not None:
            return without_pose(time, seen.problem)
        result = self._solve(seen, self._anchor(time), first=True)
        if result is None or result.camera_from_root is None:
            return without_pose(time, "not found: the first image could not be solved", searched=True)
        self._begin(time, result, self._starts(time, result))
        self._expect(seen)
        self._learn(seen)
        status: TrackStatus = "ok" if result.status == "ok" else "doubtful"
        return replace(self._result(time, status, result.reasons), searched=True)

    def _learn(self, seen: RigSeen, *, anew: bool = False) -> None:
        """Learn the colours of the images along the outlines of the best hypothesis; ``anew`` forgets those before."""
        views = tuple(view for view, one in seen.clear.items() if one.image is not None)
        if views:
            self._sight.learn(seen, self._follower.outlines(self._hypotheses[0], views), anew=anew)

    def _starts(self, time: float, result: Result) -> list[Hypothesis]:
        """Return the modes of a single frame's result as hypotheses."""
        anchor, std = self._anchor(time), self._lag.std
        return starting_hypotheses(self._follower, self._config, self._calibration, anchor, std, result)

    def _begin(self, time: float, result: Result, starts: list[Hypothesis], *, changed: bool = False) -> None:
        """Start all modes of a single frame's result, ``starts``; ``changed`` as in `Confirmation.start`."""
        self._hypotheses = starts
        self._search = Searching()
        self._confirmation.start(result, changed=changed)
        self._lags.clear()
        self._step = None
        self._time = time

    def _expect(self, seen: RigSeen) -> None:
        """Take the agreement of a mask with the pose that was found in it for the usual one."""
        evidence = self._sight.evidence(seen) if seen.source == "mask" else None
        found = None if evidence is None else self._follower.corrected(self._hypotheses[0], evidence)
        if found is not None:
            self._search.settle(found[1])

    def _follow(self, time: float, seen: RigSeen) -> TrackResult:
        """Predict all hypotheses and correct them by the image."""
        assert self._time is not None
        anchor = self._anchor(time)
        before = [based_on_arm(self._follower, self._config, one, anchor, self._lag.std) for one in self._hypotheses]
        elapsed = time - self._time
        predictions = [self._follower.predicted(one, anchor, elapsed, self._lag.std) for one in before]
        self._hypotheses = [one for one, _ in predictions]
        first, transition = predictions[0]
        self._step = FilterStep(first.state, transition, first.state, anchor)
        if seen.problem is not None and seen.main.mask is not None:
            return self._unsupported(time, seen.problem)
        if seen.any_same and self._follower.has_moved(before[0], self._hypotheses[0]):
            seen = seen.without_frozen()
        if seen.problem is not None:
            return self._unseen(time, seen.problem)
        evidence = self._sight.evidence(seen)
        if evidence is None:
            return self._unsupported(time, "lost: no instrument was found in the image")
        fits = [self._follower.corrected(one, evidence) for one in self._hypotheses]
        main, track = fits[0], self._config.track
        away = False
        if self._search.is_weak(main and main[1], seen.source, track):
            around = search_around(self._follower, before[0], self._hypotheses[0], main and main[0], evidence)
            certain = around is not None and is_certain(around[1], seen.source)
            if around is not None and certain and (main is None or is_better(around[1], main[1])):
                main, away = around, anchor.moves_from(before[0].anchor)
                self._step = None
                if has_jumped(self._follower, before[0], around[0]):
                    self._confirmation.doubt()
        if self._search.is_led_astray(away=away) and main is not None:
            main = rebased(self._follower, self._config, main[0], anchor, self._lag.std), main[1]
        fits[0] = main
        fit = None if main is None else main[1]
        supported, searched = fit is not None and is_supported(fit, track), False
        if self._search.is_weak(fit, seen.source, track):
            in_view = main is not None or self._follower.outlines(self._hypotheses[0], tuple(seen.clear))
            gone = seen.source == "image" and not in_view
            searched = self._search.missed(fit, seen.source, track, out_of_view=gone)
            found = self._searched(time, anchor, seen, evidence, fit if supported else None) if searched else None
            if found is not None:
                return found
        if supported:
            result = self._supported(time, seen, [one for one in fits if one is not None], away=away)
            if self._confirmation.needed and result.status == "ok":
                result = self._confirmed(time, anchor, seen, result)
        else:
            result = self._unsupported(time, f"lost: the {seen.source}'s edges do not support the predicted outline")
        return replace(result, searched=searched or result.searched)

    def _confirmed(self, time: float, anchor: Anchor, seen: RigSeen, result: TrackResult) -> TrackResult:
        """Return an ok result as doubtful until images solved by themselves confirm the pose; go on from their pose."""
        doubtful = replace(result, status="doubtful", reasons=(UNCONFIRMED,))
        if not self._confirmation.due():
            return doubtful
        solved = self._solve(seen, anchor)
        if solved is not None:
            agrees = self._confirmation.add(self._follower, self._hypotheses[0], solved)
            if not agrees and solved.status == "ok":
                self._begin(time, solved, self._starts(time, solved), changed=True)
                self._expect(seen)
                self._learn(seen, anew=True)
                doubtful = self._result(time, "doubtful", (CHANGED,))
        return replace(doubtful if self._confirmation.needed else result, searched=True)

    def _supported(self, time: float, seen: RigSeen, fits: list[tuple[Hypothesis, Fit]], *, away: bool) -> TrackResult:
        """Keep the corrected hypotheses, decide between them, and judge the best one.

        ``away`` tells that its pose was found away from where the readings say.
        """
        track, decision = self._config.track, decide(fits)
        self._hypotheses, fit = decision.kept, decision.fit
        reasons = [*decision.reasons, *doubts_of_fit(fit, track, seen.source, self._rig.names)]
        if away:
            reasons.append("readings against outline: the pose was found away from where they say")
        if decision.switched:
            self._step = None
            self._lags.clear()
        located = self._follower.located(self._hypotheses[0])
        if not self._search.is_weak(fit, seen.source, track):
            self._find_lag(time, located)
            if not reasons:
                self._learn(seen)
            if self._search.unsupported >= 1:
                reasons.append("found again: one image supports the pose so far")
            self._search.found(fit)
        elif not reasons:
            reasons.append(WORSE)
        result = self._result(time, "doubtful" if reasons else "ok", tuple(reasons), located)
        return replace(result, residual_px=fit.sigma)

    def _unsupported(self, time: float, reason: str) -> TrackResult:
        """Return the prediction of an image that does not support it."""
        return self._result(time, "lost", (reason,))

    def _unseen(self, time: float, reason: str) -> TrackResult:
        """Return the prediction of an image in which nothing can be seen; doubtful as long as it is certain."""
        found = self._result(time, "doubtful", (reason,))
        certain = found.tip_std_mm is None or found.tip_std_mm <= self._config.track.largest_tip_mm
        return found if certain else replace(found, status="lost")

    def _searched(
        self, time: float, anchor: Anchor, seen: RigSeen, evidence: RigEvidence, fit: Fit | None
    ) -> TrackResult | None:
        """Search an image globally, and go on from what is found; None if that does not explain the image.

        What is found must be clearly better supported than the followed pose, whose ``fit`` is given if the image
        supports it at all.
        """
        result = self._solve(seen, anchor)
        reason = "found again by a global search"
        if result is None or not explains(result, self._config.trust):
            return None
        found = same_base(self._follower, self._hypotheses[0], result, evidence)
        starts = [] if found is not None else self._starts(time, result)
        if fit is not None:
            other = self._follower.corrected(starts[0], evidence) if found is None else found
            if other is None or not is_better(other[1], fit) or not self._is_known(result):
                self._search.settle(fit)
                return None
        if found is not None:
            self._hypotheses = [found[0]]
            self._step = None
        else:
            self._begin(time, result, starts)
            self._expect(seen)
            self._learn(seen, anew=True)
            reason += ", away from where the readings say: readings jumped, or the base moved"
        return replace(self._result(time, "doubtful", (reason,)), searched=True)

    def _is_known(self, result: Result) -> bool:
        """Whether a single frame tells where the tips are nearly as well as the followed pose does."""
        now = self._follower.located(self._hypotheses[0]).tip_std * 1e3
        least = max(now, self._config.track.largest_tip_mm)
        return result.expected_error is not None and result.expected_error.of_tips_mm <= least

    def _find_lag(self, time: float, located: Located) -> None:
        """Add the best pose, which is ``located``, to those from which the lag is found."""
        if self._lag_given or not self._hypotheses[0].anchor.outer_read or len(self._hypotheses) > 1:
            return
        readings = self._buffer.outer_at(time - LAGS)
        self._lags.add(located.camera_from_root, located.covariance, readings)
        if self._lags.due:
            found = self._lags.search(self._hypotheses[0].state.camera_from_base)
            if found is not None:
                self._lag = found

    def _result(
        self, time: float, status: TrackStatus, reasons: tuple[str, ...], located: Located | None = None
    ) -> TrackResult:
        """Describe the best hypothesis, which is ``located`` if that is given."""
        best = self._hypotheses[0]
        located = self._follower.located(best) if located is None else located
        doubts = tuple(doubts_of_pose(located, self._rig, self._config.track))
        if status == "ok" and doubts:
            status = "doubtful"
        found = TrackResult(time, status, (*reasons, *doubts) if status != "ok" else (), None, {}, None, None, None)
        return described(self._follower, best, found, located)
