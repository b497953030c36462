"""The topics that are read: the newest frame of all eyes and arms, the readings since the last one, and the cameras."""

from __future__ import annotations

import time as clock
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.camera import Camera, Rig
from dvrk_cmaes.errors import InputError, one_line
from dvrk_cmaes.frames.frame import with_tool
from dvrk_cmaes.geometry import Bool
from dvrk_cmaes.joints.interpolation import NANOSECONDS
from dvrk_cmaes.joints.names import ECM_JOINTS
from dvrk_cmaes.live.connection import LARGEST_IMAGE, LARGEST_MESSAGE, Connection, Mailbox, Report
from dvrk_cmaes.live.messages import JointMessage, read_joint_message, read_pixels, read_rig, read_stamp
from dvrk_cmaes.recording.topics import camera_info_of

Fields = Mapping[str, Any]

_MOST_READINGS: Final = 1000  # of two topics of 100 Hz, those of five seconds
_MOST_WAITING: Final = 8  # times of an eye that wait for the rest of their frame
_FARTHEST: Final = NANOSECONDS // 100  # ns, between the images of two eyes, as in recordings

_IMAGE, _COMPRESSED = "sensor_msgs/Image", "sensor_msgs/CompressedImage"
_CAMERA_INFO, _JOINT_STATE = "sensor_msgs/CameraInfo", "sensor_msgs/JointState"
_THRESHOLD: Final = 127  # of a mask


@dataclass(frozen=True)
class EyeTopics:
    """Topics of an eye: its images, its camera, and those of each arm's masks, with the times of their images.

    Image topics named ``compressed`` are of CompressedImage, as in image_transport, others of Image. With masks,
    ``image`` may be empty: none is read then.
    """

    image: str
    camera: str
    masks: Mapping[str, str] = field(default_factory=dict)

    @staticmethod
    def of(image: str, camera: str | None = None, masks: Mapping[str, str] | None = None) -> EyeTopics:
        """Return the topics of an eye; the camera's is by default ``camera_info`` in the namespace of the images."""
        return EyeTopics(image, camera or camera_info_of(image), masks or {})

    def remarked(self, camera: Camera, *, rectified: bool) -> Camera:
        """Return a camera with a remark if the topic's name says of images that they are rectified, or are not.

        Without distortion it is the same whether they are.
        """
        words = self.image.removesuffix("/compressed").rpartition("/")[2].split("_")
        text = ""
        if "rect" in words and not (rectified or camera.is_pinhole):
            text = "its images are rectified, by its name: --rectified uses the camera of such images"
        elif "raw" in words and rectified:
            text = "its images are not rectified, by its name, but --rectified says so"
        return replace(camera, remarks=(*camera.remarks, f"{self.image}: {text}")) if text else camera

    @property
    def evidence(self) -> tuple[str, ...]:
        """The topics that a frame needs: those of masks, or else that of images."""
        return tuple(self.masks.values()) or (self.image,)

    @property
    def of_frames(self) -> dict[str, str]:
        """The types of the topics of images and masks, by name."""
        return {topic: image_kind(topic) for topic in (self.image, *self.masks.values()) if topic}


@dataclass(frozen=True)
class InputTopics:
    """Names of the topics by eye, the first of which is the reference, and those of readings by arm.

    ``endoscope`` is the topic of the readings of the arm that holds the endoscope.
    """

    eyes: Mapping[str, EyeTopics]
    joints: Mapping[str, tuple[str, ...]]
    endoscope: str | None = None

    @property
    def masked(self) -> bool:
        """Whether there are masks."""
        return any(eye.masks for eye in self.eyes.values())

    @property
    def of_frames(self) -> dict[str, str]:
        """The types of the topics without which nothing can be followed, by name."""
        return {topic: kind for eye in self.eyes.values() for topic, kind in eye.of_frames.items()}

    @property
    def of_cameras(self) -> dict[str, str]:
        """The types of the topics of the cameras, by name."""
        return {eye.camera: _CAMERA_INFO for eye in self.eyes.values()}

    @property
    def timed(self) -> tuple[str, ...]:
        """The topics that are expected to send messages all the time."""
        return (*self.of_frames, *(topic for topics in self.joints.values() for topic in topics))


@dataclass(frozen=True, eq=False)
class Decoded:
    """The arrays of a frame: images by eye, (H, W, 3) BGR or (H, W) grey, and masks (H, W) by arm and eye."""

    images: Mapping[str, NDArray[np.uint8]]
    masks: Mapping[str, Mapping[str, Bool]]

    def ignored(self, arm: str) -> dict[str, Bool]:
        """Return the pixels of the other arms, and beside them, by eye: they are not known to be in front or behind."""
        found: dict[str, Bool] = {}
        for other, masks in self.masks.items():
            for eye, mask in masks.items() if other != arm else ():
                found[eye] = with_tool(found.get(eye), mask)
        return found

    @property
    def sizes(self) -> dict[str, tuple[int, int]]:
        """Height and width by eye."""
        arrays: list[Mapping[str, NDArray[Any]]] = [self.images, *self.masks.values()]
        return {eye: (array.shape[0], array.shape[1]) for of_eyes in arrays for eye, array in of_eyes.items()}


@dataclass(frozen=True, eq=False)
class LiveFrame:
    """A frame that was received: its time, ns, and the fields of its messages by eye and topic.

    ``received`` is when the first message came, on the clock of the inputs, s.
    """

    time: int
    topics: InputTopics
    received: float
    parts: Mapping[str, Mapping[str, Fields]]

    @property
    def topic(self) -> str:
        """The topic that messages on the frame name."""
        return next(iter(self.topics.eyes.values())).evidence[0]

    def decoded(self, *, grey: bool = False) -> Decoded:
        """Decode all messages, images to ``grey`` ones if that is asked for; InputError if one is not valid.

        An image of another size than its mask is resized.
        """
        images, masks = dict[str, NDArray[np.uint8]](), dict[str, dict[str, Bool]]()
        for eye, fields in self.parts.items():
            topics, size = self.topics.eyes[eye], None
            for arm, topic in topics.masks.items():
                if topic in fields:
                    mask = np.asarray(read_pixels(topic, fields[topic], grey=True) > _THRESHOLD)
                    masks.setdefault(arm, {})[eye], size = mask, mask.shape[::-1]
            if topics.image in fields:
                pixels = read_pixels(topics.image, fields[topics.image], grey=grey)
                if size is not None and pixels.shape[1::-1] != size:
                    pixels = np.asarray(cv2.resize(pixels, size, interpolation=cv2.INTER_AREA), np.uint8)
                images[eye] = pixels
        return Decoded(images, masks)


class Inputs:
    """Receives the messages of the topics; a message that is not valid is reported in one line and dropped.

    ``frames`` has the newest frame, ``readings`` by arm those not taken yet, ``rigs`` the newest cameras. A frame has
    the masks of all arms, or else the images, of all eyes, taken within 10 ms; with masks, it has the images of the
    same times if they came before them. Topics that are silent are not waited for.

    Parameters
    ----------
    topics, report
        The topics; takes lines for the user.
    rectified
        Which of the cameras' matrices is used.
    longest_silence
        Time without a message after which a topic is reported, and not waited for, s.
    now
        The clock, s.
    """

    def __init__(
        self,
        topics: InputTopics,
        report: Report,
        *,
        rectified: bool = False,
        longest_silence: float = 1.0,
        now: Callable[[], float] = clock.monotonic,
    ) -> None:
        self.topics = topics
        self.frames = Mailbox[LiveFrame]()
        self.readings = {arm: Mailbox[JointMessage](_MOST_READINGS) for arm in topics.joints}
        self.rigs = Mailbox[Rig]()
        self.now = now
        self._report = report
        self.rectified = rectified
        self._longest_silence = longest_silence
        self._infos: dict[str, Fields] = {}
        # what has come of an eye by time: when first, and the fields by topic
        self._parts: dict[str, dict[int, tuple[float, dict[str, Fields]]]] = {eye: {} for eye in topics.eyes}
        self._heard: dict[str, float] = {}
        self._began: float | None = None  # s, when silence was looked for first
        self._first: float | None = None  # s, when the first part of a frame came
        self._silent: dict[str, str] = {}  # topics, and what is said when they are heard

    def subscribe(self, connection: Connection) -> None:
        """Subscribe to all topics; answers on the connection are as of the ROS that its images come from."""
        self._connection = connection
        for name, eye in self.topics.eyes.items():
            for topic, kind in eye.of_frames.items():
                self._subscribe(topic, kind, partial(self._on_part, name, topic))
            self._subscribe(eye.camera, _CAMERA_INFO, partial(self._on_camera, name))
        for arm, topics in self.topics.joints.items():
            for topic in topics:
                self._subscribe(topic, _JOINT_STATE, partial(self._on_joints, topic, [self.readings[arm]]))
        if (endoscope := self.topics.endoscope) is not None:
            take = partial(self._on_joints, endoscope, [*self.readings.values()])
            self._subscribe(endoscope, _JOINT_STATE, take)

    def _subscribe(self, topic: str, kind: str, take: Callable[[Fields], None]) -> None:
        """Subscribe to a topic; whatever is wrong with a message costs that message and a line."""

        def receive(fields: Fields) -> None:
            try:
                take(fields)
            except InputError as error:
                self._report(str(error))
            except Exception as error:
                self._report(f"{topic}: a message that cannot be read: {one_line(error)}")

        largest = LARGEST_IMAGE if kind in (_IMAGE, _COMPRESSED) else LARGEST_MESSAGE
        self._connection.subscribe(topic, kind, receive, largest=largest, newest=kind != _JOINT_STATE)

    def unheard(self, topics: Sequence[str]) -> list[str]:
        """Return those of some topics that no message has come of."""
        return [topic for topic in topics if topic not in self._heard]

    def report_silence(self) -> tuple[str, ...]:
        """Report each topic once when it is silent, and once when it is heard again; returns those that are silent.

        Topics count from the first call with a connection; nothing is reported without one.
        """
        now = self.now()
        if self._began is None or not self._connection.connected:
            self._began = now
        for topic in self.topics.timed:
            quiet = now - max(self._heard.get(topic, self._began), self._began)
            if quiet > self._longest_silence and topic not in self._silent:
                self._silent[topic] = "messages again" if topic in self._heard else "first message"
                self._report(f"{topic}: no message for {quiet:.1f} s")
            elif quiet <= self._longest_silence and topic in self._silent:
                said = self._silent.pop(topic)
                if now - self._heard.get(topic, -np.inf) <= self._longest_silence:  # else the connection was lost
                    self._report(f"{topic}: {said}")
        return tuple(topic for topic in self.topics.timed if topic in self._silent)

    def _on_part(self, eye: str, topic: str, fields: Fields) -> None:
        """Keep an image or a mask; where a frame has all of its parts, it is the newest one."""
        (time, self._connection.ros1), now = read_stamp(topic, fields), self.now()
        self._heard[topic] = now
        self._first = now if self._first is None else self._first
        of_eye = self._parts[eye]
        of_eye.setdefault(time, (now, {}))[1][topic] = fields
        if len(of_eye) > _MOST_WAITING:
            del of_eye[next(iter(of_eye))]
        frame = self._whole_frame(now)
        if frame is not None:
            self.frames.put(frame)

    def _whole_frame(self, now: float) -> LiveFrame | None:
        """Return the newest frame that has all of its parts, and forget those and older ones; None without one."""
        assert self._first is not None
        whole: dict[str, list[int]] = {}
        for name, eye in self.topics.eyes.items():
            needed = {
                topic for topic in eye.evidence if now - self._heard.get(topic, self._first) <= self._longest_silence
            }
            if needed:
                whole[name] = [time for time, (_, fields) in self._parts[name].items() if needed <= fields.keys()]
        if not whole:
            return None
        reference, *others = whole
        for time in sorted(whole[reference], reverse=True):
            near = {eye: min(whole[eye], key=lambda other: abs(other - time), default=0) for eye in others}
            if all(abs(other - time) <= _FARTHEST for other in near.values()):
                return self._taken({reference: time, **near})
        return None

    def _taken(self, times: Mapping[str, int]) -> LiveFrame:
        """Return the frame of times by eye, the reference first, and forget its parts and older ones."""
        parts, first = {eye: self._parts[eye][time] for eye, time in times.items()}, next(iter(times.values()))
        for name, of_eye in self._parts.items():
            for time in [time for time in of_eye if time <= times.get(name, first)]:
                del of_eye[time]
        received = min(first_came for first_came, _ in parts.values())
        return LiveFrame(first, self.topics, received, {eye: fields for eye, (_, fields) in parts.items()})

    def _on_joints(self, topic: str, mailboxes: Sequence[Mailbox[JointMessage]], fields: Fields) -> None:
        """Give readings to the arms they are of; whole ones of the endoscope's arm to all, with their own."""
        readings = read_joint_message(topic, fields)
        self._heard[topic] = self.now()
        if topic == self.topics.endoscope:
            joints = {f"ecm_{name}": value for name, value in readings.joints.items() if f"ecm_{name}" in ECM_JOINTS}
            readings = replace(readings, joints=joints if len(joints) == len(ECM_JOINTS) else {})
        for mailbox in mailboxes if readings.joints else ():  # there are none before an arm is up
            mailbox.put(readings)

    def _on_camera(self, eye: str, fields: Fields) -> None:
        """Keep the cameras of all eyes where one is another than before."""
        topic = self.topics.eyes[eye].camera
        self._heard[topic] = self.now()
        known = {name: value for name, value in fields.items() if name != "header"}
        if self._infos.get(eye) == known:
            return
        self._infos[eye] = known
        if len(self._infos) == len(self.topics.eyes):
            of_eyes = {self.topics.eyes[name].camera: self._infos[name] for name in self.topics.eyes}
            self.rigs.put(read_rig(of_eyes, rectified=self.rectified))


def image_kind(topic: str) -> str:
    """Return the type of a topic of images, by its name."""
    return _COMPRESSED if topic.rpartition("/")[2] == "compressed" else _IMAGE
