"""Conversion of messages of plain values, with bytes as they are or in base64, to arrays, readings and cameras.

Errors are `InputError`, one line that begins with the topic.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any, get_args

import cv2
import numpy as np
from msgspec import Meta, Struct
from numpy.typing import NDArray

from dvrk_cmaes.camera import Camera, Rig
from dvrk_cmaes.camera.document import read_fields
from dvrk_cmaes.camera.fields import Side
from dvrk_cmaes.camera.stereo import pose_of_camera_infos
from dvrk_cmaes.errors import InputError
from dvrk_cmaes.frames.images import decode_image
from dvrk_cmaes.io.short_text import shown
from dvrk_cmaes.io.typed_document import Count, Number, Texts, convert_document
from dvrk_cmaes.joints.interpolation import NANOSECONDS
from dvrk_cmaes.joints.names import joint_reading
from dvrk_cmaes.recording.messages import image_pixels, joint_places, stored_image

_STAMPS = (("sec", "nanosec"), ("secs", "nsecs"))  # of ROS 2 and ROS 1


_MOST_SECONDS = 2**33

Bytes = Annotated[bytes, Meta(description="bytes in base64")]  # converted from base64 where they are a text


class _Header(Struct):
    stamp: dict[str, int]


class _Stamped(Struct):
    header: _Header


class _ImageMessage(_Stamped):
    width: Count
    height: Count
    encoding: str
    step: Count
    data: Bytes


class _CompressedImage(_Stamped):
    data: Bytes


class _JointState(_Stamped):
    position: tuple[Number, ...]
    name: Texts = ()


@dataclass(frozen=True)
class JointMessage:
    """Readings of a JointState at its time, ns: joints by name, rad, or m for ``insertion``; and their topic."""

    time: int
    joints: Mapping[str, float]
    topic: str = ""


def read_stamp(where: str, fields: Mapping[str, Any]) -> tuple[int, bool]:
    """Read the time in a message's header, ns, and whether it is written as in ROS 1."""
    stamp = convert_document(where, fields, _Stamped).header.stamp
    for ros1, (seconds, rest) in enumerate(_STAMPS):
        if seconds in stamp and rest in stamp:
            if not (abs(stamp[seconds]) < _MOST_SECONDS and 0 <= stamp[rest] < NANOSECONDS):
                break
            return stamp[seconds] * NANOSECONDS + stamp[rest], bool(ros1)
    raise InputError(f"{where}: header.stamp: expected sec and nanosec, or secs and nsecs, got {shown(stamp)}")


def read_pixels(where: str, fields: Mapping[str, Any], *, grey: bool = False) -> NDArray[np.uint8]:
    """Decode an Image or a CompressedImage to (H, W, 3) uint8, BGR, or to (H, W) grey, in half the time."""
    if "encoding" in fields:
        pixels = image_pixels(convert_document(where, fields, _ImageMessage), where)
        if (pixels.ndim == 2) == grey:
            return pixels
        return np.asarray(cv2.cvtColor(pixels, cv2.COLOR_BGR2GRAY if grey else cv2.COLOR_GRAY2BGR), np.uint8)
    data = stored_image(convert_document(where, fields, _CompressedImage).data, where)
    colours = cv2.IMREAD_GRAYSCALE if grey else cv2.IMREAD_COLOR
    return np.asarray(decode_image(where, data, "an image", colours | cv2.IMREAD_IGNORE_ORIENTATION), np.uint8)


def read_joint_message(where: str, fields: Mapping[str, Any]) -> JointMessage:
    """Read the positions of a JointState."""
    message = convert_document(where, fields, _JointState)
    places = joint_places(message, where)
    joints = {name: joint_reading(where, name, message.position[place]) for name, place in places.items()}
    return JointMessage(read_stamp(where, fields)[0], joints, where)


def read_rig(infos: Mapping[str, Mapping[str, Any]], *, rectified: bool = False) -> Rig:
    """Read the CameraInfo of one eye, or those of the left and the right one, by topic."""
    cameras: list[Camera] = []
    for side, (where, fields) in zip(get_args(Side), infos.items(), strict=False):
        found = read_fields(where, fields, rectified=rectified, side=side)
        if found.size is None:
            raise InputError(f"{where}: width: missing")
        cameras.append(found.camera(where, found.size))
    if len(cameras) == 1:
        return Rig.of_camera(cameras[0])
    (left, right), (first, second) = infos, infos.values()
    pose, _ = pose_of_camera_infos((left, right), first, second, rectified=rectified)
    return Rig.stereo(cameras[0], cameras[1], pose)
