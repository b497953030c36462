"""Start all that ``dvrk-cmaes live`` needs beside the robot and its camera, in a sourced environment of ROS 2.

    ros2 launch scripts/examples/live_launch.py

The masks are those of `sam2_mask_node.py`; another segmenter may publish them instead.
"""

from __future__ import annotations

from launch import LaunchDescription
from launch.actions import ExecuteProcess
from launch_ros.actions import Node

LIVE = (
    "dvrk-cmaes live --via rclpy --rectified --image-topic /left/image_rect_color/compressed --mask-topic /left/mask "
    "--overlay --out live"
)
MASKS = "python3 scripts/examples/sam2_mask_node.py sam2 90,140,300,340"


def generate_launch_description() -> LaunchDescription:
    return LaunchDescription(
        [
            ExecuteProcess(cmd=MASKS.split(), output="screen"),
            ExecuteProcess(cmd=LIVE.split(), output="screen"),
            Node(package="rviz2", executable="rviz2", arguments=["-f", "camera"]),
        ]
    )
