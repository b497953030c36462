"""Publish masks of an instrument for ``dvrk-cmaes live``: a node of ROS 2 around an exported SAM 2.

    python scripts/examples/sam2_mask_node.py sam2 90,140,300,340

The arguments are the folder of the export, see the page on segmentation, and a box around the instrument in the first
image, px. In each further image the box is that around the last mask, and the first one again where there is none.
"""

from __future__ import annotations

import sys
from typing import Any

import cv2
import numpy as np
import rclpy
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import CompressedImage, Image

from dvrk_cmaes.segment.sam2 import Sam2
from dvrk_cmaes.segment.segmentation import Hints

IMAGES, MASKS = "/left/image_rect_color/compressed", "/left/mask"
MARGIN = 20  # px, that the instrument may move between two images


def main(weights: str, corners: str) -> None:
    left, top, right, bottom = (float(corner) for corner in corners.split(","))
    model, first = Sam2(weights), (left, top, right, bottom)
    rclpy.init()
    node = rclpy.create_node("sam2_masks")
    publisher, around = node.create_publisher(Image, MASKS, 1), [first]

    def publish_mask(message: Any) -> None:
        pixels = np.asarray(cv2.imdecode(np.frombuffer(message.data, np.uint8), cv2.IMREAD_COLOR), np.uint8)
        mask = model.segment(pixels, Hints(box=around[0])).mask
        height, width = mask.shape
        u, v, across, down = cv2.boundingRect(mask.astype(np.uint8))
        far = min(u + across + MARGIN, width - 1), min(v + down + MARGIN, height - 1)
        around[0] = (max(u - MARGIN, 0), max(v - MARGIN, 0), *far) if across else first
        data = (255 * mask.astype(np.uint8)).tobytes()
        out = Image(height=height, width=width, encoding="mono8", step=width, data=data)
        out.header = message.header  # the time of the image, by which masks and images are paired
        publisher.publish(out)

    node.create_subscription(CompressedImage, IMAGES, publish_mask, qos_profile_sensor_data)
    rclpy.spin(node)


if __name__ == "__main__":
    main(*sys.argv[1:3])
