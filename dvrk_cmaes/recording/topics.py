"""Which paths are ROS recordings, and the selection of their topics by type and name, without the reader.

An ambiguous choice is an error that lists the topics.

CRTK names (``/PSM1/measured_js``, ``/PSM1/jaw/measured_js``) and the dVRK's older names
(``/dvrk/PSM1/state_joint_current``, ``/dvrk/PSM1/state_jaw_current``) are recognised.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from dvrk_cmaes.camera.files import Side
from dvrk_cmaes.errors import InputError, nearest_first
from dvrk_cmaes.frames.session_folder import is_session_layout
from dvrk_cmaes.io.short_text import listed

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


@dataclass(frozen=True)
class TopicRequest:
    """Topics given by name; None to find the topic automatically, ``none`` to use none.

    ``recorded_times`` uses the times at which messages were recorded instead of those in their headers. This is also
    done, with a note, if the headers of a topic have no times, or times that do not advance. ``rectified``: whether the
    images are rectified.
    """

    image_topic: str | None = None
    image_topic_right: str | None = None
    camera_topic: str | None = None
    joints_topic: str | None = None
    jaw_topic: str | None = None
    recorded_times: bool = False
    rectified: bool = False


AUTOMATIC = TopicRequest()
"""All topics are found automatically."""


@dataclass(frozen=True)
class Topics:
    """Topics to read; None for images, a camera, joints or a jaw that are not read from the recording."""

    image: str | None
    camera: str | None
    joints: str | None
    jaw: str | None


def choose_topics(
    path: Path,
    types: Mapping[str, str],
    requested: TopicRequest,
    *,
    images: bool = True,
    camera: bool = True,
    joints: bool = True,
    arm: str | None = None,
    eye: Side | None = None,
    option: str = "--image-topic",
) -> Topics:
    """Choose the topics to read among those of a recording that have messages.

    Parameters
    ----------
    path
        The recording, for messages.
    types
        Message type of each topic, as named in ROS 2.
    requested
        The topics given by name.
    images, camera, joints
        Whether they are read from the recording.
    arm
        The arm, whose name is a part of those of its topics, or which is one of a topic with the joints of several.
    eye
        The eye of a stereo endoscope, a word in the name of its images' topic; None for one camera.
    option
        That which names the topic of its images, for messages.

    Raises
    ------
    InputError
        A topic is missing or of another type, or none or several are suitable; the message lists the candidates.
    """
    image, info = None, None
    if images and requested.image_topic != NONE:
        shown = [name for name, kind in types.items() if kind in IMAGES]
        of_eye = None if eye is None else [name for name in shown if eye in re.split("[/_]", name.lower())]
        what = "images" if eye is None else f"images of the {eye} eye"
        image = _one(path, types, requested.image_topic, option, IMAGES, what, of_eye)
    if camera and image is not None:
        camera_info = camera_info_of(image)
        requested_camera = requested.camera_topic or (camera_info if types.get(camera_info) == CAMERA_INFO else None)
        info = _one(path, types, requested_camera, "--camera-topic", (CAMERA_INFO,), "the camera (or --camera FILE)")
    if not joints or requested.joints_topic == NONE:
        return Topics(image, info, None, None)
    return Topics(image, info, *_joint_topics(path, types, requested, arm))


def _joint_topics(
    path: Path, types: Mapping[str, str], requested: TopicRequest, arm: str | None
) -> tuple[str, str | None]:
    """Choose the topics of an arm's joints and its jaw, None for a jaw that is not read; errors as `choose_topics`."""
    states = [name for name, kind in types.items() if kind == JOINT_STATE]
    arms = [name for name in states if _ends(name, "measured_js", "state_joint_current") and not _is_jaw(name)]
    if arm is not None and len(arms) > 1:
        arms = [name for name in arms if arm.lower() in name.lower().split("/")]
    if len(arms) > 1:
        arms = [name for name in arms if not _is_ecm(name)]
    together = [name for name in states if _ends(name, "joint_states")]
    what = f"the arm's joints (--arm, or {NONE})"
    found = _one(path, types, requested.joints_topic, "--joints-topic", (JOINT_STATE,), what, arms or together)
    jaws = [name for name in states if name in _jaws_of(found)]
    if requested.jaw_topic == NONE or (requested.jaw_topic is None and not jaws):
        return found, None
    return found, _one(path, types, requested.jaw_topic, "--jaw-topic", (JOINT_STATE,), "the jaw", jaws)


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
