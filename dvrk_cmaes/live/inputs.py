"""The topics that are read: the newest frame, the readings since the last frame, and the camera."""

from __future__ import annotations

import time as clock
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.camera import Camera
from dvrk_cmaes.errors import InputError, one_line
from dvrk_cmaes.live.connection import LARGEST_IMAGE, LARGEST_MESSAGE, Connection, Report
from dvrk_cmaes.live.mailbox import Mailbox
from dvrk_cmaes.live.messages import JointMessage, read_camera, read_joint_message, read_pixels, read_stamp

_MOST_READINGS: Final = 1000  # of two topics of 100 Hz, those of five seconds
_MOST_IMAGES: Final = 8  # that wait for their masks
_MOST_WAITING: Final = 2 * LARGEST_IMAGE  # bytes of these, beside the newest

_IMAGE, _COMPRESSED = "sensor_msgs/Image", "sensor_msgs/CompressedImage"
_CAMERA_INFO, _JOINT_STATE = "sensor_msgs/CameraInfo", "sensor_msgs/JointState"
_THRESHOLD: Final = 127  # of a mask


@dataclass(frozen=True)
class InputTopics:
    """Names of the topics; ``mask`` is one of masks that a segmenter publishes, with the times of their images.

    Image topics named ``compressed`` are of CompressedImage, as in image_transport, others of Image.
    """

    image: str
    camera: str
    joints: tuple[str, ...]
    mask: str | None = None

    @property
    def timed(self) -> tuple[str, ...]:
        """The topics that are expected to send messages all the time."""
        return self.image, *(() if self.mask is None else (self.mask,)), *self.joints


@dataclass(frozen=True, eq=False)
class LiveFrame:
    """A frame that was received: its time, ns, whether that was written as in ROS 1, and the fields of its messages."""

    time: int
    ros1: bool
    topics: InputTopics
    image_fields: Mapping[str, Any] | None
    mask_fields: Mapping[str, Any] | None = None

    def pixels(self, *, grey: bool = False) -> NDArray[np.uint8] | None:
        """Decode the image, (H, W, 3) BGR or (H, W) grey; None if there is none, InputError if it is not valid."""
        return None if self.image_fields is None else read_pixels(self.topics.image, self.image_fields, grey=grey)

    def mask(self) -> NDArray[np.bool_] | None:
        """Decode the mask, (H, W); None if there is no topic of masks, InputError if it is not valid."""
        if self.topics.mask is None or self.mask_fields is None:
            return None
        return np.asarray(read_pixels(self.topics.mask, self.mask_fields, grey=True) > _THRESHOLD)


class Inputs:
    """Receives the messages of the topics; a message that is not valid is reported in one line and dropped.

    ``frames`` has the newest frame, ``readings`` those not taken yet, ``cameras`` the newest camera. With a topic of
    masks, a frame is a mask, with the image of the same time if that came before it.
    """

    def __init__(self, topics: InputTopics, report: Report, *, rectified: bool = False) -> None:
        self.topics = topics
        self.frames = Mailbox[LiveFrame]()
        self.readings = Mailbox[JointMessage](_MOST_READINGS)
        self.cameras = Mailbox[Camera]()
        self._report = report
        self._rectified = rectified
        self._images: dict[int, Mapping[str, Any]] = {}
        self._heard: dict[str, float] = {}
        self._silent: set[str] = set()

    def subscribe(self, connection: Connection) -> None:
        """Subscribe to all topics."""
        topics = self.topics
        self._subscribe(connection, topics.image, _image_kind(topics.image), self._on_image, largest=LARGEST_IMAGE)
        if topics.mask is not None:
            self._subscribe(connection, topics.mask, _image_kind(topics.mask), self._on_mask, largest=LARGEST_IMAGE)
        self._subscribe(connection, topics.camera, _CAMERA_INFO, self._on_camera)
        for topic in topics.joints:
            self._subscribe(connection, topic, _JOINT_STATE, partial(self._on_joints, topic), newest=False)

    def _subscribe(
        self,
        connection: Connection,
        topic: str,
        kind: str,
        take: Callable[[Mapping[str, Any]], None],
        *,
        largest: int = LARGEST_MESSAGE,
        newest: bool = True,
    ) -> None:
        """Subscribe to a topic; whatever is wrong with a message costs that message and a line."""

        def receive(fields: Mapping[str, Any]) -> None:
            try:
                take(fields)
            except InputError as error:
                self._report(str(error))
            except Exception as error:
                self._report(f"{topic}: a message that cannot be read: {one_line(error)}")

        connection.subscribe(topic, kind, receive, largest=largest, newest=newest)

    def report_silence(self, longest: float) -> tuple[str, ...]:
        """Report each topic once when it has been silent for ``longest`` seconds, and once when it is heard again.

        Topics that were never heard count from the first call. Returns the topics that are silent.
        """
        now = clock.monotonic()
        for topic in self.topics.timed:
            quiet = now - self._heard.setdefault(topic, now)
            if quiet > longest and topic not in self._silent:
                self._silent.add(topic)
                self._report(f"{topic}: no message for {quiet:.1f} s")
            elif quiet <= longest and topic in self._silent:
                self._silent.discard(topic)
                self._report(f"{topic}: messages again")
        return tuple(topic for topic in self.topics.timed if topic in self._silent)

    def _on_image(self, fields: Mapping[str, Any]) -> None:
        frame = self._frame(self.topics.image, fields, image_fields=fields)
        if self.topics.mask is None:
            self.frames.put(frame)
            return
        self._images[frame.time] = fields
        while len(self._images) > _MOST_IMAGES or (len(self._images) > 1 and self._waiting() > _MOST_WAITING):
            del self._images[next(iter(self._images))]

    def _waiting(self) -> int:
        """Return the bytes of the images that wait for their masks."""
        return sum(len(fields.get("data", ())) for fields in self._images.values())

    def _on_mask(self, fields: Mapping[str, Any]) -> None:
        assert self.topics.mask is not None
        frame = self._frame(self.topics.mask, fields, mask_fields=fields)
        self.frames.put(replace(frame, image_fields=self._images.pop(frame.time, None)))

    def _frame(
        self,
        topic: str,
        fields: Mapping[str, Any],
        image_fields: Mapping[str, Any] | None = None,
        mask_fields: Mapping[str, Any] | None = None,
    ) -> LiveFrame:
        """Note that a topic was heard, and make a frame of a message; InputError if its time is not valid."""
        stamp = read_stamp(topic, fields)
        self._heard[topic] = clock.monotonic()
        return LiveFrame(stamp.time, stamp.ros1, self.topics, image_fields, mask_fields)

    def _on_joints(self, topic: str, fields: Mapping[str, Any]) -> None:
        readings = read_joint_message(topic, fields)
        self._heard[topic] = clock.monotonic()
        if readings.joints:  # there are none before an arm is up
            self.readings.put(readings)

    def _on_camera(self, fields: Mapping[str, Any]) -> None:
        self.cameras.put(read_camera(self.topics.camera, fields, rectified=self._rectified))


def _image_kind(topic: str) -> str:
    """Return the type of a topic of images, by its name."""
    return _COMPRESSED if topic.rpartition("/")[2] == "compressed" else _IMAGE
