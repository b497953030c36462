"""Start what ``dvrk-cmaes live`` needs beside the robot and its camera, and RViz, in a sourced environment of ROS 2.

    ros2 launch scripts/examples/live_launch.py image_topic:=/left/image_rect_color/compressed mask_topic:=/left/mask
    ros2 launch scripts/examples/live_launch.py live:=false     # only the instrument in RViz, of a bag that is played

The masks are those of `sam2_mask_node.py`; with ``masks:=false`` another segmenter publishes them. The frames of
the instrument's links in tf, and the shape for RViz, are robot_state_publisher's, by the joints that are found.
"""

from __future__ import annotations

import re
from pathlib import Path

from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, ExecuteProcess, OpaqueFunction
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

STATES = "robot_state_publisher"
HERE = Path(__file__).resolve().parent
ARGUMENTS = {
    "arm": "PSM1",
    "instrument": str(HERE.parents[1] / "data" / "instruments" / "lnd" / "lnd.urdf"),
    "image_topic": "/left/image_rect_color/compressed",
    "mask_topic": "/left/mask",
    "options": "--rectified",
    "live": "true",
    "masks": "true",
    "prompt": "90,140,300,340",
}


def robot_description(urdf: str, arm: str) -> str:
    """Return a URDF whose links are named as in tf, such as PSM1_roll_link, and whose meshes have absolute paths."""
    text = Path(urdf).read_text(encoding="utf-8")
    named = re.sub(r'(<link name="|<(?:parent|child) link=")', rf"\g<1>{arm}_", text)
    return named.replace('<mesh filename="', f'<mesh filename="file://{Path(urdf).resolve().parent}/')


def nodes(context: LaunchContext) -> list[ExecuteProcess | Node]:
    """Return what is started with the arguments of the launch."""
    given = {name: LaunchConfiguration(name).perform(context) for name in ARGUMENTS}
    arm, started = given["arm"], []
    if given["live"] == "true":
        topics = f"--psm {arm} --image-topic {given['image_topic']} --mask-topic {given['mask_topic']}"
        live = f"dvrk-cmaes live --via rclpy {topics} --instrument {given['instrument']} {given['options']}"
        started.append(ExecuteProcess(cmd=f"{live} --overlay --out live".split(), output="screen"))
        if given["masks"] == "true":
            node = f"python3 {HERE / 'sam2_mask_node.py'} sam2 {given['prompt']}"
            started.append(ExecuteProcess(cmd=node.split(), output="screen"))
    description = {"robot_description": robot_description(given["instrument"], arm)}
    joints = [("joint_states", f"/dvrk_cmaes/{arm}/measured_js")]
    return [
        *started,
        Node(package=STATES, executable=STATES, parameters=[description], remappings=joints),
        Node(package="rviz2", executable="rviz2", arguments=["-d", str(HERE / "instrument.rviz")]),
    ]


def generate_launch_description() -> LaunchDescription:
    """Return the arguments with their defaults, and what they start."""
    arguments = [DeclareLaunchArgument(name, default_value=value) for name, value in ARGUMENTS.items()]
    return LaunchDescription([*arguments, OpaqueFunction(function=nodes)])
