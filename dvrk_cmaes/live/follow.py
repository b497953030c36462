"""Following on a connection from beginning to end: wait for the camera, make a tracker, and run the loop."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from threading import Event

from dvrk_cmaes.calibration.document import SessionCalibration
from dvrk_cmaes.camera import Camera
from dvrk_cmaes.config import EstimateConfig
from dvrk_cmaes.export.frames import FrameNames
from dvrk_cmaes.instrument.arm import Arm
from dvrk_cmaes.live.connection import Connection, Report
from dvrk_cmaes.live.inputs import Inputs, InputTopics
from dvrk_cmaes.live.loop import LiveCounts, LiveLoop, PresentState
from dvrk_cmaes.live.outputs import Outputs
from dvrk_cmaes.live.overlay import LiveOverlay
from dvrk_cmaes.live.repeated_lines import RepeatedLines
from dvrk_cmaes.live.solutions import LiveSolutions
from dvrk_cmaes.silhouette import Body
from dvrk_cmaes.track.solution_schedule import Solver
from dvrk_cmaes.track.tracker import Tracker

_WAIT = 0.2  # s


@dataclass(frozen=True, eq=False)
class LiveSetup:
    """What is followed, and how.

    ``camera`` is used instead of the topic's if given; ``rectified`` says which of the topic's matrices is used.
    ``overlay`` publishes an overlay of each image. With a ``solver``, masks, and no given lag, the arm's base is found
    from keyframes, which are solved beside the loop; ``earlier`` is the calibration of an earlier run, and ``save``
    keeps what is found.
    """

    topics: InputTopics
    names: FrameNames
    body: Body
    arm: Arm = "classic"
    calibration: SessionCalibration | None = None
    config: EstimateConfig | None = None
    lag: float | None = None
    camera: Camera | None = None
    rectified: bool = False
    overlay: bool = False
    solver: Solver | None = None
    earlier: SessionCalibration | None = None
    save: Callable[[SessionCalibration], None] = lambda calibration: None


def follow(setup: LiveSetup, connection: Connection, report: Report, stop: Event) -> LiveCounts:
    """Follow an instrument until ``stop`` is set; ``report`` takes lines for the user.

    Raises
    ------
    InputError
        A setting is not valid.
    """
    say = RepeatedLines(report)
    inputs = Inputs(setup.topics, say, rectified=setup.rectified)
    inputs.subscribe(connection)
    outputs = Outputs(connection, setup.names, setup.body.instrument.root_link)
    camera = setup.camera or _received(inputs, PresentState(outputs, "waiting for the camera"), stop)
    if camera is None:
        return LiveCounts()
    report(f"camera: {camera.width} x {camera.height} px, focal length {camera.fx:.1f} px")

    solutions = None
    if setup.solver is not None and setup.topics.mask is not None and setup.lag is None:
        solutions = LiveSolutions(setup.solver, say, setup.save, setup.earlier)

    def make_tracker() -> Tracker:
        taken_up = solutions is not None and setup.calibration is None and solutions.earlier is not None
        tracker = Tracker(
            camera,
            setup.body,
            solutions.earlier if solutions is not None and taken_up else setup.calibration,
            setup.config,
            arm=setup.arm,
            lag=setup.lag,
            keyframes=solutions is not None,
            earlier=taken_up,
            sliced=True,
        )
        if solutions is not None:
            solutions.tracker = tracker
        return tracker

    def state() -> str:
        return "" if solutions is None else solutions.state

    loop = LiveLoop(
        make_tracker,
        inputs,
        outputs,
        say,
        draw=LiveOverlay(setup.body, camera, state) if setup.overlay else None,
        beside=solutions,
    )
    return loop.run(stop)


def _received(inputs: Inputs, state: PresentState, stop: Event) -> Camera | None:
    """Wait for the camera; None if ``stop`` is set before it comes."""
    while not stop.is_set():
        camera = inputs.cameras.take(_WAIT)
        if camera is not None:
            return camera
        state.publish_if_due()
    return None
