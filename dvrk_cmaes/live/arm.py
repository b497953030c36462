"""One of the arms that are followed: its tracker, the solution of its keyframes, and what is published of it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Final

from dvrk_cmaes.camera import Rig
from dvrk_cmaes.errors import InputError, internal_error
from dvrk_cmaes.joints.interpolation import NANOSECONDS
from dvrk_cmaes.live.connection import Report
from dvrk_cmaes.live.inputs import Decoded, LiveFrame
from dvrk_cmaes.live.messages import JointMessage
from dvrk_cmaes.live.outputs import Outputs
from dvrk_cmaes.live.stamps import LONGEST_GAP
from dvrk_cmaes.pose.doubts import image_old, reasons
from dvrk_cmaes.results.tracked import TrackResult, doubted

if TYPE_CHECKING:
    from dvrk_cmaes.live.arm_process import ArmProcess
    from dvrk_cmaes.live.follow import FollowedArm

Readings = Sequence[tuple[float, Mapping[str, float]]]
"""Times, s, and readings of joints by name, rad (insertion: m)."""

WAITING: Final = "waiting for images"
LEFT_OUT: Final = "image left out"
OLD: Final = 1.0
"""Age, s, from which on a pose is doubtful."""
MOST_FAILURES: Final = 3
"""Steps in a row that fail, after which a new tracker begins."""
_STATE_EVERY: Final = 1.0  # s without a result, after which the status says why


class LiveArm:
    """Follows an arm, and publishes what is found.

    ``poses`` and ``ok`` count what was published, ``base_state`` says how far the arm's base is known; ``reasons`` are
    those of the last result, ``waited`` the time, s, from the first image to the first pose that is ok.

    Parameters
    ----------
    name
        Name of the arm, as in the frames.
    make_tracker
        Makes a tracker for cameras.
    outputs
        Where results go.
    report
        Takes lines for the user.
    now
        The clock, s.

    Times of the tracker are counted from the first image: seconds since 1970 have few digits left, and the clock of a
    recording that is played is not this computer's.
    """

    def __init__(
        self,
        name: str,
        make_tracker: Callable[[Rig], FollowedArm | ArmProcess],
        outputs: Outputs,
        report: Report,
        now: Callable[[], float],
    ) -> None:
        self.name, self.state, self.base_state = name, "waiting for the camera", ""
        self.poses = self.ok = self.published = 0
        self.reasons, self.waited, self._first, self._origin = tuple[str, ...](), 0.0, 0, 0
        self.draws, self._make_tracker = outputs.drawn is not None, make_tracker
        self._outputs, self._report, self._now = outputs, report, now
        self._reason, self._stated, self._failures = "", now(), 0

    def begin(self, rig: Rig) -> None:
        """Follow anew, by these cameras."""
        self._rig, self._tracker, self._failures = rig, self._make_tracker(rig), 0
        self.base_state = self._tracker.state
        self._outputs.begin(rig)

    def start(self, readings: Sequence[JointMessage], frame: LiveFrame, arrays: Decoded) -> int:
        """Begin to follow a frame with the readings since the last one.

        Returns how many readings are left out, as they are far from the frame's time.
        """
        self._frame, self._arrays, self._origin = frame, arrays, self._origin or frame.time
        near = []
        for one in readings:
            ahead = (one.time - frame.time) / NANOSECONDS
            if abs(ahead) > LONGEST_GAP:
                self._report(f"{one.topic}: readings {ahead:+.1f} s from the images are left out")
            else:
                near.append(((one.time - self._origin) / NANOSECONDS, one.joints))
        masks, ignored = arrays.masks.get(self.name), arrays.ignored(self.name)
        seconds = (frame.time - self._origin) / NANOSECONDS
        self._result = self._tracker.start_step(near, seconds, masks, arrays.images or None, ignored or None)
        return len(readings) - len(near)

    def finish(self, age: Callable[[], float], silent: Sequence[str]) -> bool:
        """Publish the result of the frame that was started, or say why there is none; returns whether it was followed.

        Following begins anew after several in a row that were not.
        """
        try:
            self._publish(self._result(), age, silent)
        except Exception as error:
            self._fail(error)
            return False
        self._failures = 0
        return True

    def _publish(self, result: TrackResult, age: Callable[[], float], silent: Sequence[str]) -> None:
        frame, image = self._frame, next(iter(self._arrays.images.values()), None)
        state, old = self._tracker.state, age()
        result = doubted(result, reasons(image_old(old, OLD)))
        self.published += self._outputs.publish(frame.time, result, old, silent, image, state)
        self.poses += result.camera_from_root is not None and result.status != "lost"
        self.reasons, self._first = result.reasons, self._first or frame.time
        if not self.ok:
            self.waited = (frame.time - self._first) / NANOSECONDS
        self.ok += result.status == "ok"
        self._stated = self._now()
        self.set_state(WAITING)
        self.base_state = state

    def _fail(self, error: Exception) -> None:
        """Leave out a frame whose step failed, and begin anew after several in a row."""
        if isinstance(error, InputError):
            self._report(str(error))
            self.set_state(LEFT_OUT, str(error))
            return
        reason = "out of memory" if isinstance(error, MemoryError) else internal_error(error)
        self._failures += 1
        self._report(f"{reason}; the image is left out; after {MOST_FAILURES} in a row following begins anew")
        self.set_state(LEFT_OUT, reason)
        if self._failures >= MOST_FAILURES:
            self.begin(self._rig)

    def set_state(self, state: str, reason: str = "") -> None:
        """State what is waited for, or why a frame is left out."""
        self.state, self._reason = state, reason

    def publish_if_due(self, silent: Sequence[str]) -> None:
        """Publish the state if nothing was published for a second."""
        if self._now() - self._stated >= _STATE_EVERY:
            self._stated = self._now()
            self._outputs.publish_state(self.state, self._reason, silent)
