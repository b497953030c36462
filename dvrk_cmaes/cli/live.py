"""``dvrk-cmaes live``: the instruments of a running robot followed over ROS topics."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from cyclopts import Group, Parameter

from dvrk_cmaes.cli.options import (
    CAMERA,
    METHOD,
    OUTPUT,
    CalibrationOptions,
    ConfigOption,
    Flag,
    MethodOptions,
    UrdfOptions,
    options,
    whole,
)
from dvrk_cmaes.cli.terminal import Line, note, show, stopping_on_interrupt
from dvrk_cmaes.errors import InputError

if TYPE_CHECKING:
    from dvrk_cmaes.camera import Rig
    from dvrk_cmaes.live.connection import Connection, Report
    from dvrk_cmaes.live.follow import LiveSetup
    from dvrk_cmaes.live.inputs import InputTopics

TOPICS = Group.create_ordered("Topics")
SERVER = Group.create_ordered("Server")
Each = Annotated[tuple[str, ...], Parameter(consume_multiple=True, negative=(), show_default=False)]
"""One value for each arm."""

_FIRST_IMAGE = 10.0  # s, within which there must be something to follow
_RENEWED, _LINES = 0.5, 10.0  # s, after which the state is shown again, on a terminal and elsewhere


@options(group=TOPICS)
class LiveTopics:
    """Topics that are read.

    Parameters
    ----------
    image_topic
        Topic of the images; sensor_msgs/CompressedImage if its name ends in /compressed, else sensor_msgs/Image.
    right_image_topic
        The same of the right eye, whose images are paired with those of the left one by their times, within 10 ms.
    mask_topic
        Topic of the instrument's masks, which a segmenter publishes with the times of the images: mono8, above 127 is
        instrument. Of several arms one topic each. By default the images are followed by their colours.
    right_mask_topic
        The same of the right eye.
    camera_topic
        Topic of the camera (sensor_msgs/CameraInfo); by default camera_info in the namespace of the images.
    right_camera_topic
        The same of the right eye.
    joints_topic
        Topic of the arm's joints (sensor_msgs/JointState), one for each arm; ARM/measured_js by default.
    jaw_topic
        Topic of the jaw (sensor_msgs/JointState), one for each arm; ARM/jaw/measured_js by default.
    ecm_topic
        Topic of the joints of the arm that holds the endoscope (sensor_msgs/JointState). Where
        it moves, the arm's base in each image follows from them.
    psm
        Names of the arms in the names of topics and frames: one, or several that are followed together.
    camera_frame
        Name of the camera's optical frame in the poses that are published.
    """

    image_topic: str | None = None
    right_image_topic: str | None = None
    mask_topic: Each = ()
    right_mask_topic: Each = ()
    camera_topic: str | None = None
    right_camera_topic: str | None = None
    joints_topic: Each = ()
    jaw_topic: Each = ()
    ecm_topic: str = "/ECM/measured_js"
    psm: Annotated[tuple[str, ...], Parameter(consume_multiple=True, negative=())] = ("PSM1",)
    camera_frame: str = "camera"

    def of_arms(self, arms: tuple[str, ...]) -> InputTopics:
        """Return the topics of some arms; InputError where they are not one for each."""
        from dvrk_cmaes.live.inputs import EyeTopics, InputTopics

        if self.image_topic is None:
            raise InputError("--image-topic: expected the topic of the images, got none")
        right = (self.right_mask_topic, self.right_camera_topic)
        if self.right_image_topic is None and any(right):
            raise InputError("--right-image-topic: expected the topic of the right eye's images, got none")
        masks = _of_each("--mask-topic", self.mask_topic, arms)
        right_masks = _of_each("--right-mask-topic", self.right_mask_topic, arms)
        joints = _of_each("--joints-topic", self.joints_topic, arms, "/{}/measured_js")
        jaws = _of_each("--jaw-topic", self.jaw_topic, arms, "/{}/jaw/measured_js")
        if self.right_image_topic is not None and bool(self.mask_topic) != bool(self.right_mask_topic):
            raise InputError("--right-mask-topic: expected masks of both eyes or of neither, got those of one")
        if len(arms) > 1 and not self.mask_topic:
            raise InputError("--mask-topic: expected a topic for each of several arms: colours do not distinguish them")
        eyes = {"left": EyeTopics.of(self.image_topic, self.camera_topic, masks)}
        if self.right_image_topic is not None:
            eyes["right"] = EyeTopics.of(self.right_image_topic, self.right_camera_topic, right_masks)
        return InputTopics(eyes, {arm: (joints[arm], jaws[arm]) for arm in arms}, self.ecm_topic)


def _of_each(option: str, given: tuple[str, ...], arms: tuple[str, ...], default: str = "") -> dict[str, str]:
    """Return the topics of arms, those by default where none are given; InputError where they are not one for each."""
    if given and len(given) != len(arms):
        raise InputError(f"{option}: expected a topic for each of {', '.join(arms)}, got {', '.join(given)}")
    by_default = tuple(default.format(arm) for arm in arms) if default else ()
    return dict(zip(arms, given or by_default, strict=False))


@options(group=SERVER)
class ServerOptions:
    """How ROS is reached.

    Parameters
    ----------
    via
        Through a rosbridge server, or as a node of ROS 2 where rclpy is importable.
    host
        Name or address of the rosbridge server.
    port
        Its port.
    wait
        Wait for the server, the camera and the first image as long as it takes.
    """

    via: Literal["rosbridge", "rclpy"] = "rosbridge"
    host: str = "127.0.0.1"
    port: Annotated[int, whole(1, 2**16 - 1)] = 9090
    wait: Flag = False

    def connection(self, report: Report) -> Connection:
        """Return the connection, not opened yet."""
        from dvrk_cmaes.live.rclpy_node import RclpyConnection
        from dvrk_cmaes.live.rosbridge import RosbridgeConnection

        return RclpyConnection(report) if self.via == "rclpy" else RosbridgeConnection(self.host, self.port, report)


@options(group=CAMERA)
class LiveCameraOptions:
    """Options of the camera.

    Parameters
    ----------
    camera
        Camera file, used instead of the topic of the camera.
    camera_right
        File of the right camera, where both eyes are used and the files are two.
    rectified
        The images are rectified: use the projection matrix, and no distortion.
    """

    camera: Path | None = None
    camera_right: Path | None = None
    rectified: Flag = False

    def rig(self, topics: InputTopics) -> Rig | None:
        """Read the cameras of files; None without one."""
        from dvrk_cmaes.camera import Rig
        from dvrk_cmaes.camera.files import read_camera
        from dvrk_cmaes.camera.rig_files import read_rig

        if self.camera_right is not None and (self.camera is None or len(topics.eyes) == 1):
            raise InputError("--camera-right: expected --camera and --right-image-topic with it")
        if self.camera is None:
            return None
        if len(topics.eyes) > 1:
            return read_rig(self.camera, self.camera_right, rectified=self.rectified).rig
        return Rig.of_camera(read_camera(self.camera, rectified=self.rectified))


@options(group=OUTPUT)
class LiveOutput:
    """What is written and published, and for how long.

    Parameters
    ----------
    out
        Folder for session.json, the calibration that is found from keyframes. While the camera is not moved, the next
        start can use it by --session. Those of several arms are in OUT/ARM.
    overlay
        Publish each image with the silhouette of the pose, as JPEG.
    seconds
        Time after which to end, in seconds.
    """

    out: Path | None = None
    overlay: Flag = False
    seconds: float = math.inf


@options(group=METHOD)
class LiveMethod(CalibrationOptions):
    """The calibration that following begins with, and settings.

    Parameters
    ----------
    lag
        Lag of the images behind the readings, s; by default the calibration's, or found while following.
    config
        Settings file (TOML); `dvrk-cmaes help settings` lists its keys.
    """

    lag: float | None = None
    config: ConfigOption = None


def live(
    *,
    topics: LiveTopics = LiveTopics(),
    server: ServerOptions = ServerOptions(),
    camera: LiveCameraOptions = LiveCameraOptions(),
    instrument: UrdfOptions = UrdfOptions(),
    method: LiveMethod = LiveMethod(),
    output: LiveOutput = LiveOutput(),
) -> int:
    """Follow the instruments of a running robot: images and readings from ROS topics, poses to ROS topics.

    The topics are read and written through a rosbridge server (`ros2 launch rosbridge_server
    rosbridge_websocket_launch.xml`), so that no ROS is needed here. Of the images only the newest is followed. A lost
    connection is opened again. One line says how it goes. `dvrk-cmaes help live` lists the topics that are published,
    and what to expect.

    Exit codes: 0 ended by Ctrl-C or --seconds, also if no pose was ok (the last line has their number), 1 nothing to
    follow within 10 s, 2 wrong usage or input.

    Example:

    ```
    dvrk-cmaes live --image-topic /left/image/compressed --mask-topic /left/mask
    ```

    Parameters
    ----------
    topics
        The topics.
    server
        How ROS is reached.
    camera
        The camera.
    instrument
        The instrument.
    method
        A calibration that is used, base, offsets and lag, and settings.
    output
        What is written and published, and for how long.
    """
    if not output.seconds > 0:
        raise InputError(f"--seconds: expected a time above 0, got {output.seconds:g}")
    from dvrk_cmaes.live.connection import LogThrottle
    from dvrk_cmaes.live.follow import follow
    from dvrk_cmaes.results.folder import SESSION
    from dvrk_cmaes.runs.live_session import prepare_long_run

    topics.of_arms(topics.psm)  # wrong usage is said before what is not installed
    connection = server.connection(LogThrottle(note))  # of the connection; follow has its own
    stopping = stopping_on_interrupt("", seconds=output.seconds)
    with _described(topics, camera, instrument, method, output) as setup, stopping as stop, shown_state() as shown:
        prepare_long_run()
        connection.open(timeout=2.0)
        begin_within = math.inf if server.wait else _FIRST_IMAGE
        try:
            counts = follow(setup, connection, note, stop, show=shown, begin_within=begin_within)
        finally:
            connection.close()
    show([Line(counts.in_words)])
    written = () if output.out is None else sorted(output.out.rglob(SESSION))
    show(Line(f"written: {path}") for path in written)
    if output.out is not None and len(written) < len(topics.psm):
        missing = f"{len(topics.psm) - len(written)} of {len(topics.psm)}"
        why = "the calibration of --session was used" if method.calibration else "keyframes have not determined a base"
        note(f"{output.out}: {SESSION} of {missing} arms not written: {why}")
    return 0


@contextmanager
def _described(
    topics: LiveTopics, camera: LiveCameraOptions, instrument: UrdfOptions, method: LiveMethod, output: LiveOutput
) -> Iterator[LiveSetup]:
    """Say what is followed, and how; the folders that are written to are open meanwhile."""
    from dvrk_cmaes.export.frames import FrameNames
    from dvrk_cmaes.io.json_file import write_json
    from dvrk_cmaes.io.output import output as folder_of_command
    from dvrk_cmaes.live.follow import ArmSetup, LiveSetup
    from dvrk_cmaes.results.folder import SESSION
    from dvrk_cmaes.runs.pool import Pool
    from dvrk_cmaes.runs.solver_process import SolverProcess

    if len(set(topics.psm)) < len(topics.psm):
        raise InputError(f"--psm: expected different arms, got {', '.join(topics.psm)}")
    method.check_for(topics.psm)
    inputs = topics.of_arms(topics.psm)
    names = {arm: FrameNames(arm, topics.camera_frame, f"{arm}_base") for arm in topics.psm}
    for of_arm in names.values():
        of_arm.check_tf()
    body = instrument.load()
    if output.out is not None and method.lag is not None:
        raise InputError("--out: expected no --lag: the calibration that is found has a lag of its own")
    rig, settings, arms = camera.rig(inputs), MethodOptions(config=method.config).resolve(), []
    with ExitStack() as stack:
        if output.out is not None:
            stack.enter_context(folder_of_command(output.out, "live"))
        for arm in topics.psm:
            known = method.read(body, instrument.arm, arm)
            folder = None if output.out is None else output.out / (arm if len(topics.psm) > 1 else "")
            if folder is not None:
                stack.enter_context(folder_of_command(folder, "live")).refuse((SESSION,))
            solver = partial(SolverProcess, body, background=True)
            save = None if folder is None else partial(write_json, folder / SESSION)
            arms.append(ArmSetup(names[arm], body, instrument.kinematics, known, solver, save, settings, method.lag))
        yield LiveSetup(inputs, tuple(arms), rig, camera.rectified, output.overlay, lambda: Pool(int, 1).begin())


@contextmanager
def shown_state(*, renewed: float = _RENEWED, lines: float = _LINES) -> Iterator[Callable[[Callable[[], str]], None]]:
    """Yield a function that shows the state: on a terminal in one line that is renewed, elsewhere in new lines.

    It is shown again after ``renewed`` or ``lines``, s.
    """
    from rich.console import Console
    from rich.live import Live
    from rich.text import Text

    console, last = Console(stderr=True), time.monotonic()
    with Live(console=console, auto_refresh=False, transient=not console.is_terminal) as line:

        def show_due(state: Callable[[], str]) -> None:
            nonlocal last
            now = time.monotonic()
            if now - last < (renewed if console.is_terminal else lines):
                return
            last = now
            if console.is_terminal:
                line.update(Text(state(), no_wrap=True, overflow="ellipsis"), refresh=True)
            else:
                note(state())

        yield show_due
