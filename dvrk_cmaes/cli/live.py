"""``dvrk-cmaes live``: an instrument followed on a running robot, over ROS topics."""

from __future__ import annotations

import math
import signal
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from threading import Event, Timer, current_thread, main_thread
from typing import Annotated, Any, Literal

from cyclopts import Group, Parameter

from dvrk_cmaes.cli.options import (
    CAMERA,
    DEFAULT_INSTRUMENT,
    DEFAULT_METHOD,
    METHOD,
    OUTPUT,
    DoubtfulSessionOption,
    Flag,
    InstrumentOptions,
    MethodOptions,
    SessionOption,
)
from dvrk_cmaes.cli.terminal import Line, note, show
from dvrk_cmaes.errors import InputError

TOPICS = Group.create_ordered("Topics")
SERVER = Group.create_ordered("Server")


@Parameter(name="*", group=TOPICS)
@dataclass(frozen=True, kw_only=True)
class LiveTopics:
    """Topics that are read.

    Parameters
    ----------
    image_topic
        Topic of the images; sensor_msgs/CompressedImage if its name ends in /compressed, else sensor_msgs/Image.
    mask_topic
        Topic of the instrument's masks, which a segmenter publishes with the times of the images: mono8, above 127 is
        instrument. By default the images are followed by their colours.
    camera_topic
        Topic of the camera (sensor_msgs/CameraInfo); by default camera_info in the namespace of the images.
    joints_topic
        Topic of the arm's joints (sensor_msgs/JointState); ARM/measured_js by default.
    jaw_topic
        Topic of the jaw (sensor_msgs/JointState); ARM/jaw/measured_js by default.
    """

    image_topic: str
    mask_topic: str | None = None
    camera_topic: str | None = None
    joints_topic: str | None = None
    jaw_topic: str | None = None


def live(
    *,
    topics: LiveTopics,
    psm: Annotated[str, Parameter(group=TOPICS)] = "PSM1",
    camera_frame: Annotated[str, Parameter(group=TOPICS)] = "camera",
    via: Annotated[Literal["rosbridge", "rclpy"], Parameter(group=SERVER)] = "rosbridge",
    host: Annotated[str, Parameter(group=SERVER)] = "127.0.0.1",
    port: Annotated[int, Parameter(group=SERVER)] = 9090,
    camera: Annotated[Path | None, Parameter(group=CAMERA)] = None,
    rectified: Annotated[Flag, Parameter(group=CAMERA)] = False,
    instrument: InstrumentOptions = DEFAULT_INSTRUMENT,
    calibration: SessionOption = None,
    doubtful_session: DoubtfulSessionOption = False,
    lag: Annotated[float | None, Parameter(group=METHOD)] = None,
    method: MethodOptions = DEFAULT_METHOD,
    out: Annotated[Path | None, Parameter(group=OUTPUT)] = None,
    overlay: Annotated[Flag, Parameter(group=OUTPUT)] = False,
    seconds: Annotated[float, Parameter(group=OUTPUT)] = math.inf,
) -> int:
    r"""Follow an instrument on a running robot: images and readings from ROS topics, its pose to ROS topics.

    The topics are read and written through a rosbridge server (`ros2 launch rosbridge_server
    rosbridge_websocket_launch.xml`), so that no ROS is needed here. Of the images only the newest is followed. A lost
    connection is opened again. `dvrk-cmaes help live` lists the topics that are published. Ends with Ctrl-C.

    Example:

    ```
    dvrk-cmaes live --rectified --mask-topic /left/mask \
      --image-topic /left/image_rect_color/compressed
    ```

    Parameters
    ----------
    topics
        The topics.
    psm
        Name of the arm in the names of topics and frames.
    camera_frame
        Name of the camera's optical frame in the poses that are published.
    via
        How ROS is reached: through a rosbridge server, or as a node of ROS 2 where rclpy is importable.
    host
        Name or address of the rosbridge server.
    port
        Its port.
    camera
        Camera file, used instead of the topic of the camera.
    rectified
        The images are rectified: use the projection matrix, and no distortion.
    instrument
        The instrument.
    calibration
        A session.json written by `calibrate`: its base, offsets and lag.
    doubtful_session
        Use the session.json of --session even if it predicts frames badly that it has not seen.
    lag
        Lag of the images behind the readings, s; by default the calibration's, or found while following.
    method
        The method.
    out
        Folder for session.json, the calibration that is found from keyframes while following by masks. The next start
        with the same folder takes it up, and no pose is ok before images agree with it: the camera may have been moved.
    overlay
        Publish each image with the silhouette of the pose, as JPEG.
    seconds
        Time after which to end, in seconds.
    """
    if not 0 < port < 2**16:
        raise InputError(f"--port: expected 1 to 65535, got {port}")
    if not seconds > 0:
        raise InputError(f"--seconds: expected a time above 0, got {seconds:g}")
    from dvrk_cmaes.camera.files import read_camera
    from dvrk_cmaes.cli.session_tools import read_calibration_of
    from dvrk_cmaes.export.frames import FrameNames
    from dvrk_cmaes.io.output import output
    from dvrk_cmaes.live.follow import LiveSetup, follow
    from dvrk_cmaes.live.inputs import InputTopics
    from dvrk_cmaes.live.rclpy_node import RclpyConnection
    from dvrk_cmaes.live.repeated_lines import RepeatedLines
    from dvrk_cmaes.live.rosbridge import RosbridgeConnection
    from dvrk_cmaes.results.folder import SESSION
    from dvrk_cmaes.runs.live_session import earlier_calibration, save_calibration
    from dvrk_cmaes.runs.long_run import prepare_long_run
    from dvrk_cmaes.runs.solver_process import SolverProcess

    image = topics.image_topic
    namespace = image.removesuffix("/compressed").rpartition("/")[0]
    names = FrameNames(psm, camera_frame, f"{psm}_base")
    names.check_tf()
    body = instrument.load()
    keeps = topics.mask_topic is not None and lag is None
    if out is not None and not keeps:
        raise InputError("--out: expected masks (--mask-topic) and no --lag, from which a calibration is found")
    setup = LiveSetup(
        InputTopics(
            image,
            topics.camera_topic or f"{namespace}/camera_info",
            (topics.joints_topic or f"/{psm}/measured_js", topics.jaw_topic or f"/{psm}/jaw/measured_js"),
            topics.mask_topic,
        ),
        names,
        body,
        instrument.kinematics,
        read_calibration_of(calibration, body, instrument.arm, doubtful=doubtful_session),
        method.resolve(),
        lag,
        None if camera is None else read_camera(camera, rectified=rectified),
        rectified,
        overlay,
        earlier=None if out is None else earlier_calibration(out, body.instrument, instrument.kinematics),
        save=lambda found: None if out is None else save_calibration(out, found),
    )
    report = RepeatedLines(note)  # of the connection; follow has its own
    connection = RclpyConnection(report) if via == "rclpy" else RosbridgeConnection(host, port, report)
    prepare_long_run()
    with ExitStack() as stack:
        if out is not None:
            stack.enter_context(output(out, "live", owns=False)).refuse((SESSION,))
        stop = stack.enter_context(_stopped(seconds))
        if keeps:
            solver = stack.enter_context(SolverProcess(body.instrument, background=True))
            setup = replace(setup, solver=solver)
        connection.open(timeout=2.0)
        try:
            counts = follow(setup, connection, note, stop)
        finally:
            connection.close()
    show([Line(f"{counts.followed} images followed, {counts.published} results published, {counts.refused} refused")])
    return 0


@contextmanager
def _stopped(seconds: float) -> Iterator[Event]:
    """Yield an event that is set after some seconds, or by Ctrl-C."""
    stop = Event()
    timer = Timer(min(seconds, 1e8), stop.set)
    timer.daemon = True
    timer.start()
    before: Any = None
    if current_thread() is main_thread():
        before = signal.signal(signal.SIGINT, lambda *_: stop.set())
    try:
        yield stop
    finally:
        timer.cancel()
        if before is not None:
            signal.signal(signal.SIGINT, before)
