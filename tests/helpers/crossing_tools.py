"""Two instruments of which the nearer hides a part of the other, with exact masks."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from dvrk_cmaes import Body, Camera
from dvrk_cmaes.synth.scene import tool_depth
from dvrk_cmaes.synth.truth import Truth
from helpers.transforms import lookat_pose, transform

CAMERA = Camera(320, 240, 513.0, 513.0, 161.0, 119.0)
ARMS = ("PSM1", "PSM2")
NEAR, FAR = lookat_pose(0.5, 1.0, 0.7, 0.11), lookat_pose(0.5, 2.0, -0.75, 0.13)
APART = transform(np.eye(3), [-0.02, 0.0, 0.0]) @ NEAR, transform(np.eye(3), [0.03, 0.0, 0.0]) @ FAR
JOINTS = np.array([0.4, -0.3, 0.5]), np.array([-0.5, 0.4, 0.9])


@dataclass(frozen=True, eq=False)
class CrossingTools:
    """Two tools in one view: their poses (4, 4) in its camera, and joints (3,)."""

    body: Body
    poses: tuple[np.ndarray, np.ndarray] = (NEAR, FAR)
    joints: tuple[np.ndarray, np.ndarray] = JOINTS
    camera: Camera = CAMERA

    @cached_property
    def depths(self) -> list[np.ndarray]:
        """Depth (H, W) of each tool, m, infinite where it is not."""
        truths = [Truth(self.body.instrument, self.poses[tool], self.values(tool)) for tool in (0, 1)]
        return [tool_depth(self.camera, truth) for truth in truths]

    @property
    def masks(self) -> tuple[np.ndarray, np.ndarray]:
        """Masks (H, W) of what is seen of each tool."""
        first, second = self.depths
        return np.isfinite(first) & (first <= second), np.isfinite(second) & (second < first)

    def values(self, tool: int) -> dict[str, float]:
        """Give the joints of a tool by name."""
        return dict(zip(self.body.instrument.joint_names, self.joints[tool].tolist(), strict=True))
