"""Following on a connection from beginning to end: topics, trackers, and the loop."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager, ExitStack
from dataclasses import dataclass
from functools import partial
from threading import Event
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.calibration.document import SessionCalibration
from dvrk_cmaes.camera import Rig
from dvrk_cmaes.config import EstimateConfig
from dvrk_cmaes.errors import DvrkCmaesError, InputError, nearest_first, one_line
from dvrk_cmaes.export.frames import FrameNames
from dvrk_cmaes.instrument.arm import Arm
from dvrk_cmaes.io.short_text import listed
from dvrk_cmaes.live.arm import LiveArm, Readings
from dvrk_cmaes.live.arm_process import ArmProcess, Process
from dvrk_cmaes.live.connection import Connection, LogThrottle, Report
from dvrk_cmaes.live.inputs import Inputs, InputTopics
from dvrk_cmaes.live.loop import LiveCounts, LiveLoop
from dvrk_cmaes.live.outputs import Outputs
from dvrk_cmaes.results.tracked import TrackResult
from dvrk_cmaes.silhouette import Body
from dvrk_cmaes.track.keyframe_problem import SolutionSchedule, Solver
from dvrk_cmaes.track.tracker import Tracker

Arrays = Mapping[str, NDArray[Any]] | None
"""Arrays of the eyes' images, by name."""

_MOST_LISTED = 8  # topics
_ANSWER = 2.0  # s, for the topics of a server


@dataclass(frozen=True, eq=False)
class ArmSetup:
    """An arm that is followed: its names and instrument, what is known of its base, and settings.

    With a ``solver``, which is made for the time of following, the arm's base is found from keyframes, which are solved
    meanwhile; ``save`` keeps the document of each calibration that is found.
    """

    names: FrameNames
    body: Body
    kinematics: Arm = "classic"
    calibration: SessionCalibration | None = None
    solver: Callable[[], AbstractContextManager[Solver]] | None = None
    save: Callable[[Mapping[str, Any]], None] | None = None
    config: EstimateConfig | None = None
    lag: float | None = None


@dataclass(frozen=True, eq=False)
class LiveSetup:
    """What is followed, and how.

    ``rig`` is used instead of the topics' cameras if given; ``rectified`` says which of the topics' matrices is used.
    ``overlay`` publishes an overlay of each image. ``process`` makes one in which one of several arms is followed;
    without it all are followed in this one.
    """

    topics: InputTopics
    arms: tuple[ArmSetup, ...]
    rig: Rig | None = None
    rectified: bool = False
    overlay: bool = False
    process: Callable[[], Process] | None = None


class FollowedArm(ExitStack):
    """An arm that is followed in this process: its newest tracker, and the solution of its keyframes."""

    def __init__(self, own: ArmSetup, report: Report) -> None:
        super().__init__()
        self._own, self._report = own, report
        self._solver = None if own.solver is None else self.enter_context(own.solver())

    def begin(self, rig: Rig) -> FollowedArm:
        """Follow anew, by these cameras."""
        own = self._own
        self._tracker = Tracker(
            rig, own.body, own.calibration, own.config, arm=own.kinematics, lag=own.lag, background=True
        )
        self._solutions = SolutionSchedule(self._tracker, self._solver, at_once=True)
        return self

    @property
    def state(self) -> str:
        """How far the arm's base is known, in words."""
        return "" if self._solver is None else self._tracker.base_state

    def step(
        self, readings: Readings, time: float, mask: Arrays = None, image: Arrays = None, ignore: Arrays = None
    ) -> TrackResult:
        """Use a solution that has come, and follow to the images of a later time, s, as `Tracker.step`."""
        for when, joints in readings:
            try:
                self._tracker.add_readings(when, joints)
            except InputError as error:
                self._report(str(error))
        self._use(time)
        result = self._tracker.step(time, mask, image, ignore)
        self._solutions.after_step(time)
        return result

    def start_step(self, *arguments: Any) -> Callable[[], TrackResult]:
        """Return what does `step`, with its arguments."""
        return partial(self.step, *arguments)

    def _use(self, time: float) -> None:
        """Use a solution that has come, and save its calibration; an error costs a line."""
        try:
            found = self._solutions.before_step(time) and self._tracker.calibration
            if found and self._own.save is not None:
                self._own.save(found.to_dict())
        except Exception as error:
            self._report(f"solution of keyframes: {one_line(error)}")


def follow(
    setup: LiveSetup,
    connection: Connection,
    report: Report,
    stop: Event,
    *,
    show: Callable[[Callable[[], str]], None] = lambda text: None,
    begin_within: float = np.inf,
) -> LiveCounts:
    """Follow until ``stop`` is set; ``report`` takes lines for the user, and ``show`` the state in one line.

    Raises
    ------
    InputError
        A setting is not valid.
    DvrkCmaesError
        Nothing to follow came before the end, or within ``begin_within`` s.
    """
    inputs = Inputs(setup.topics, LogThrottle(report), rectified=setup.rectified)
    inputs.subscribe(connection)
    arms, apart = list[LiveArm](), setup.process if len(setup.arms) > 1 else None
    with ExitStack() as stack:
        for own in setup.arms:
            say = LogThrottle(report)  # a line of one arm does not keep the same line of another
            followed: FollowedArm | ArmProcess
            followed = FollowedArm(own, say) if apart is None else ArmProcess(stack.enter_context(apart()), own, say)
            stack.callback(followed.close)
            drawn = own.body if setup.overlay else None
            outputs = Outputs(connection, own.names, own.body.instrument.root_link, drawn)
            arms.append(LiveArm(own.names.arm, followed.begin, outputs, say, inputs.now))
        loop = LiveLoop(arms, inputs, LogThrottle(report), rig=setup.rig, show=show)
        counts = loop.run(stop, begin_within=begin_within)
    if not loop.began:
        raise DvrkCmaesError(_what_to_check(setup, inputs, connection))
    return counts


def _what_to_check(setup: LiveSetup, inputs: Inputs, connection: Connection) -> str:
    """Say why there may be nothing to follow: no connection, or topics without messages."""
    there = connection.topics(_ANSWER)
    if there is None:
        return (
            f"no image: {connection.name}: no connection: is it running there (ros2 launch rosbridge_server "
            "rosbridge_websocket_launch.xml; --host, --port)? --wait waits for it"
        )
    wanted = setup.topics.of_frames | ({} if setup.rig is not None else setup.topics.of_cameras)
    lines = []
    for topic in inputs.unheard(list(wanted)):
        kind = there.get(topic)
        if kind is None:
            lines.append(f"{topic}: no such topic" if there else f"{topic}: no message")
        elif kind.replace("/msg/", "/") != wanted[topic]:
            lines.append(f"{topic}: expected {wanted[topic]}, got {kind}")
        else:
            lines.append(f"{topic}: no message from its publisher")
    silent = "; ".join(lines) or "the images and masks have no common times"
    kinds = set(wanted.values())
    same = [topic for topic, kind in there.items() if kind.replace("/msg/", "/") in kinds]
    others = f"; there are {listed(nearest_first(next(iter(wanted)), same), _MOST_LISTED)}" if same else ""
    return f"no image: {connection.name}: {silent}{others}; --wait waits for them"
