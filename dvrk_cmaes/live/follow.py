"""Following on a connection from beginning to end: topics, trackers, and the loop."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager, ExitStack, closing
from dataclasses import dataclass, replace
from functools import partial
from threading import Event

import numpy as np

from dvrk_cmaes.calibration.document import SessionCalibration
from dvrk_cmaes.camera import Rig
from dvrk_cmaes.config import EstimateConfig
from dvrk_cmaes.errors import DvrkCmaesError, nearest_first
from dvrk_cmaes.export.frames import FrameNames
from dvrk_cmaes.instrument.arm import Arm
from dvrk_cmaes.io.short_text import listed
from dvrk_cmaes.live.arm import DrawOverlay, LiveArm
from dvrk_cmaes.live.arm_process import ArmProcess, Arrays, Start
from dvrk_cmaes.live.connection import Connection, LogThrottle, Report
from dvrk_cmaes.live.inputs import Inputs, InputTopics
from dvrk_cmaes.live.loop import LiveCounts, LiveLoop
from dvrk_cmaes.live.outputs import LiveOverlay, Outputs
from dvrk_cmaes.live.solutions import LiveSolutions
from dvrk_cmaes.results.tracked import TrackResult
from dvrk_cmaes.silhouette import Body
from dvrk_cmaes.track.keyframe_problem import Solver
from dvrk_cmaes.track.tracker import Tracker

_MOST_LISTED = 8  # topics
_ANSWER = 2.0  # s, for the topics of a server


@dataclass(frozen=True, eq=False)
class ArmSetup:
    """An arm that is followed: its names and instrument, and what is known of its base.

    With a ``solver``, which is made for the time of following, masks, and no given lag, the arm's base is found from
    keyframes, which are solved meanwhile; ``earlier`` is the calibration of an earlier run, and ``save`` keeps what is
    found.
    """

    names: FrameNames
    body: Body
    kinematics: Arm = "classic"
    calibration: SessionCalibration | None = None
    solver: Callable[[], AbstractContextManager[Solver]] | None = None
    earlier: SessionCalibration | None = None
    save: Callable[[SessionCalibration], None] | None = None


@dataclass(frozen=True, eq=False)
class LiveSetup:
    """What is followed, and how.

    ``rig`` is used instead of the topics' cameras if given; ``rectified`` says which of the topics' matrices is used.
    ``overlay`` publishes an overlay of each image. Trackers count time from ``origin``, ns. ``start_process`` starts
    one in which one of several arms is followed; without it all are followed in this one.
    """

    topics: InputTopics
    arms: tuple[ArmSetup, ...]
    config: EstimateConfig | None = None
    lag: float | None = None
    rig: Rig | None = None
    rectified: bool = False
    overlay: bool = False
    origin: int = 0
    start_process: Start | None = None

    def arm(self, own: ArmSetup, inputs: Inputs, connection: Connection, report: Report, stack: ExitStack) -> LiveArm:
        """Return an arm that publishes on a connection."""
        followed: FollowedArm | ArmProcess
        if self.start_process is None or len(self.arms) == 1:
            followed = stack.enter_context(FollowedArm(self, own, report))
        else:
            alone = replace(self, arms=(own,), start_process=None)
            followed = stack.enter_context(
                closing(ArmProcess(self.start_process, partial(FollowedArm, alone, own), report))
            )
        return LiveArm(
            own.names.arm,
            followed.begin,
            Outputs(connection, own.names, own.body.instrument.root_link),
            report,
            inputs.now,
            draw=partial(_drawing, own.body, followed) if self.overlay else None,
            origin=self.origin,
        )

    def loop(
        self,
        inputs: Inputs,
        connection: Connection,
        report: Report,
        stack: ExitStack,
        show: Callable[[Callable[[], str]], None] = lambda text: None,
    ) -> LiveLoop:
        """Subscribe to the topics, and return the loop; what it uses is closed with the stack."""
        inputs.subscribe(connection)
        arms = [self.arm(own, inputs, connection, report, stack) for own in self.arms]
        return LiveLoop(arms, inputs, report, rig=self.rig, show=show)


class FollowedArm(ExitStack):
    """An arm that is followed in this process: its newest tracker, and the solution of its keyframes."""

    def __init__(self, setup: LiveSetup, own: ArmSetup, report: Report) -> None:
        super().__init__()
        self._setup, self._own = setup, own
        self._solutions: LiveSolutions | None = None
        if own.solver is not None:
            self._solutions = LiveSolutions(self.enter_context(own.solver()), report, own.save, own.earlier)

    def begin(self, rig: Rig) -> FollowedArm:
        """Follow anew, by these cameras."""
        own, earlier = self._own, None
        if self._solutions is not None and own.calibration is None:
            earlier = self._solutions.earlier_of(rig)
        self._tracker = tracker = Tracker(
            rig,
            own.body,
            earlier or own.calibration,
            self._setup.config,
            arm=own.kinematics,
            lag=self._setup.lag,
            earlier=earlier is not None,
            background=True,
        )
        if self._solutions is not None:
            self._solutions.tracker = tracker
        return self

    @property
    def state(self) -> str:
        """How far the arm's base is known, in words."""
        return "" if self._solutions is None else self._tracker.base_state

    def add_readings(self, time: float, joints: Mapping[str, float]) -> None:
        """Add the readings of one time, as `Tracker.add_readings`."""
        self._tracker.add_readings(time, joints)

    def step(self, time: float, mask: Arrays = None, image: Arrays = None, ignore: Arrays = None) -> TrackResult:
        """Use a solution that has come, and follow to the images of a later time, s, as `Tracker.step`."""
        if self._solutions is not None:
            self._solutions.before_step(time)
        return self._tracker.step(time, mask, image, ignore)

    def start_step(
        self, time: float, mask: Arrays = None, image: Arrays = None, ignore: Arrays = None
    ) -> Callable[[], TrackResult]:
        """Return what follows to the images of a later time, s."""
        return partial(self.step, time, mask, image, ignore)

    def after_step(self, time: float) -> None:
        """Do what is due after the step to a time, s."""
        if self._solutions is not None:
            self._solutions.after_step(time)


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
    say = LogThrottle(report)
    inputs = Inputs(setup.topics, say, rectified=setup.rectified)
    with ExitStack() as stack:
        loop = setup.loop(inputs, connection, say, stack, show)
        counts = loop.run(stop, begin_within=begin_within)
    if not loop.began:
        raise DvrkCmaesError(_what_to_check(setup, inputs, connection))
    return counts


def _drawing(body: Body, followed: FollowedArm | ArmProcess, rig: Rig) -> DrawOverlay:
    return LiveOverlay(body, rig.camera, lambda: followed.state)


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
