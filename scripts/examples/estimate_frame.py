"""Estimate the pose of one frame from arrays: a mask, a camera and joint readings.

    python scripts/examples/estimate_frame.py

The arrays are those of a frame of the bundled session. Of your own program, they may come from anywhere.
"""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from dvrk_cmaes import Camera, estimate, prepare

DEMO = Path(__file__).resolve().parents[2] / "data" / "demo"


def main() -> None:
    body = prepare("lnd")  # a Large Needle Driver, or the path of a URDF; once for many frames
    camera = Camera(640, 480, fx=1042.6, fy=1042.6, cx=326.3, cy=235.1)  # pixels
    grey = cv2.imread(str(DEMO / "masks" / "0001.png"), cv2.IMREAD_GRAYSCALE)
    assert grey is not None  # the file was read
    mask = np.asarray(grey > 127)  # (480, 640) bool
    readings = {"wrist_pitch": -0.223, "wrist_yaw": 0.557, "jaw": 0.835}  # radians; one that is missing is unknown

    result = estimate(mask, camera, readings, body)

    print("status:", result.status, *result.reasons)
    assert result.camera_from_root is not None  # (4, 4); only a failed frame has none
    assert result.expected_error is not None
    x, y, z = 1e3 * result.camera_from_root[:3, 3]
    print(f"wrist in the camera: {x:.1f} mm right, {y:.1f} mm down, {z:.1f} mm forward")
    for name, found in result.joints.items():
        print(f"{name}: found {found:+.3f} rad, read {readings[name]:+.3f} rad")
    print(result.expected_error.in_words)


if __name__ == "__main__":
    main()
