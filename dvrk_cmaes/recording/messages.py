"""Conversion of ROS messages of sensor_msgs to image files and joint readings."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.errors import InputError, nearest_first
from dvrk_cmaes.geometry import Float64, exp_rotation, transform
from dvrk_cmaes.instrument.arm import OUTER_JOINTS
from dvrk_cmaes.instrument.endoscope import joints_of_ecm_tip
from dvrk_cmaes.io.image_header import check_pixels, checked_header, read_header
from dvrk_cmaes.io.short_text import listed, shown
from dvrk_cmaes.joints.interpolation import NANOSECONDS
from dvrk_cmaes.joints.names import accepted_names, joints_by_count, joints_of_arm

# bytes per pixel, and OpenCV's conversion to BGR or grey; ROS names Bayer patterns by the top-left 2 x 2 pixels
_ENCODINGS: dict[str, tuple[int, int | None]] = {
    "bgr8": (3, None),
    "rgb8": (3, cv2.COLOR_RGB2BGR),
    "mono8": (1, None),
    "8UC1": (1, None),
    "8UC3": (3, None),
    "bgra8": (4, cv2.COLOR_BGRA2BGR),
    "rgba8": (4, cv2.COLOR_RGBA2BGR),
    "bayer_rggb8": (1, cv2.COLOR_BayerRGGB2BGR),
    "bayer_bggr8": (1, cv2.COLOR_BayerBGGR2BGR),
    "bayer_gbrg8": (1, cv2.COLOR_BayerGBRG2BGR),
    "bayer_grbg8": (1, cv2.COLOR_BayerGRBG2BGR),
    "uyvy": (2, cv2.COLOR_YUV2BGR_UYVY),
    "yuyv": (2, cv2.COLOR_YUV2BGR_YUY2),
    "yuv422": (2, cv2.COLOR_YUV2BGR_UYVY),  # the names of the last two before ROS 2 Iron
    "yuv422_yuy2": (2, cv2.COLOR_YUV2BGR_YUY2),
}


def stamp(message: Any) -> int:
    """Return the time of a message's header, ns; zero if it is not set."""
    return int(message.header.stamp.sec) * NANOSECONDS + int(message.header.stamp.nanosec)


def image_file(message: Any, where: str) -> bytes:
    """Convert an Image to a PNG file (lossless), or return the PNG or JPEG file of a CompressedImage unchanged.

    Raises
    ------
    InputError
        The encoding is unknown, the data are too short or damaged, or the image has over 36 megapixels; the message
        begins with ``where``.
    """
    if hasattr(message, "encoding"):
        return encode_png(image_pixels(message, where))
    data = bytes(np.asarray(message.data, np.uint8))
    if read_header(data) is None:
        raise InputError(f"{where}: format: expected a PNG or JPEG, got {shown(message.format)}")
    return stored_image(data, where)


def image_pixels(message: Any, where: str) -> NDArray[np.uint8]:
    """Return the pixels of a sensor_msgs/Image, (H, W) grey or (H, W, 3) BGR; errors as in ``image_file``."""
    width, height, step = int(message.width), int(message.height), int(message.step)
    if message.encoding not in _ENCODINGS:
        names = ", ".join(nearest_first(message.encoding, _ENCODINGS))
        got = f"{shown(message.encoding)}: ROS' image_proc or cv_bridge converts it"
        raise InputError(f"{where}: encoding: expected one of {names}, got {got}")
    channels, conversion = _ENCODINGS[message.encoding]
    check_pixels(where, width, height)
    if step < width * channels or len(message.data) < step * height:
        raise InputError(
            f"{where}: expected {width} x {height} pixels of {message.encoding}, "
            f"got {len(message.data)} bytes in rows of {step}"
        )
    rows = np.frombuffer(message.data, np.uint8)[: step * height].reshape(height, step)
    pixels = rows[:, : width * channels].reshape((height, width, channels) if channels > 1 else (height, width))
    try:
        converted = pixels if conversion is None else cv2.cvtColor(pixels, conversion)
    except cv2.error:  # the size does not fit the Bayer pattern or the pixel pairs
        raise InputError(f"{where}: {width} x {height} pixels of {message.encoding} make no image") from None
    return np.ascontiguousarray(converted, np.uint8)


def encode_png(pixels: NDArray[np.uint8]) -> bytes:
    """Encode pixels, (H, W) grey or (H, W, 3) BGR uint8, as PNG."""
    return cv2.imencode(".png", pixels)[1].tobytes()


def stored_image(data: bytes, where: str) -> bytes:
    """Return the bytes of a PNG or JPEG file as they are; InputError, which begins with ``where``, for others."""
    checked_header(data, where, "a PNG or JPEG")
    return data


def joint_places(message: Any, where: str, arm: str | None = None) -> dict[str, int]:
    """Return the places of an arm's joints in a JointState, by joint; without names, as implied by their number.

    A message without positions has none, as before an arm is up. Errors as of `joints_of_arm`.
    """
    if not len(message.position):
        return {}
    if not message.name:
        return {name: place for place, name in enumerate(joints_by_count(f"{where}: position", len(message.position)))}
    places = joints_of_arm(f"{where}: name", [str(name) for name in message.name], accepted_names(), arm)
    if len(message.position) != len(message.name):
        raise InputError(
            f"{where}: position: expected {len(message.name)} numbers, one for each name, got {len(message.position)}"
        )
    return places


def stamped_pose(message: Any) -> Float64:
    """Return the pose (4, 4) of a PoseStamped, m."""
    place, turn = message.pose.position, message.pose.orientation
    axis = np.array([turn.x, turn.y, turn.z], dtype=np.float64)
    length = float(np.linalg.norm(axis))
    rotation = exp_rotation(2 * np.arctan2(length, turn.w) / max(length, 1e-12) * axis)
    return transform(rotation, [place.x, place.y, place.z])


def ecm_values(message: Any, where: str) -> list[float]:
    """Return the ECM's joints, rad and m, of a JointState or of its tip's PoseStamped; none without positions."""
    if hasattr(message, "pose"):
        found: list[float] = joints_of_ecm_tip(stamped_pose(message)).tolist()
        return found
    position = [float(value) for value in message.position]
    if not position:
        return position
    names = [str(name).lower() for name in message.name] or list(OUTER_JOINTS)
    places = [
        next((k for k, own in enumerate(names) if own.removesuffix("_joint").endswith(name)), -1)
        for name in OUTER_JOINTS
    ]
    if len(names) != len(position) or min(places) < 0:
        raise InputError(f"{where}: expected positions of {', '.join(OUTER_JOINTS)}, got {listed(names, 8)}")
    return [position[place] for place in places]


def joint_values(message: Any, where: str, arm: str | None = None) -> dict[str, float]:
    """Return the positions of a JointState by joint, rad or m, NaN included; none without positions."""
    return {name: float(message.position[place]) for name, place in joint_places(message, where, arm).items()}
