"""``live --rehearse``: a recording played through the loop of ``live`` by its own clock, beside ``track``."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, nullcontext
from dataclasses import dataclass, field
from functools import cached_property, partial
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from dvrk_cmaes.calibration.document import SessionCalibration
from dvrk_cmaes.cli.options import DEFAULT_READING, CameraOptions, InstrumentOptions
from dvrk_cmaes.cli.session_tools import session_tools
from dvrk_cmaes.cli.terminal import Line, note
from dvrk_cmaes.cli.track_source import DEFAULT_VIDEO, Source
from dvrk_cmaes.config import EstimateConfig
from dvrk_cmaes.errors import InputError
from dvrk_cmaes.export.frames import FrameNames
from dvrk_cmaes.export.ros_messages import header
from dvrk_cmaes.geometry import Float64, change_between
from dvrk_cmaes.joints.interpolation import NANOSECONDS
from dvrk_cmaes.live.connection import Connection
from dvrk_cmaes.live.follow import ArmSetup, LiveSetup
from dvrk_cmaes.live.inputs import EyeTopics, Inputs, InputTopics
from dvrk_cmaes.live.repeated_lines import RepeatedLines
from dvrk_cmaes.runs.exchanged_tools import ArmInSession
from dvrk_cmaes.runs.solver_process import SolverProcess
from dvrk_cmaes.runs.track_clock import FRAMES_A_SECOND, TrackClock
from dvrk_cmaes.runs.track_frames import (
    TrackSettings,
    files_of_views,
    followed,
    read_arrays,
    used_session,
    with_increasing_times,
)
from dvrk_cmaes.silhouette import Body
from dvrk_cmaes.track.solution_schedule import SolutionSchedule
from dvrk_cmaes.track.view_segmenter import EvidenceKind

_SAME_TIME: Final = 1e-9  # s, as in `track`
CalibrationOf = Callable[[str, Body], SessionCalibration | None]
"""Returns the calibration that is given for an arm and its instrument."""


@dataclass(frozen=True, eq=False)
class Rehearsed:
    """A recording as a robot would send it: its arms by name, and the evidence that is used."""

    arms: Mapping[str, ArmInSession]
    evidence: EvidenceKind | None

    @staticmethod
    def read(path: Path, arm: str, instrument: InstrumentOptions, camera: CameraOptions, scratch: Path) -> Rehearsed:
        """Read a session folder, a video or a ROS recording; ``arm`` names its only one, ``scratch`` is a folder.

        Raises
        ------
        InputError
            There is no recording at the path, or something in it is not valid.
        """
        source = Source.of(path, None, scratch, camera=camera.camera, joints=None, follow_links=False)
        arms, used = {}, None
        for name, tool in session_tools(source.folder, instrument).items():
            own = source.read(tool, camera, DEFAULT_VIDEO, joints=(), reading=DEFAULT_READING, ahead=False)
            session, used = used_session(with_increasing_times(own.session)[0], None)
            arms[name or arm] = ArmInSession(session, own.body, own.kinematics)
        return Rehearsed(arms, used)

    @property
    def masked(self) -> bool:
        """Whether there are masks of all frames."""
        return self.evidence == "masks"

    @cached_property
    def clocks(self) -> dict[str, TrackClock]:
        """Times of frames and readings by arm."""
        return {
            name: TrackClock.of(arm.session, arm.session.frames, FRAMES_A_SECOND) for name, arm in self.arms.items()
        }

    @cached_property
    def topics(self) -> InputTopics:
        """The topics, in a namespace for each eye."""
        session, eyes = next(iter(self.arms.values())).session, {}
        for eye in session.rig.names:
            masks = {arm: f"/{eye}/{arm}/mask" for arm in self.arms} if self.masked else {}
            has_images = any(files.of_views(session.rig)[eye].has_image for files in session.frames)
            eyes[eye] = EyeTopics(f"/{eye}/image" if has_images else "", f"/{eye}/camera_info", masks)
        return InputTopics(eyes, {arm: (f"/{arm}/measured_js",) for arm in self.arms})

    def settings(self, arm: str, config: EstimateConfig, lag: float | None, known: CalibrationOf) -> TrackSettings:
        """Return the settings with which ``track --causal`` follows an arm."""
        own, read = self.arms[arm], self.clocks[arm].outer_read
        given = known(arm, own.body)
        return TrackSettings(config, own.kinematics, given, lag, causal=True, evidence=self.evidence, outer_read=read)

    def arrays(self, number: int) -> Iterator[tuple[str, NDArray[np.uint8]]]:
        """Yield the image and masks of a frame by topic: (H, W, 3) BGR, and (H, W) of 0 and 255.

        Raises
        ------
        InputError
            A file of the frame is wrong.
        """
        topics = self.topics
        shown = set[str]()
        for arm, own in self.arms.items():
            files = own.session.frames[number]
            if files.problem is not None:
                raise InputError(files.problem)
            for eye, of_eye in files_of_views(files, own.session.rig).items():
                image, mask, _ = read_arrays(of_eye, own.session.rig.view(eye).camera)
                if image is not None and eye not in shown:
                    shown.add(eye)
                    yield topics.eyes[eye].image, image
                if mask is not None and self.masked:
                    yield topics.eyes[eye].masks[arm], np.asarray(255 * mask, np.uint8)

    def messages(self) -> Iterator[tuple[int, dict[str, dict[str, Any]]]]:
        """Yield the messages of each time, ns, by topic, in the order of their times: readings before images."""
        rows = self._rows
        done = 0
        for number, (time, stamp) in enumerate(zip(self._times, self.stamps, strict=True)):
            while done < len(rows) and rows[done][0] <= time + _SAME_TIME:
                read, arm, joints = rows[done]
                done += 1
                at = self._stamp(read)
                fields = {"header": header(at), "name": list(joints), "position": list(joints.values())}
                yield at, {self.topics.joints[arm][0]: fields}
            yield stamp, {topic: _image(stamp, array) for topic, array in self.arrays(number)}

    @cached_property
    def _rows(self) -> list[tuple[float, str, dict[str, float]]]:
        """The readings of all arms in the order of their times, s."""
        rows = [(time, arm, joints) for arm, own in self.clocks.items() for time, joints in own.readings]
        return sorted(rows, key=lambda row: row[0])

    @property
    def _times(self) -> list[float]:
        """The times of the frames, s."""
        arm, clock = next(iter(self.clocks.items()))
        return [clock.times[files.name] for files in self.arms[arm].session.frames]

    @property
    def stamps(self) -> list[int]:
        """The times of the frames as they are sent, ns."""
        return [self._stamp(time) for time in self._times]

    @cached_property
    def origin(self) -> int:
        """The time, ns, by which what is sent is later: a second, since a time of 0 is none, or more, before that."""
        first = min(0.0, *self._times[:1], *(row[0] for row in self._rows[:1]))
        return (1 - math.floor(first)) * NANOSECONDS

    def _stamp(self, time: float) -> int:
        """Return a time, s, as it is sent, ns."""
        return round(time * NANOSECONDS) + self.origin


def _image(stamp: int, array: NDArray[np.uint8]) -> dict[str, Any]:
    """Return the fields of an Image."""
    height, width = array.shape[:2]
    encoding, step = ("mono8", width) if array.ndim == 2 else ("bgr8", 3 * width)
    size = {"width": width, "height": height, "step": step, "encoding": encoding}
    return {"header": header(stamp), **size, "data": array.tobytes()}


@dataclass(eq=False)
class Stage(Connection):
    """A connection within this process, which has the clock of what is sent, and counts what is published.

    ``stamp`` is the time of what was sent last, ns; ``poses`` (4, 4) and ``statuses`` are by arm and time, ns.
    """

    name: str = "rehearsal"
    stamp: int = 0
    published: Counter[str] = field(default_factory=Counter)
    poses: dict[str, dict[int, Float64]] = field(default_factory=dict)
    statuses: dict[str, dict[int, str]] = field(default_factory=dict)

    @property
    def now(self) -> float:
        """The time of what was sent last, s."""
        return self.stamp / NANOSECONDS

    def advertise(self, topic: str, kind: str) -> None:
        """Begin to count the messages of a topic."""
        self.published[topic] = 0

    def publish(self, topic: str, fields: Mapping[str, Any]) -> bool:
        """Count a message, and keep the pose or status in it."""
        self.published[topic] += 1
        if topic.endswith("/camera_from_root"):
            position, orientation = fields["pose"]["position"], fields["pose"]["orientation"]
            pose = np.eye(4)
            pose[:3, :3] = Rotation.from_quat([orientation[axis] for axis in "xyzw"]).as_matrix()
            pose[:3, 3] = [position[axis] for axis in "xyz"]
            self.poses.setdefault(topic.split("/")[2], {})[self.stamp] = pose
        elif topic == "/diagnostics":
            (status,) = fields["status"]
            self.statuses.setdefault(status["hardware_id"], {})[self.stamp] = status["message"]
        return True

    def send(self, stamp: int, messages: Mapping[str, Mapping[str, Any]]) -> None:
        """Send the messages of a time, ns."""
        self.stamp = stamp
        for topic, fields in messages.items():
            self.receivers[topic](fields)


def play(
    recorded: Rehearsed,
    camera_frame: str,
    config: EstimateConfig,
    *,
    lag: float | None = None,
    calibration: CalibrationOf = lambda arm, body: None,
    overlay: bool = False,
    show: Callable[[Callable[[], str]], None] = lambda text: None,
) -> tuple[list[Line], bool]:
    """Play a recording through the loop, and follow it as ``track --causal``; returns lines, and whether all are ok.

    Raises
    ------
    InputError
        A file of a frame is wrong.
    """
    stage, lines = Stage(stamp=recorded.stamps[0]), list[Line]()
    settings = {arm: recorded.settings(arm, config, lag, calibration) for arm in recorded.arms}
    with ExitStack() as stack:
        arms = []
        for arm, own in recorded.arms.items():
            names, known = FrameNames(arm, camera_frame, f"{arm}_base"), settings[arm].calibration
            solver = partial(SolverProcess, own.body.instrument) if settings[arm].keeps_keyframes else None
            arms.append(ArmSetup(names, own.body, own.kinematics, known, solver))
        rig = next(iter(recorded.arms.values())).session.rig
        setup = LiveSetup(
            recorded.topics, tuple(arms), config, lag, rig, overlay=overlay, waits=True, origin=recorded.origin
        )
        say = RepeatedLines(note)
        loop = setup.loop(Inputs(setup.topics, say, now=lambda: stage.now), stage, say, stack, show)
        for stamp, messages in recorded.messages():
            stage.send(stamp, messages)
            loop.turn()
        counts = loop.counts
    done = f"{counts.followed} images followed, {counts.published} results published, {counts.refused} refused"
    lines.append(Line(done, "bold"))
    note("following the recording as track --causal")
    lines += [Line(f"{topic}: {count}") for topic, count in sorted(stage.published.items()) if count]
    for arm in recorded.arms:
        lines += _compared(recorded, arm, stage, settings[arm])
    ok = all(stage.statuses[arm].get(stamp) == "ok" for arm in recorded.arms for stamp in recorded.stamps)
    return lines, ok


def _compared(recorded: Rehearsed, arm: str, stage: Stage, settings: TrackSettings) -> list[Line]:
    """Follow an arm as ``track --causal``, and say how far what was published is from that."""
    own = recorded.arms[arm]
    tracker = settings.tracker(own.session.rig, own.body)
    solving = SolverProcess(own.body.instrument) if settings.keeps_keyframes else nullcontext()
    same, apart, tracked, ok = 0, list[float](), 0, 0
    with solving as solver:
        results = followed(
            tracker,
            own.session.frames,
            recorded.clocks[arm],
            own.session.rig,
            with_images=not recorded.masked,
            schedule=None if solver is None else SolutionSchedule(tracker, solver),
        )
        for stamp, (_, result) in zip(recorded.stamps, results, strict=True):
            tracked += 1
            status = stage.statuses.get(arm, {}).get(stamp)
            same, ok = same + (status == result.status), ok + (status == "ok")
            pose = stage.poses.get(arm, {}).get(stamp)
            if pose is not None and result.camera_from_root is not None and result.covariance is not None:
                std = np.sqrt(np.diag(result.covariance)[:6])
                apart.append(float(np.max(np.abs(change_between(result.camera_from_root, pose)) / std)))
    if not apart:
        return [Line(f"{arm}: no poses")]
    median, largest = np.median(apart), np.max(apart)
    return [
        Line(f"{arm}: " + ", ".join(filter(None, (f"{len(apart)} poses", f"{ok} ok", tracker.base_state)))),
        Line(f"{arm}: track --causal has the same status in {same} of {tracked} images"),
        Line(f"{arm}: its poses differ by {median:.2g} standard deviations (median), {largest:.2g} at most"),
    ]
