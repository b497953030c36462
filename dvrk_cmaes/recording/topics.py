"""Which paths are ROS recordings, and the selection of their topics by type and name, without the reader.

An ambiguous choice is an error that lists the topics.

CRTK names (``/PSM1/measured_js``, ``/PSM1/jaw/measured_js``) and the dVRK's older names
(``/dvrk/PSM1/state_joint_current``, ``/dvrk/PSM1/state_jaw_current``) are recognised.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from dvrk_cmaes.camera.files import Side
from dvrk_cmaes.errors import InputError, nearest_first
from dvrk_cmaes.frames.session_folder import is_session_layout
from dvrk_cmaes.io.short_text import listed

if TYPE_CHECKING:
    from dvrk_cmaes.recording.recording import Asked

IMAGE = "sensor_msgs/msg/Image"
COMPRESSED_IMAGE = "sensor_msgs/msg/CompressedImage"
IMAGES = (IMAGE, COMPRESSED_IMAGE)
CAMERA_INFO = "sensor_msgs/msg/CameraInfo"
JOINT_STATE = "sensor_msgs/msg/JointState"

POSE = "geometry_msgs/msg/PoseStamped"

SUFFIXES_2 = (".mcap", ".db3")
SUFFIXES = (".bag", *SUFFIXES_2)
"""Suffixes of ROS recordings; a recording may also be a folder."""

#: Given in place of a topic's name to use no topic.
NONE = "none"

_MOST_LISTED = 20


def is_bag(path: Path) -> bool:
    """Whether a path is a ROS recording: a file with its suffix, or a folder with such files that is no session."""
    if path.suffix == ".active":
        raise InputError(f"{path}: expected a ROS recording that was closed: rosbag reindex it, and rename it to .bag")
    if not path.is_dir():
        return path.suffix.lower() in SUFFIXES
    if is_session_layout(path):
        return False
    return (path / "metadata.yaml").exists() or any(file.suffix in SUFFIXES_2 for file in path.iterdir())


def choose_image(path: Path, types: Mapping[str, str], asked: Asked, eye: Side | None, option: str) -> str | None:
    """Choose the topic of the images among those of a recording that have messages, None for none of them.

    Parameters
    ----------
    path
        The recording, for messages.
    types
        Message type of each topic, as named in ROS 2.
    asked
        Has the topics that are given by name: None to find one automatically, ``none`` to use none.
    eye
        The eye of a stereo endoscope, a word in the name of its images' topic; None for one camera.
    option
        That which names the topic, for messages.

    Raises
    ------
    InputError
        A topic is missing or of another type, or none or several are suitable; the message lists the candidates.
    """
    if asked.image_topic == NONE:
        return None
    shown = [name for name, kind in types.items() if kind in IMAGES]
    of_eye = None if eye is None else [name for name in shown if eye in re.split("[/_]", name.lower())]
    what = "images" if eye is None else f"images of the {eye} eye"
    return _one(path, types, asked.image_topic, option, IMAGES, what, of_eye)


def choose_camera(path: Path, types: Mapping[str, str], asked: Asked, image: str) -> str:
    """Choose the topic of the camera of images; arguments and errors as of `choose_image`."""
    camera_info = camera_info_of(image)
    requested = asked.camera_topic or (camera_info if types.get(camera_info) == CAMERA_INFO else None)
    return _one(path, types, requested, "--camera-topic", (CAMERA_INFO,), "the camera (or --camera FILE, or none)")


def choose_joints(path: Path, types: Mapping[str, str], asked: Asked, arm: str | None) -> list[str]:
    """Choose the topics of an arm's joints and, if it is read, of its jaw; arguments and errors as of `choose_image`.

    ``arm``, of several, is a part of the names of its topics, or is one of a topic with the joints of all.
    """
    if asked.joints_topic == NONE:
        return []
    states = [name for name, kind in types.items() if kind == JOINT_STATE]
    arms = [name for name in states if _ends(name, "measured_js", "state_joint_current") and not _is_jaw(name)]
    if arm is not None and len(arms) > 1:
        arms = [name for name in arms if arm.lower() in name.lower().split("/")]
    if len(arms) > 1:
        arms = [name for name in arms if not _is_ecm(name)]
    together = [name for name in states if _ends(name, "joint_states")]
    what = f"the arm's joints (--arm, or {NONE})"
    found = _one(path, types, asked.joints_topic, "--joints-topic", (JOINT_STATE,), what, arms or together)
    jaws = [name for name in states if name in _jaws_of(found)]
    if asked.jaw_topic == NONE or (asked.jaw_topic is None and not jaws):
        return [found]
    return [found, _one(path, types, asked.jaw_topic, "--jaw-topic", (JOINT_STATE,), "the jaw", jaws)]


def ecm_topic(types: Mapping[str, str], chosen: str | None) -> str | None:
    """Return the topic of the endoscope's arm beside the ``chosen`` one of an arm: its joints, or its tip's pose."""
    for kind, words in ((JOINT_STATE, ("measured_js", "state_joint_current")), (POSE, ("local/measured_cp",))):
        found = sorted(name for name, own in types.items() if own == kind and _is_ecm(name) and name.endswith(words))
        if found and chosen not in found and chosen is not None:
            return found[0]
    return None


def setup_topics(types: Mapping[str, str]) -> dict[str, str]:
    """Return the topics of the poses at which the set-up joints hold the arms, such as SUJ/PSM1/measured_cp, by arm."""
    parts = {name: name.strip("/").split("/") for name, kind in sorted(types.items()) if kind == POSE}
    return {own[-2]: name for name, own in parts.items() if own[-1] == "measured_cp" and own[-3:-2] == ["SUJ"]}


def _is_ecm(name: str) -> bool:
    """Whether a topic is of the arm that holds the endoscope."""
    return "ecm" in name.lower().split("/")


def _one(
    path: Path,
    types: Mapping[str, str],
    requested: str | None,
    option: str,
    kinds: Sequence[str],
    what: str,
    candidates: Iterable[str] | None = None,
) -> str:
    """Return the requested topic, or the only suitable one; InputError if there is none or there are several."""
    expected = " or ".join(kind.replace("/msg/", "/") for kind in kinds)
    if requested is not None:
        name = requested if requested in types else f"/{requested}"
        if name not in types:
            near = listed(nearest_first(requested, types), _MOST_LISTED)
            raise InputError(f"{path}: {option}: no messages on {requested}; expected one of {near}")
        if types[name] not in kinds:
            raise InputError(f"{path}: {option}: {name}: expected {expected}, got {types[name].replace('/msg/', '/')}")
        return name
    suitable = (
        sorted(name for name, kind in types.items() if kind in kinds) if candidates is None else sorted(candidates)
    )
    if len(suitable) == 1:
        return suitable[0]
    if not suitable:
        there = listed(sorted(types), _MOST_LISTED) or "no messages"
        raise InputError(f"{path}: {option}: expected a topic of {what} ({expected}), got {there}")
    raise InputError(f"{path}: {option}: expected one topic of {what}, got several: {listed(suitable, _MOST_LISTED)}")


def camera_info_of(image: str) -> str:
    """Return the topic of an image topic's camera by image_transport's convention: ``camera_info`` in its namespace."""
    raw = image.removesuffix("/compressed")
    return f"{raw.rpartition('/')[0]}/camera_info"


def _ends(name: str, *words: str) -> bool:
    """Whether the last part of a topic's name is one of some words."""
    return name.rpartition("/")[2] in words


def _is_jaw(name: str) -> bool:
    """Whether a topic is in the namespace of a jaw or of a master's gripper."""
    return name.split("/")[-2:-1] in (["jaw"], ["gripper"])


def _jaws_of(arm: str) -> tuple[str, ...]:
    """Return the names of the topics that the jaw of an arm may have."""
    namespace = arm.rpartition("/")[0]
    return f"{namespace}/jaw/measured_js", f"{namespace}/state_jaw_current"
