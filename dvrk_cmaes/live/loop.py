"""The loop: the newest frame and the readings before it go to the trackers of all arms, which publish their results.

No message ends it. A frame whose time is wrong is left out; where a clock was set, the camera changed, or several steps
in a row have failed, following begins anew. While there is no pose, /diagnostics says once a second why.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from threading import Event
from typing import Final

import numpy as np

from dvrk_cmaes.camera import Rig
from dvrk_cmaes.errors import InputError
from dvrk_cmaes.frames.images import match_size
from dvrk_cmaes.live.arm import LEFT_OUT, OLD, WAITING, LiveArm
from dvrk_cmaes.live.connection import Report
from dvrk_cmaes.live.inputs import Decoded, Inputs, LiveFrame
from dvrk_cmaes.live.stamps import Ages, ImageTimes

_WAIT: Final = 0.1  # s, for an image, before silence is looked for
_LATEST: Final = 100  # frames, the oldest of whose images is stated

Sizes = Mapping[str, tuple[int, int]]


@dataclass
class LiveCounts:
    """Frames followed, results published, ok ones of these, frames and readings left out.

    waited : time from the first image to the first ok result of the last arm to have one, s. why : reason of the last
    result. ages : of the last images, s.
    """

    followed: int = 0
    published: int = 0
    ok: int = 0
    refused: int = 0
    waited: float = 0.0
    why: str = ""
    ages: deque[float] = field(default_factory=lambda: deque(maxlen=_LATEST))

    @property
    def in_words(self) -> str:
        """The counts in one line, with the reason of the last result where none was ok."""
        said = f"{self.followed} images followed, {self.published} results published, {self.ok} ok"
        said += f" (from {self.waited:.1f} s on)" if self.ok else ""
        said += f"; {self.refused} images or readings left out"
        said += f"; {self.why}" if self.why and not self.ok else ""
        if not self.ages:
            return said
        median, most = 1e3 * np.median(self.ages), 1e3 * max(self.ages)
        return f"{said}; age of the last images {median:.0f} ms in the median, up to {most:.0f} ms"


class LiveLoop:
    """Follows the arms in what is received.

    Parameters
    ----------
    arms
        The arms.
    inputs
        Where images, readings and cameras come from.
    report
        Takes lines for the user.
    rig
        The cameras, used instead of those that are received.
    show
        Takes the state in one line, after each turn.
    """

    def __init__(
        self,
        arms: Sequence[LiveArm],
        inputs: Inputs,
        report: Report,
        *,
        rig: Rig | None = None,
        show: Callable[[Callable[[], str]], None] = lambda text: None,
    ) -> None:
        self.counts = LiveCounts()
        self._arms, self._inputs, self._report, self._show = list(arms), inputs, report, show
        self._given = rig
        self._stated: Rig | None = None
        self._rig: Rig | None = None  # of the images' size
        self._times, self._ages = ImageTimes(), Ages()
        if rig is not None:
            self._use(rig)

    @property
    def began(self) -> bool:
        """Whether there was a camera and a frame."""
        return self.counts.followed + self.counts.refused > 0

    def run(self, stop: Event, *, begin_within: float = np.inf, wait: float = _WAIT) -> LiveCounts:
        """Follow until ``stop`` is set, or for want of a frame in some seconds; returns the counts.

        Silence is looked for after each ``wait``, s, for an image.
        """
        started = self._inputs.now()
        while not stop.is_set() and (self.began or self._inputs.now() - started < begin_within):
            self.turn(wait)
        return self.counts

    def turn(self, wait: float = 0.0) -> None:
        """Follow the newest frame, if one comes within ``wait``, s, and state how it goes."""
        rig = self._inputs.rigs.take(0.0)
        if rig is not None and self._given is None:
            self._use(rig)
        frame = self._inputs.frames.take(wait)
        silent = self._inputs.report_silence()
        if self._stated is not None and frame is not None:
            self._take(frame, self._stated, silent)
        for arm in self._arms:
            arm.publish_if_due(silent)
        self._show(self._state)

    def _state(self) -> str:
        """Return the state in one line."""
        images = f"{self.counts.followed} image{'' if self.counts.followed == 1 else 's'}"
        age = f"age up to {1e3 * max(self.counts.ages):.0f} ms" if self.counts.ages else ""
        arms = []
        for arm in self._arms:
            own = (f"{arm.poses} poses", f"{arm.ok} ok", arm.base_state) if self.began else (arm.state,)
            name = f"{arm.name}: " if len(self._arms) > 1 else ""
            arms.append(name + ", ".join(part for part in own if part))
        return "; ".join(part for part in (images, *arms, age) if part)

    def _use(self, rig: Rig) -> None:
        """Follow by other cameras from the next frame on."""
        if self._stated is not None and _same(self._stated, rig):
            return
        again = "" if self._stated is None or self._rig is None else "; it has changed, and following begins anew"
        topics, rectified = self._inputs.topics.eyes, self._inputs.rectified
        rig = rig.with_cameras(
            {view.name: topics[view.name].remarked(view.camera, rectified=rectified) for view in rig.views}
        )
        self._stated, self._rig = rig, None
        eyes = "camera" if len(rig.views) == 1 else "cameras"
        views = ", ".join(
            f"{view.camera.width} x {view.camera.height} px, focal length {view.camera.fx:.1f} px" for view in rig.views
        )
        self._report(f"{eyes}: {views}{again}")
        for remark in rig.remarks:
            self._report(f"warning: {remark}")
        for arm in self._arms:
            arm.set_state(WAITING)

    def _take(self, frame: LiveFrame, stated: Rig, silent: tuple[str, ...]) -> None:
        """Follow a frame, or leave it out for one of the reasons of this module's description."""
        judged = self._times.judge(frame.time)
        if judged.line:
            self._report(f"{frame.topic}: {judged.line}")
        if judged.restarts:
            self._times, self._ages = ImageTimes(), Ages()
            self._begin()
        if not judged.used:
            self._leave_out(f"{frame.topic}: {judged.line}")
            return
        self._ages.receive(frame.time, frame.received)
        try:
            arrays = frame.decoded(grey=not (any(arm.draws for arm in self._arms) or not frame.topics.masked))
            self._fit(arrays.sizes, stated, frame.topic)
        except InputError as error:
            self._report(str(error))
            self._leave_out(str(error))
            return
        if self._follow(frame, arrays, silent):
            self._times.follow(frame.time)

    def _follow(self, frame: LiveFrame, arrays: Decoded, silent: tuple[str, ...]) -> bool:
        """Give readings and a frame to the trackers; returns whether the frame was followed."""

        def age() -> float:
            return self._ages.age(frame.time, self._inputs.now())

        for arm in self._arms:
            self.counts.refused += arm.start(self._inputs.readings[arm.name].take_all(), frame, arrays)
        finished = [arm.finish(age, silent) for arm in self._arms]
        followed = any(finished)
        self.counts.published = sum(arm.published for arm in self._arms)
        self.counts.ok = sum(arm.ok for arm in self._arms)
        self.counts.waited = max((arm.waited for arm in self._arms if arm.ok), default=0.0)
        self.counts.why = next((reason for arm in self._arms for reason in arm.reasons), "")
        self.counts.followed += followed
        self.counts.refused += not followed
        if followed:
            self.counts.ages.append(age())
            if self.counts.ages[-1] > OLD:
                self._report(
                    f"images are {self.counts.ages[-1]:.1f} s old: this computer, or the way here, is too slow"
                )
        return followed

    def _leave_out(self, reason: str) -> None:
        """Count a frame that is left out."""
        self.counts.refused += 1
        for arm in self._arms:
            arm.set_state(LEFT_OUT, reason)

    def _fit(self, sizes: Sizes, stated: Rig, topic: str) -> None:
        """Begin to follow, where the cameras or the size of the images are others than before.

        Raises
        ------
        InputError
            The images are of another aspect than the camera's.
        """
        now = {view.name: (view.camera.height, view.camera.width) for view in self._rig.views} if self._rig else {}
        if now and all(now[eye] == size for eye, size in sizes.items()):
            return
        try:
            what = f"image of {topic}"
            fitted = {eye: match_size(stated.view(eye).camera, size, what) for eye, size in sizes.items()}
        except InputError as error:
            raise InputError(str(error).partition(" (--")[0]) from None  # options of other commands
        for _, note in fitted.values():
            if note is not None:
                self._report(note)
        changed, self._rig = self._rig, stated.with_cameras({eye: camera for eye, (camera, _) in fitted.items()})
        if changed is not None:
            self._report(f"{topic}: the size of the images has changed, and following begins anew")
        self._begin()

    def _begin(self) -> None:
        """Let all arms begin, where they are not to wait for the first frame."""
        if self._rig is not None:
            for arm in self._arms:
                arm.begin(self._rig)


def _same(one: Rig, other: Rig) -> bool:
    """Whether two rigs have the same cameras at the same places."""
    return len(one.views) == len(other.views) and all(
        first.camera == second.camera and np.array_equal(first.view_from_camera, second.view_from_camera)
        for first, second in zip(one.views, other.views, strict=True)
    )
