"""Export of results as the messages of ROS topics, under CRTK's names.

What the readings say has the names of the arm's own topics; what was found has the same names in the namespace
``/dvrk_cmaes``. Per frame with a pose, in the camera's optical frame (x right, y down, z forward):

- ``/ARM/measured_cp`` (PoseStamped): the tool tip by the readings and the arm's kinematics, from ``camera_from_base``;
- ``/ARM/measured_js`` and ``/ARM/jaw/measured_js`` (JointState): the readings;
- ``/dvrk_cmaes/ARM/measured_cp`` (PoseStamped): the tool tip by the pose and the joints found;
- ``/dvrk_cmaes/ARM/camera_from_root`` (PoseWithCovarianceStamped): the pose of the root link;
- ``/dvrk_cmaes/ARM/measured_js`` (JointState): the joints found;
- ``/tf``: the root link, and the arm's base where it is known, in the camera. Of an endoscope that moved and whose arm
  is read, the camera in ``ECM_tip``, and in ``ECM_base`` that and the bases of all arms.

A pose or joints that are not known have no message.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field

from dvrk_cmaes.errors import InputError
from dvrk_cmaes.export.base_choice import ChosenBase
from dvrk_cmaes.export.frames import FrameNames
from dvrk_cmaes.export.ros_messages import RosMessage, joint_message, pose_message, tf_message, uncertain_pose_message
from dvrk_cmaes.geometry import Float64, inverse
from dvrk_cmaes.instrument.arm import (
    OUTER_JOINTS,
    ROLL_OFFSET,
    TOOLTIP_OFFSET,
    WRIST_LENGTH,
    Arm,
    base_from_root,
    root_from_tip,
    stated_kinematics,
)
from dvrk_cmaes.instrument.inverse_kinematics import POSED_JOINTS
from dvrk_cmaes.io.short_text import listed
from dvrk_cmaes.joints.interpolation import NANOSECONDS
from dvrk_cmaes.results.result import Result

FOUND = "/dvrk_cmaes"
"""Namespace of the topics with what was found."""


@dataclass(frozen=True, eq=False)
class ToolTip:
    """The tool tip frame of the dVRK: distance of the wrist axes, m, and pose (4, 4) in the wrist yaw frame."""

    wrist_length: float = WRIST_LENGTH
    tooltip_offset: Float64 = field(default_factory=TOOLTIP_OFFSET.copy)

    def in_root(self, joints: Mapping[str, float]) -> Float64 | None:
        """Return the pose (4, 4) of the tip in the root link; None without both wrist angles."""
        if "wrist_pitch" not in joints or "wrist_yaw" not in joints:
            return None
        return root_from_tip(
            joints["wrist_pitch"],
            joints["wrist_yaw"],
            wrist_length=self.wrist_length,
            tooltip_offset=self.tooltip_offset,
        )


def result_messages(
    results: Sequence[Result], times: Mapping[str, int], names: FrameNames, base: ChosenBase | None, tip: ToolTip
) -> list[RosMessage]:
    """Return the messages of results, by time, which all have a pose; ``times`` are those of the frames, ns.

    ``base`` is None where no base is known.
    """
    arm, roll_offset = stated_kinematics(result.config for result in results) or ("classic", ROLL_OFFSET)
    messages: list[RosMessage] = []
    for result in sorted(results, key=lambda result: times[result.frame]):
        time, pose = times[result.frame], result.camera_from_root
        assert pose is not None
        own = None if base is None else base.in_frame(result)
        messages += _read(result, time, names, own, tip, arm, roll_offset)
        messages += _found(result, pose, time, names, tip)
        messages.append(tf_message(time, _transforms(pose, result.root_link, names, base, own)))
    return messages


def times_or_rows(results: Sequence[Result], times: Mapping[str, int]) -> tuple[Mapping[str, int], tuple[str, ...]]:
    """Return the times of frames, ns, or numbers in their place if none is known, and a note on that.

    Raises
    ------
    InputError
        Some frames with a pose have a time and others have none.
    """
    if not times:
        note = "the frames' times are not known (--times images.csv): they are numbered, one second apart"
        return {result.frame: number * NANOSECONDS for number, result in enumerate(results, start=1)}, (note,)
    untimed = [result.frame for result in results if result.camera_from_root is not None and result.frame not in times]
    if untimed:
        raise InputError(f"--times: expected a time of every frame, got none of {listed(untimed)}")
    return times, ()


def _read(
    result: Result,
    time: int,
    names: FrameNames,
    camera_from_base: Float64 | None,
    tip: ToolTip,
    arm: Arm,
    roll_offset: float,
) -> Iterator[RosMessage]:
    """Yield the messages of the readings of a frame."""
    readings = result.readings
    root_from_read_tip = tip.in_root(readings)
    if camera_from_base is not None and root_from_read_tip is not None and set(OUTER_JOINTS) <= set(readings):
        root = camera_from_base @ base_from_root(readings, arm, roll_offset=roll_offset)
        yield pose_message(f"/{names.arm}/measured_cp", time, names.camera, root @ root_from_read_tip)
    arm_readings: dict[str, float] = {name: readings[name] for name in POSED_JOINTS if name in readings}
    if arm_readings:
        yield joint_message(f"/{names.arm}/measured_js", time, arm_readings)
    if "jaw" in readings:
        yield joint_message(f"/{names.arm}/jaw/measured_js", time, {"jaw": readings["jaw"]})


def _found(result: Result, pose: Float64, time: int, names: FrameNames, tip: ToolTip) -> Iterator[RosMessage]:
    """Yield the messages of what was found in a frame, whose pose is (4, 4), m."""
    found = f"{FOUND}/{names.arm}"
    covariance = result.covariance_in_camera()
    yield uncertain_pose_message(f"{found}/camera_from_root", time, names.camera, pose, covariance)
    root_from_found_tip = tip.in_root(result.joints)
    if root_from_found_tip is not None:
        yield pose_message(f"{found}/measured_cp", time, names.camera, pose @ root_from_found_tip)
    if result.joints:
        yield joint_message(f"{found}/measured_js", time, result.joints)


def _transforms(
    pose: Float64, root_link: str, names: FrameNames, base: ChosenBase | None, camera_from_base: Float64 | None
) -> dict[tuple[str, str], Float64]:
    """Return the transforms (4, 4) of a frame, m, by the names of the parent and the child."""
    poses = {(names.camera, f"{names.arm}_{root_link}"): pose}
    if base is not None and camera_from_base is not None:
        if base.tip_from_camera is None or base.ecm_from_base is None:
            poses[names.camera, names.base] = camera_from_base
        else:
            ecm_from_camera = base.ecm_from_base @ inverse(camera_from_base)
            poses["ECM_base", "ECM_tip"] = ecm_from_camera @ inverse(base.tip_from_camera)
            poses["ECM_tip", names.camera] = base.tip_from_camera
            poses["ECM_base", names.base] = base.ecm_from_base
            poses |= {("ECM_base", f"{arm}_base"): other for arm, other in base.others.items()}
    return poses
