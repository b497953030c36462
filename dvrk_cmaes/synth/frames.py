"""Frames with known truth: poses of an instrument before a camera, and readings that are wrong the way a robot's are.

A session's poses are those of an arm moving about its RCM, drawn at random and kept when the picture is a sensible one;
a single pose can also be aimed. Random numbers come from the generator that is handed in, so a seed gives the same
frames again. How a mask or an image of a frame looks is the business of ``synth.masks`` and ``synth.images``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.arm import OUTER_JOINTS, base_from_root
from dvrk_cmaes.camera import Camera
from dvrk_cmaes.geometry import frame_along, rotation_about_z, transform
from dvrk_cmaes.instrument import Instrument
from dvrk_cmaes.silhouette import Body, Renderer
from dvrk_cmaes.synth.masks import lump_of_tissue
from dvrk_cmaes.synth.views import trace_links

Float64 = NDArray[np.float64]

WRIST_JOINTS: Final = ("wrist_pitch", "wrist_yaw", "jaw")

READING_ERRORS: Final = {  # rms; rad, insertion in m
    "yaw": np.deg2rad(0.1),
    "pitch": np.deg2rad(0.1),
    "insertion": 0.0004,
    "roll": np.deg2rad(5.0),
    "wrist_pitch": np.deg2rad(5.0),
    "wrist_yaw": np.deg2rad(5.0),
    "jaw": np.deg2rad(7.5),
}
BIAS_SHARE: Final = 0.8  # of that error, the same in all frames of a session; what is left is noise

LEAST_BEND: Final = np.deg2rad(26.0)  # of pitch and yaw together: an unbent wrist looks like its mirror twin
MARGIN: Final = 45.0  # px between the border and the wrist or the tips
DEPTHS: Final = (0.07, 0.16)  # m
LEAST_JAW_PIXELS: Final = 700  # at 640 x 480
LEAST_SHAFT: Final = 0.010  # m of its straight part that are in view
LEAST_TILT: Final = np.deg2rad(28.0)  # between the shaft and the optical axis


@dataclass(frozen=True, eq=False)
class Truth:
    """Where the instrument truly is: ``camera_from_root`` (4, 4), and joints by name, the outer arm's too if known."""

    instrument: Instrument
    camera_from_root: Float64
    joints: Mapping[str, float]
    outer: Mapping[str, float] = field(default_factory=dict)

    @property
    def values(self) -> Float64:
        """Joints in the instrument's order, (J,)."""
        return np.array([self.joints[name] for name in self.instrument.joint_names])

    @property
    def tips(self) -> Float64:
        """Jaw tips in the camera's frame, (2, 3) m."""
        return self._in_camera(self.instrument.tips(self.values))

    @property
    def wrist(self) -> Float64:
        """Pitch and yaw axis, the last two points of the skeleton before the tips, in the camera's frame, (2, 3) m."""
        return self._in_camera(self.instrument.skeleton(self.values)[-4:-2])

    def point_on_shaft(self, distance: float) -> Float64:
        """Point of the shaft's axis that is a distance, m, before the end of its straight part; in the camera, (3,)."""
        shaft = self.instrument.shaft
        if shaft is None:
            raise ValueError(f"{self.instrument.name} has no shaft")
        return self._in_camera(shaft.point + (shaft.distal_end - distance) * shaft.direction)

    def _in_camera(self, points: Float64) -> Float64:
        return np.asarray(points @ self.camera_from_root[:3, :3].T + self.camera_from_root[:3, 3])


def exact_mask(body: Body, camera: Camera, truth: Truth) -> NDArray[np.bool_]:
    """Pixels covered by more than half, (H, W)."""
    coverage = Renderer(body, camera, threads=1).coverage(
        truth.camera_from_root[None], truth.values[None], lines_per_pixel=4
    )
    return np.asarray(coverage[0] > 0.5)


def aimed(
    camera: Camera, *, wrist: tuple[float, float], depth: float, tilt: float, heading: float, roll: float
) -> Float64:
    """Aim an instrument: ``camera_from_root`` (4, 4).

    Parameters
    ----------
    camera
        The camera it is seen by.
    wrist
        Pixel (u, v) where the root's origin appears.
    depth
        Its z, m.
    tilt
        Angle between the shaft, distally, and the optical axis, rad.
    heading
        Where the shaft points in the image, rad: 0 to the right, a quarter turn downwards.
    roll
        Turn about the shaft, rad; at 0 the root's x axis is in the plane of the shaft and the optical axis.
    """
    direction = np.array([np.sin(tilt) * np.cos(heading), np.sin(tilt) * np.sin(heading), np.cos(tilt)])
    across = np.array([-np.sin(heading), np.cos(heading), 0.0])
    rotation = np.stack([np.cross(across, direction), across, direction], axis=-1) @ rotation_about_z(roll)
    position = depth * np.append(camera.normalise(np.array(wrist)), 1.0)
    return transform(rotation, position)


def random_session(
    body: Body, camera: Camera, rng: np.random.Generator, frames: int, *, attempts: int = 20_000
) -> tuple[Float64, list[Truth]]:
    """Place an arm before a camera and move it about its RCM, until there are enough sensible frames.

    Returns
    -------
    camera_from_base : (4, 4)
    truths
        One a frame.

    Raises
    ------
    RuntimeError
        The attempts are used up.
    """
    while attempts > 0:
        camera_from_base = _random_base(rng)
        found: list[Truth] = []
        for _ in range(60 * frames):
            attempts -= 1
            truth = _random_truth(body.instrument, camera_from_base, rng)
            if is_sensible(body, camera, truth):
                found.append(truth)
            if len(found) == frames:
                return camera_from_base, found
    raise RuntimeError("no arm was found whose frames are sensible")


def _random_base(rng: np.random.Generator) -> Float64:
    """Pose of an arm that reaches the middle of the view from one side."""
    middle = np.array([rng.uniform(-0.006, 0.006), rng.uniform(-0.006, 0.006), rng.uniform(0.10, 0.12)])
    tilt, heading = np.deg2rad(rng.uniform(48, 68)), rng.uniform(-np.pi, np.pi)
    direction = np.array([np.sin(tilt) * np.cos(heading), np.sin(tilt) * np.sin(heading), np.cos(tilt)])
    rcm_to_root = np.linalg.norm(base_from_root([0.0, 0.0, rng.uniform(0.12, 0.15), 0.0])[:3, 3])
    # at rest the shaft points against the base's z axis
    rotation = frame_along(-direction) @ rotation_about_z(rng.uniform(-np.pi, np.pi))
    return transform(rotation, middle - rcm_to_root * direction)


def _random_truth(instrument: Instrument, camera_from_base: Float64, rng: np.random.Generator) -> Truth:
    outer = dict(
        zip(
            OUTER_JOINTS,
            (*rng.uniform(-0.25, 0.25, 2), rng.uniform(0.10, 0.17), rng.uniform(-2.0, 2.0)),
            strict=True,
        )
    )
    pitch, yaw = rng.uniform(-1.0, 1.0, 2)
    joints = dict(zip(WRIST_JOINTS, (pitch, yaw, rng.uniform(0.15, 1.1)), strict=True))
    return Truth(instrument, camera_from_base @ base_from_root(outer), joints, outer)


def is_sensible(body: Body, camera: Camera, truth: Truth) -> bool:
    """Whether a surgeon would see the tool so: wrist and open jaws well in view, the shaft from the border."""
    points = np.concatenate([truth.wrist, truth.tips])
    size = np.array([camera.width, camera.height])
    if points[:, 2].min() < DEPTHS[0] or points[:, 2].max() > DEPTHS[1]:
        return False
    pixels = camera.project(points)
    if np.any(pixels < MARGIN) or np.any(pixels > size - 1 - MARGIN):
        return False
    on_shaft = truth.point_on_shaft(LEAST_SHAFT)
    if truth.camera_from_root[2, 2] > np.cos(LEAST_TILT) or on_shaft[2] < DEPTHS[0] / 2:
        return False
    if np.any(camera.project(on_shaft) < 0) or np.any(camera.project(on_shaft) > size - 1):
        return False
    if np.hypot(truth.joints["wrist_pitch"], truth.joints["wrist_yaw"]) < LEAST_BEND:
        return False
    link = trace_links(truth.instrument, camera, truth.camera_from_root, truth.values).link
    border = np.concatenate([link[0], link[-1], link[:, 0], link[:, -1]])
    root, jaws = 0, [tip.link for tip in truth.instrument.jaw_tips]
    scale = camera.width * camera.height / (640 * 480)
    return bool(
        (border == root).sum() >= 20
        and not np.any(border > root)
        and all((link == jaw).sum() >= LEAST_JAW_PIXELS / 2 * scale for jaw in jaws)
    )


def session_readings(truths: Sequence[Truth], rng: np.random.Generator) -> list[dict[str, float]]:
    """Make readings of all joints of a session's frames, wrong by ``READING_ERRORS``.

    Drawn anew until the wrist's errors have about that root mean square over these very frames, and the readings are
    clearly nearer to the truth than to its mirror twin in each of them.
    """
    noise = np.sqrt(1.0 - BIAS_SHARE**2)
    while True:
        bias = {name: rng.choice([-1.0, 1.0]) * BIAS_SHARE * rms for name, rms in READING_ERRORS.items()}
        errors = [
            {name: bias[name] + noise * rms * rng.standard_normal() for name, rms in READING_ERRORS.items()}
            for _ in truths
        ]
        rms = {name: np.sqrt(np.mean([error[name] ** 2 for error in errors])) for name in WRIST_JOINTS}
        if any(abs(rms[name] / READING_ERRORS[name] - 1) > 0.2 for name in WRIST_JOINTS):
            continue
        readings = [
            {name: value + error[name] for name, value in {**truth.outer, **truth.joints}.items()}
            for truth, error in zip(truths, errors, strict=True)
        ]
        if all(tells_twin_apart(truth, reading) for truth, reading in zip(truths, readings, strict=True)):
            return readings


def tells_twin_apart(truth: Truth, reading: Mapping[str, float]) -> bool:
    """Whether the readings of pitch and yaw are less than half as far from the truth as from its mirror twin."""
    _, twin = truth.instrument.twin(truth.camera_from_root, truth.values)
    names = truth.instrument.joint_names
    read = np.array([reading[name] for name in names])
    bends = [k for k, name in enumerate(names) if name in ("wrist_pitch", "wrist_yaw")]
    to_truth = np.linalg.norm((read - truth.values)[bends])
    return bool(to_truth < 0.5 * np.linalg.norm((read - twin)[bends]))


def tissue_before_a_jaw(
    camera: Camera, truth: Truth, rng: np.random.Generator, *, radius: float = 62.0, hidden: float = 0.0035
) -> NDArray[np.bool_]:
    """Lay a lump of tissue, of a radius in px, before the end of one jaw and hide some length of it, m: (H, W)."""
    tip, other = camera.project(truth.tips)
    hinge = camera.project(truth.wrist)[1]
    away = (tip - hinge) / np.linalg.norm(tip - hinge) + (tip - other) / np.linalg.norm(tip - other)
    away /= np.linalg.norm(away)
    inside = hidden * camera.fx / truth.tips[0, 2]
    return lump_of_tissue((camera.height, camera.width), rng, tip + (radius - inside) * away, radius)
