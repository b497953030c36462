"""Which topics of a ROS recording are meant: found by type and name, and asked about where several would do.

CRTK names (``/PSM1/measured_js``, ``/PSM1/jaw/measured_js``) and the dVRK's older ones
(``/dvrk/PSM1/state_joint_current``, ``/dvrk/PSM1/state_jaw_current``) are known.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from dvrk_cmaes.errors import InputError, nearest_first
from dvrk_cmaes.io.short_text import listed

IMAGE = "sensor_msgs/msg/Image"
COMPRESSED_IMAGE = "sensor_msgs/msg/CompressedImage"
CAMERA_INFO = "sensor_msgs/msg/CameraInfo"
JOINT_STATE = "sensor_msgs/msg/JointState"

#: What to say instead of a topic to go without.
NONE = "none"

_MOST_LISTED = 20


@dataclass(frozen=True)
class TopicChoice:
    """Topics that were asked for by name; None is found, and for joints and jaw ``none`` is left out."""

    image: str | None = None
    camera: str | None = None
    joints: str | None = None
    jaw: str | None = None


@dataclass(frozen=True)
class Topics:
    """Topics to read; no camera topic where the camera is another file, no joints or jaw where there are none."""

    image: str
    camera: str | None
    joints: str | None
    jaw: str | None


def choose_topics(
    path: Path, types: Mapping[str, str], asked: TopicChoice, *, camera: bool = True, joints: bool = True
) -> Topics:
    """Choose among the topics of a recording that have messages.

    Parameters
    ----------
    path
        The recording, for messages.
    types
        Type of each topic, as ROS 2 names it.
    asked
        What was asked for.
    camera, joints
        Whether they are wanted from the recording at all.

    Raises
    ------
    InputError
        A topic that is not there or of another type; none that would do, or several: the message lists them.
    """
    image = _one(path, types, asked.image, "--image-topic", (IMAGE, COMPRESSED_IMAGE), "images")
    info = None
    if camera:
        beside = _camera_info_of(image)
        wanted = asked.camera or (beside if types.get(beside) == CAMERA_INFO else None)
        info = _one(path, types, wanted, "--camera-topic", (CAMERA_INFO,), "the camera (or --camera FILE)")
    if not joints or asked.joints == NONE:
        return Topics(image, info, None, None)
    states = [name for name, kind in types.items() if kind == JOINT_STATE]
    arms = [name for name in states if _ends(name, "measured_js", "state_joint_current") and not _is_jaw(name)]
    arm = _one(path, types, asked.joints, "--joints-topic", (JOINT_STATE,), f"the arm's joints (or {NONE})", arms)
    if asked.jaw == NONE:
        return Topics(image, info, arm, None)
    jaws = [name for name in states if name in _jaws_of(arm)]
    if asked.jaw is None and not jaws:
        return Topics(image, info, arm, None)
    return Topics(image, info, arm, _one(path, types, asked.jaw, "--jaw-topic", (JOINT_STATE,), "the jaw", jaws))


def _one(
    path: Path,
    types: Mapping[str, str],
    asked: str | None,
    option: str,
    kinds: Sequence[str],
    what: str,
    candidates: Iterable[str] | None = None,
) -> str:
    """Topic that was asked for, or the only one that would do."""
    expected = " or ".join(kind.replace("/msg/", "/") for kind in kinds)
    if asked is not None:
        name = asked if asked in types else f"/{asked}"
        if name not in types:
            near = listed(nearest_first(asked, types), _MOST_LISTED)
            raise InputError(f"{path}: {option}: no messages on {asked}; expected one of {near}")
        if types[name] not in kinds:
            raise InputError(f"{path}: {option}: {name}: expected {expected}, got {types[name].replace('/msg/', '/')}")
        return name
    found = sorted(name for name, kind in types.items() if kind in kinds) if candidates is None else sorted(candidates)
    if len(found) == 1:
        return found[0]
    if not found:
        there = listed(sorted(types), _MOST_LISTED) or "no messages"
        raise InputError(f"{path}: {option}: expected a topic of {what} ({expected}), got {there}")
    raise InputError(f"{path}: {option}: expected one topic of {what}, got several: {listed(found, _MOST_LISTED)}")


def _camera_info_of(image: str) -> str:
    """Topic that image_transport's convention puts beside an image topic: ``camera_info`` in its namespace."""
    raw = image.removesuffix("/compressed")
    return f"{raw.rpartition('/')[0]}/camera_info"


def _ends(name: str, *words: str) -> bool:
    return name.rpartition("/")[2] in words


def _is_jaw(name: str) -> bool:
    """Whether a topic is of a jaw, or of a master's gripper."""
    return name.split("/")[-2:-1] in (["jaw"], ["gripper"])


def _jaws_of(arm: str) -> tuple[str, ...]:
    """Topics where the jaw of an arm may be."""
    namespace = arm.rpartition("/")[0]
    return f"{namespace}/jaw/measured_js", f"{namespace}/state_jaw_current"
