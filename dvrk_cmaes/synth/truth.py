"""True pose and joints of an instrument in a frame."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from dvrk_cmaes.camera import Camera
from dvrk_cmaes.frames.truth import FrameTruth
from dvrk_cmaes.geometry import Float64, apply, rotation_about_z, transform
from dvrk_cmaes.instrument import Instrument


@dataclass(frozen=True, eq=False)
class Truth:
    """True pose and joints of an instrument.

    camera_from_root : (4, 4).
    joints : of the instrument, by name, rad. outer : of the outer arm, by name, rad and m; empty if unknown.
    """

    instrument: Instrument
    camera_from_root: Float64
    joints: Mapping[str, float]
    outer: Mapping[str, float] = field(default_factory=dict)

    @property
    def values(self) -> Float64:
        """Joint values in the instrument's order, (J,)."""
        return np.array([self.joints[name] for name in self.instrument.joint_names])

    @property
    def tips(self) -> Float64:
        """Jaw tips in the camera's frame, (2, 3) m; (0, 3) without jaws."""
        return self._in_camera(self.instrument.tips(self.values))

    @property
    def stated(self) -> FrameTruth:
        """What a session's golden.json states."""
        return FrameTruth(self.camera_from_root, {**self.joints, **self.outer}, self.tips)

    @property
    def wrist(self) -> Float64:
        """Points (2, 3) of the skeleton on the pitch and the yaw axis, its last before the tips, m in the camera."""
        tips = len(self.instrument.jaw_tips)
        return self._in_camera(self.instrument.skeleton(self.values)[-2 - tips :][:2])

    def point_on_shaft(self, distance: float) -> Float64:
        """Return the point (3,) on the shaft's axis at a distance, m, from its distal end, in the camera's frame, m."""
        shaft = self.instrument.shaft
        if shaft is None:
            raise ValueError(f"{self.instrument.name} has no shaft")
        return self._in_camera(shaft.point + (shaft.distal_end - distance) * shaft.direction)

    def _in_camera(self, points: Float64) -> Float64:
        return apply(self.camera_from_root, points)


def pose_from_view(
    camera: Camera, *, wrist: tuple[float, float], depth: float, tilt: float, heading: float, roll: float
) -> Float64:
    """Return the pose ``camera_from_root`` (4, 4) of an instrument from its position and directions in the image.

    Parameters
    ----------
    camera
        The camera.
    wrist
        Pixel (u, v) of the root's origin.
    depth
        Depth (z) of the root's origin, m.
    tilt
        Angle between the shaft's distal direction and the optical axis, rad.
    heading
        Direction of the shaft in the image, rad: 0 to the right, pi / 2 downwards.
    roll
        Rotation about the shaft, rad; at 0 the root's x axis is in the plane of the shaft and the optical axis.
    """
    direction = np.array([np.sin(tilt) * np.cos(heading), np.sin(tilt) * np.sin(heading), np.cos(tilt)])
    across = np.array([-np.sin(heading), np.cos(heading), 0.0])
    rotation = np.stack([np.cross(across, direction), across, direction], axis=-1) @ rotation_about_z(roll)
    position = depth * np.append(camera.normalise(np.array(wrist)), 1.0)
    return transform(rotation, position)
