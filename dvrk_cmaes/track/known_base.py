"""A tracker's keyframes, and following by the calibration that they give."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from dvrk_cmaes.calibration.document import SessionCalibration
from dvrk_cmaes.camera import Rig
from dvrk_cmaes.config import EstimateConfig
from dvrk_cmaes.instrument.arm import OUTER_JOINTS, Arm
from dvrk_cmaes.results.result import Result
from dvrk_cmaes.results.tracked import TrackResult
from dvrk_cmaes.silhouette import Body
from dvrk_cmaes.track.calibrated_following import CalibratedFollowing
from dvrk_cmaes.track.keyframe_store import SOLVED_AT, KeyframeProblem, KeyframeStore, Solution
from dvrk_cmaes.track.lag import FoundLag
from dvrk_cmaes.track.reading_buffer import ReadingAt, ReadingBuffer
from dvrk_cmaes.track.sight import Seen, Sight


class KnownBase:
    """Keeps keyframes, and follows by the calibration that was found from them or given; arguments as of `Tracker`."""

    def __init__(
        self, rig: Rig, body: Body, arm: Arm, config: EstimateConfig, calibration: SessionCalibration | None
    ) -> None:
        self.store = KeyframeStore(rig, body.instrument.joint_names)
        self._rig, self._body, self._arm, self._config = rig, body, arm, config
        self._alone: dict[str, Result] = {}
        self._solved = 0  # keyframes when they were last solved
        self._reason = ""
        self._bases = 0  # that were given up
        self._following: CalibratedFollowing | None = None
        if calibration is not None:
            self._begin(calibration)

    @property
    def calibration(self) -> SessionCalibration | None:
        """The calibration by which images are followed; None while there is none."""
        return None if self._following is None else self._following.calibration

    @property
    def lag(self) -> FoundLag | None:
        """The lag of the calibration; None if it has none."""
        found = None if self.calibration is None else self.calibration.lag
        if found is None or found.seconds is None:
            return None
        interval = found.seconds / found.frames if found.frames else 0.0
        return FoundLag(found.seconds, 0.0 if found.std_frames is None else found.std_frames * interval)

    @property
    def due(self) -> bool:
        """Whether there are more keyframes than when they were last solved, by enough that it pays.

        Where the last images disagree with the calibration, one more is enough.
        """
        if self._following is not None and self._following.disagrees and len(self.store) > max(self._solved, 2):
            return True
        return any(self._solved < count <= len(self.store) for count in SOLVED_AT)

    def problem(self) -> KeyframeProblem:
        """Return what the keyframes pose to be solved."""
        return self.store.problem(self._arm, self._config, self._alone, self._bases)

    def use(self, solution: Solution) -> bool:
        """Follow by a solution, if it has a calibration that predicts its frames; returns whether it has.

        One of keyframes of a base that was given up since is not used.
        """
        if solution.base != self._bases:
            return False
        self._alone.update(solution.alone)
        self._solved = max(self._solved, solution.keyframes)
        self._reason = solution.reason
        if solution.calibration is None or solution.reason:
            return False
        self._begin(solution.calibration)
        return True

    def _begin(self, calibration: SessionCalibration) -> None:
        """Follow by a calibration, in the digits of its document, so that an interrupted run goes on alike."""
        written = SessionCalibration.from_dict(calibration.to_dict())
        self._following = CalibratedFollowing(self._rig, self._body, self._config, written)

    def follow(self, time: float, readings: ReadingBuffer, seen: Seen, sight: Sight) -> TrackResult:
        """Fit an image by the calibration; if too many in a row contradict it, it does not hold any more."""
        assert self._following is not None
        lag = 0.0 if self.lag is None else self.lag.seconds
        result = self._following.follow(time, readings.at(time - lag), seen, sight)
        if self._following.contradicted:
            self._following, self._solved, self._bases = None, 0, self._bases + 1
            self._alone.clear()
            self.store.clear()
        else:
            self.offer(time, readings.at(time), seen, sight)
        return result

    def offer(self, time: float, reading: ReadingAt, seen: Seen, sight: Sight) -> None:
        """Keep an image as a keyframe, if it is worth that."""
        names = (*OUTER_JOINTS, *self._body.instrument.joint_names)
        masks = {self._rig.names[view]: mask for view in seen.clear if (mask := seen.masks[view]) is not None}
        if not masks or reading.still:
            return
        values = zip(names, [*reading.outer.tolist(), *reading.joints.tolist()], strict=True)
        self.store.offer(
            time, masks, sight.ignored(seen), {name: value for name, value in values if not np.isnan(value)}
        )

    def unconfirmed(self, result: TrackResult, *, told: bool) -> TrackResult:
        """Return the result of an image before a calibration: where the base could be ``told``, it is not ok."""
        if not told or result.status != "ok":
            return result
        known = "" if result.tip_std_mm is None else f", tips to {result.tip_std_mm:.1f} mm if this one is right"
        why = f" ({self._reason})" if self._reason else ""
        reason = f"base not known yet: {len(self.store)} keyframes{known}{why}"
        return replace(result, status="doubtful", reasons=(reason,))

    def checkpoint(self) -> dict[str, Any]:
        """Return the state as plain values."""
        return {
            "store": self.store.checkpoint(),
            "alone": {name: result.to_dict() for name, result in self._alone.items()},
            "solved": self._solved,
            "reason": self._reason,
            "bases": self._bases,
            "following": None if self._following is None else self._following.checkpoint(),
        }

    def restore(self, saved: Mapping[str, Any]) -> None:
        """Go on from the values of `checkpoint`; KeyError, TypeError, ValueError if they are not those."""
        self.store.restore(saved["store"])
        self._alone = {name: Result.from_dict(document) for name, document in saved["alone"].items()}
        self._solved, self._reason = int(saved["solved"]), str(saved["reason"])
        self._bases = int(saved["bases"])
        self._following = None
        if saved["following"] is not None:
            self._begin(SessionCalibration.from_dict(saved["following"]["calibration"]))
            assert self._following is not None
            self._following.restore(saved["following"])
