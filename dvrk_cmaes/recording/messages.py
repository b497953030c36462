"""ROS messages to what a session holds: image files, and joint readings by name. Fields are those of sensor_msgs."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.errors import InputError, nearest_first
from dvrk_cmaes.io.image_header import MOST_PIXELS, read_header
from dvrk_cmaes.io.short_text import listed, shown
from dvrk_cmaes.joints.interpolation import NANOSECONDS
from dvrk_cmaes.joints.names import all_names, ordered_joints, plain_joint
from dvrk_cmaes.recording.recording import ImageFile

# bytes a pixel, and OpenCV's conversion to BGR or grey; ROS names Bayer patterns by the first two rows' first pixels
_ENCODINGS: dict[str, tuple[int, int | None]] = {
    "bgr8": (3, None),
    "rgb8": (3, cv2.COLOR_RGB2BGR),
    "mono8": (1, None),
    "8UC1": (1, None),
    "bgra8": (4, cv2.COLOR_BGRA2BGR),
    "rgba8": (4, cv2.COLOR_RGBA2BGR),
    "bayer_rggb8": (1, cv2.COLOR_BayerRGGB2BGR),
    "bayer_bggr8": (1, cv2.COLOR_BayerBGGR2BGR),
    "bayer_gbrg8": (1, cv2.COLOR_BayerGBRG2BGR),
    "bayer_grbg8": (1, cv2.COLOR_BayerGRBG2BGR),
    "yuv422": (2, cv2.COLOR_YUV2BGR_UYVY),
    "yuv422_yuy2": (2, cv2.COLOR_YUV2BGR_YUY2),
}


def stamp(message: Any) -> int:
    """Time of a message's header, ns; zero where nobody set it."""
    return int(message.header.stamp.sec) * NANOSECONDS + int(message.header.stamp.nanosec)


def image_file(message: Any, where: str) -> ImageFile:
    """Image of a sensor_msgs/Image (as PNG, nothing is lost) or CompressedImage (its own bytes).

    Raises
    ------
    InputError
        An unknown encoding, fewer bytes than the size takes, or over 100 megapixels; ``where`` begins the message.
    """
    return _raw(message, where) if hasattr(message, "encoding") else _compressed(message, where)


def _raw(message: Any, where: str) -> ImageFile:
    width, height, step = int(message.width), int(message.height), int(message.step)
    if message.encoding not in _ENCODINGS:
        names = ", ".join(nearest_first(message.encoding, _ENCODINGS))
        raise InputError(f"{where}: encoding: expected one of {names}, got {shown(message.encoding)}")
    channels, conversion = _ENCODINGS[message.encoding]
    _check_size(width, height, where)
    if step < width * channels or len(message.data) < step * height:
        raise InputError(
            f"{where}: expected {width} x {height} pixels of {message.encoding}, "
            f"got {len(message.data)} bytes in rows of {step}"
        )
    rows = np.asarray(message.data, np.uint8)[: step * height].reshape(height, step)
    pixels = rows[:, : width * channels].reshape((height, width, channels) if channels > 1 else (height, width))
    try:
        converted = pixels if conversion is None else cv2.cvtColor(pixels, conversion)
    except cv2.error:  # a Bayer pattern or pairs of pixels that do not fit the size
        raise InputError(f"{where}: {width} x {height} pixels of {message.encoding} make no image") from None
    return encoded(np.ascontiguousarray(converted, np.uint8))


def encoded(pixels: NDArray[np.uint8]) -> ImageFile:
    """Encode pixels, (H, W) grey or (H, W, 3) BGR uint8, as PNG."""
    _, data = cv2.imencode(".png", pixels)
    return ImageFile(data.tobytes(), ".png", pixels.shape[1], pixels.shape[0])


def _compressed(message: Any, where: str) -> ImageFile:
    data = bytes(np.asarray(message.data, np.uint8))
    header = read_header(data)
    if header is None:
        raise InputError(f"{where}: format: expected a PNG or JPEG, got {shown(message.format)}")
    _check_size(header.width, header.height, where)
    if not header.whole:
        raise InputError(f"{where}: expected a whole PNG or JPEG, got one that is cut off or damaged")
    return ImageFile(data, ".png" if data.startswith(b"\x89PNG") else ".jpg", header.width, header.height)


def _check_size(width: int, height: int, where: str) -> None:
    if not 0 < width * height <= MOST_PIXELS:
        raise InputError(f"{where}: expected 1 to {MOST_PIXELS} pixels, got {width} x {height}")


def joint_names(message: Any, where: str) -> tuple[str, ...]:
    """Names of a JointState's joints, without what ROS puts before them; by their number where it names none."""
    if not message.name:
        return ordered_joints(f"{where}: position", len(message.position))
    names = tuple(plain_joint(str(name), all_names()) for name in message.name)
    if set(names) - set(all_names()) or len(set(names)) < len(names):
        raise InputError(
            f"{where}: name: expected joints of an arm ({', '.join(all_names())}), got {listed(message.name, 8)}"
        )
    return names


def joint_values(message: Any, names: tuple[str, ...], where: str) -> list[float]:
    """Positions of a JointState whose joints must be these, rad or m; NaN stays NaN."""
    if joint_names(message, where) != names or len(message.position) != len(names):
        raise InputError(
            f"{where}: expected a position of each of {', '.join(names)} in every message, "
            f"got {len(message.position)} of {listed(message.name, 8) or 'joints without names'}"
        )
    return [float(value) for value in message.position]
