"""Two instruments of which the nearer hides a part of the other, with exact masks."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from dvrk_cmaes.camera import Camera
from dvrk_cmaes.camera.ros import write_camera_info
from dvrk_cmaes.geometry import transform
from dvrk_cmaes.io.atomic import write_image
from dvrk_cmaes.pose.search.starts import lookat_pose
from dvrk_cmaes.results.result import Result
from dvrk_cmaes.silhouette import Body
from dvrk_cmaes.synth.truth import Truth
from dvrk_cmaes.synth.two_arms import tool_depth

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
        return [tool_depth(self.body, self.camera, truth) for truth in truths]

    @property
    def masks(self) -> tuple[np.ndarray, np.ndarray]:
        """Masks (H, W) of what is seen of each tool."""
        first, second = self.depths
        return np.isfinite(first) & (first <= second), np.isfinite(second) & (second < first)

    def values(self, tool: int) -> dict[str, float]:
        """Give the joints of a tool by name."""
        return dict(zip(self.body.instrument.joint_names, self.joints[tool].tolist(), strict=True))

    def result(self, tool: int, *, std_m: float = 3e-4, std_rad: float = 0.01, probability: float = 1.0) -> Result:
        """Give the true pose of a tool as a result with standard deviations."""
        return Result(
            frame="0000",
            status="ok",
            reasons=(),
            instrument=self.body.instrument.name,
            root_link=self.body.instrument.root_link,
            camera_from_root=self.poses[tool],
            joints=self.values(tool),
            readings={},
            covariance=np.diag([std_m] * 3 + [std_rad] * (3 + len(self.joints[tool]))) ** 2,
            mode_probability=probability,
        )


def write_crossing_session(folder: Path, body: Body) -> Path:
    """Write a session of two arms, with masks of labels; returns the folder.

    In frame 0000 PSM1 is before PSM2, in 0001 behind it, in 0002 they are apart, and 0003 shows PSM1 only.
    """
    (folder / "masks").mkdir(parents=True)
    write_camera_info(folder / "camera.yaml", CAMERA, "endoscope")
    before, apart = CrossingTools(body), CrossingTools(body, APART)
    behind = CrossingTools(body, (FAR, NEAR), JOINTS[::-1])
    frames = {"0000": before, "0001": behind, "0002": apart, "0003": apart}
    lines = ['[camera]\nfile = "camera.yaml"']
    for number, arm in enumerate(ARMS, start=1):
        rows = [",".join(["frame", *body.instrument.joint_names])]
        rows += [",".join([name, *map(str, tools.joints[number - 1] + 0.06)]) for name, tools in frames.items()]
        (folder / f"joints_{arm}.csv").write_text("\n".join(rows) + "\n", encoding="utf-8")
        lines.append(f'[[tool]]\narm = "{arm}"\ninstrument = "lnd"\nlabel = {number}\njoints = "joints_{arm}.csv"')
    (folder / "session.toml").write_text("\n".join(lines) + "\n", encoding="utf-8")
    for name, tools in frames.items():
        first, second = tools.masks
        labels = first.astype(np.uint8) + 2 * (second & (name != "0003"))
        write_image(folder / "masks" / f"{name}.png", labels.astype(np.uint8))
    return folder
