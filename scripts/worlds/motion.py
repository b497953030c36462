"""Motion of the instruments of a world, each on an arm about its remote centre of motion, and the arm's readings."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.errors import DvrkCmaesError
from dvrk_cmaes.geometry import apply, frame_along, inverse, rotation_about_z, transform
from dvrk_cmaes.instrument import Instrument, load_instrument
from dvrk_cmaes.instrument.arm import INSERTION_OFFSET, OUTER_JOINTS, base_from_root
from dvrk_cmaes.synth.levels import LEVELS, Level
from dvrk_cmaes.synth.scene import NEAREST, Scene
from dvrk_cmaes.synth.truth import Truth
from worlds.table import World

Float64 = NDArray[np.float64]
Kind = Literal["session", "recording"]
"""A session has frames some time apart, a recording consecutive ones."""

NOMINAL: Final[Mapping[Kind, int]] = {"session": 10, "recording": 30}
"""Numbers of frames for which a motion is drawn; fewer are the first of these."""
START: Final = 1.5
"""Time of the first image, s; readings begin at 0."""
CLOCK: Final = 1000.0
"""What the clock shows at time 0, s."""
PAUSE: Final = 1.3
"""Time between the frames of a session, s."""
LARGEST_LAG: Final = 0.12
"""Largest lag of the images behind the readings at the level hard, s."""

BIAS_SHARE: Final = 0.8
"""Share of a recording's bias in the rms error of a reading; the rest wanders."""

_TILTS: Final = {"easy": (35.0, 70.0), "hard": (20.0, 75.0)}  # deg, of the shaft to the optical axis
_SPEEDS: Final = {"easy": 1.0, "hard": 1.6}
_PERIODS: Final = (4.0, 9.0)  # s, at speed 1
_REACH: Final = (0.10, 0.17)  # m, from the remote centre of motion to the wrist
_SWING: Final = 0.15  # largest motion of the wrist in the image, of its smaller side
_SHRINK: Final = 0.99  # factor on the motion with each one that was refused
_BENDS: Final = (0.5, 1.0)  # rad, of the wrist in the middle of its motion
_AMPLITUDES: Final = {"roll": 0.6, "jaw": 0.35}  # rad; of any other joint of the instrument 0.2
_LEAST_SEEN: Final = {"easy": 0.7, "hard": 0.5}  # share of the ends
_LOOKED_AT: Final = 8  # frames, one of which is looked at for hidden ends
_NOISE: Final = 0.001  # rad, of each reading of a joint that wanders
_TRIES: Final = 3000
_HIDDEN: Final = 1.5e-3  # m, by which what a ray meets must be nearer than an end to hide it


@dataclass(frozen=True, eq=False)
class Moving:
    """An instrument that moves: its arm's base in the camera (4, 4), and the paths of its joints.

    Each joint is at its middle plus three waves: ``amplitudes``, ``periods`` (s) and ``phases`` are (J, 3), of yaw,
    pitch, insertion and roll and then of the instrument's joints.
    """

    instrument: Instrument
    world: World
    camera_from_base: Float64
    middle: Float64
    amplitudes: Float64
    periods: Float64
    phases: Float64

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the joints in the order of the paths."""
        return (*OUTER_JOINTS, *self.instrument.joint_names)

    def joints(self, times: Float64) -> Float64:
        """Return the true joints (T, J) at times (T,), within the instrument's limits."""
        waves = np.sin(2 * np.pi * times[:, None, None] / self.periods + self.phases)
        values = self.middle + (self.amplitudes * waves).sum(axis=-1)
        values[:, 4:] = np.clip(values[:, 4:], *self.instrument.limits.T)
        return np.asarray(values)

    def poses(self, joints: Float64) -> Float64:
        """Return ``camera_from_root`` (T, 4, 4) with joints (T, J)."""
        offset = self.instrument.roll_offset
        return np.asarray(self.camera_from_base @ base_from_root(joints[:, :4], self.world.arm, roll_offset=offset))

    def placed(self, times: Float64) -> list[Truth]:
        """Return the instrument as it is at times (T,), s."""
        joints = self.joints(times)
        values = (dict(zip(self.names[4:], row, strict=True)) for row in joints[:, 4:].tolist())
        return [Truth(self.instrument, *each) for each in zip(self.poses(joints), values, strict=True)]

    def points(self, times: Float64) -> Float64:
        """Return wrist and ends (T, P, 3) in the camera, m."""
        joints = self.joints(times)
        poses = self.poses(joints)
        ends = apply(poses, self.instrument.ends(joints[:, 4:]))
        return np.concatenate([poses[:, None, :3, 3], ends], axis=1)


@dataclass(frozen=True, eq=False)
class Readings:
    """Readings of an arm: times (R,), s, and values (R, J) by the names of its joints."""

    times: Float64
    values: Float64


@lru_cache(maxsize=8)
def instrument_of(source: str) -> Instrument:
    """Load an instrument; those of a few worlds are kept."""
    return load_instrument(source, use_cache=True)


def frame_times(world: World, kind: Kind, count: int) -> Float64:
    """Return the times (F,) at which the frames of a session or a recording show the instrument, s."""
    return np.asarray(START + np.arange(count) * (PAUSE if kind == "session" else 1 / world.images_hz), np.float64)


def lag_of(world: World, seed: int) -> float:
    """Return the lag of the images behind the readings, s: none at the level easy."""
    return float(_generator(world, seed, 1).uniform(0, LARGEST_LAG)) if world.level == "hard" else 0.0


def draw_motion(world: World, seed: int, place: int = 0) -> Moving:
    """Draw the motion of an instrument of a world: of the first (``place`` 0), or of another, from the other side.

    Wrist and ends stay in the picture in all frames of its session and its recording, and its ends are not hidden by
    itself in most of some of these; of another instrument only the wrist stays in the picture.

    Raises
    ------
    DvrkCmaesError
        No such motion was found.
    """
    rng, instrument = _generator(world, seed, 2, place), instrument_of(world.instrument)
    times = np.concatenate([frame_times(world, kind, count) for kind, count in NOMINAL.items()])
    for tries in range(_TRIES):
        moving = _drawn(world, instrument, rng, place, swing=_SWING * max(0.2, _SHRINK**tries))
        points = moving.points(times)
        if place and in_picture(world, points[:, :1]):
            return moving
        if not place and in_picture(world, points) and _ends_are_seen(world, moving.placed(times[::_LOOKED_AT])):
            return moving
    raise DvrkCmaesError(f"world {world.number}: no motion was found that keeps {instrument.name} in the picture")


def _ends_are_seen(world: World, placed: Sequence[Truth]) -> bool:
    """Whether the instrument hides few enough of its ends over some frames."""
    most_hidden = (1 - _LEAST_SEEN[world.level]) * len(placed)
    hidden = 0.0
    for one in placed:
        hidden += 1 - ends_seen([one], 0)
        if hidden > most_hidden:
            return False
    return True


def ends_seen(tools: Sequence[Truth], number: int) -> float:
    """Return the share of the ends of a tool that are before the camera and not hidden by it or another tool."""
    placed = tools[number]
    ends = apply(placed.camera_from_root, placed.instrument.ends(placed.values))
    _, depth = Scene(tools).hits((ends / ends[:, 2:]).astype(np.float32))
    return float(np.mean((depth > ends[:, 2] - _HIDDEN) | (depth <= NEAREST)))


def in_picture(world: World, points: Float64) -> bool:
    """Whether points (..., 3) in the camera, m, are before it and inside the picture, with a margin."""
    if points[..., 2].min() < 0.5 * world.distance:
        return False
    size = np.array(world.size)
    off = np.abs(world.camera.project(points) - (size - 1) / 2)
    if world.border == "circle" and (np.linalg.norm(off, axis=-1) > 0.9 * circle_radius(world)).any():
        return False
    room = np.array([0.45 - bar_share(world), 0.45]) * size
    return bool((off < room).all())


def circle_radius(world: World) -> float:
    """Return the radius of the picture where a border is a circle, px."""
    return 0.44 * float(np.hypot(*world.size))


def bar_share(world: World) -> float:
    """Return the width of each of two bars beside the picture, in widths of the image; 0 without."""
    return 0.08 if world.border == "bars" else 0.0


def read_motion(world: World, seed: int, moving: Moving, kind: Kind, place: int = 0) -> Readings:
    """Draw the readings of an arm while it moves, from time 0 to some time after the last frame.

    Roll, wrist and jaw have the level's bias and wander slowly; the other joints have noise. The readings of the wrist
    are nearer to the truth than to its mirror twin's, which has pitch and yaw negated, in all frames.

    Raises
    ------
    DvrkCmaesError
        No such readings were found.
    """
    rng = _generator(world, seed, 3, place)
    frames = frame_times(world, kind, NOMINAL[kind])
    times = np.arange(0.0, frames[-1] + START, 1 / world.readings_hz)
    bias_std, noise_std = errors_of(LEVELS[world.level], moving.names)
    bends = [k for k, name in enumerate(moving.names) if name in ("wrist_pitch", "wrist_yaw")]
    true = moving.joints(frames)[:, bends]
    for _ in range(_TRIES):
        bias = bias_std * rng.standard_normal(len(bias_std))
        wander = np.where(bias_std > 0, np.sqrt(2) * noise_std, 0.0)
        periods, phases = rng.uniform(8.0, 20.0, len(bias)), rng.uniform(0, 2 * np.pi, len(bias))

        turn = 2 * np.pi / periods
        off = (bias + wander * np.sin(turn * frames[:, None] + phases))[:, bends]
        if (np.linalg.norm(off, axis=1) < np.linalg.norm(2 * true + off, axis=1)).all():
            error = bias + wander * np.sin(turn * times[:, None] + phases)
            noise = np.where(bias_std > 0, _NOISE, noise_std) * rng.standard_normal(error.shape)
            return Readings(times, moving.joints(times) + error + noise)
    raise DvrkCmaesError(f"world {world.number}: no readings were found that tell all frames from their mirror twins")


def errors_of(level: Level, names: Sequence[str]) -> tuple[Float64, Float64]:
    """Return the standard deviations (J,) of bias and noise of joints' readings, rad; of the insertion in m.

    Those of joints without a bias are noise of each reading, those of the others wander.
    """
    rms = {"roll": level.roll_deg, "jaw": level.jaw_ratio * level.wrist_deg}
    arm = {"yaw": np.deg2rad(level.arm_deg), "pitch": np.deg2rad(level.arm_deg), "insertion": 1e-3 * level.insertion_mm}
    sizes = [0.0 if name in arm else np.deg2rad(rms.get(name, level.wrist_deg)) for name in names]
    noise = [arm.get(name, np.sqrt(1 - BIAS_SHARE**2) * size) for name, size in zip(names, sizes, strict=True)]
    return BIAS_SHARE * np.array(sizes), np.array(noise)


def _drawn(world: World, instrument: Instrument, rng: np.random.Generator, place: int, swing: float) -> Moving:
    """Draw a motion whose middle has the wrist near the middle of the picture."""
    camera, (width, height) = world.camera, world.size
    mirrored = (world.side == "right") != (place > 0)
    across = rng.uniform(0.35, 0.65) if place == 0 else rng.uniform(0.55, 0.85) if mirrored else rng.uniform(0.15, 0.45)
    pixel = np.array([across * width, rng.uniform(0.3, 0.7) * height])
    depth = world.distance * rng.uniform(0.92, 1.08)
    position = depth * np.append(camera.normalise(pixel), 1.0)
    tilt = np.deg2rad(rng.uniform(*_TILTS[world.level]))
    heading = np.deg2rad(rng.uniform(-50, 50)) + (np.pi if mirrored else 0.0)
    direction = np.array([np.sin(tilt) * np.cos(heading), np.sin(tilt) * np.sin(heading), np.cos(tilt)])
    reach = rng.uniform(*_REACH)
    outer = [*rng.uniform(-0.4, 0.4, 2), reach - INSERTION_OFFSET[world.arm] - instrument.roll_offset]
    outer.append(rng.uniform(-1.5, 1.5))
    pose = transform(frame_along(direction) @ rotation_about_z(rng.uniform(-np.pi, np.pi)), position)
    base = pose @ inverse(base_from_root(outer, world.arm, roll_offset=instrument.roll_offset))
    bend, towards = rng.uniform(*_BENDS), rng.uniform(0, 2 * np.pi)
    centre = {"wrist_pitch": bend * np.cos(towards), "wrist_yaw": bend * np.sin(towards), "jaw": rng.uniform(0.4, 0.9)}
    inner = [
        centre.get(name, rng.uniform(*limits))
        for name, limits in zip(instrument.joint_names, instrument.limits, strict=True)
    ]
    moved = swing * depth * min(width, height) / (world.focal * width)  # m, of the wrist
    sizes = [min(0.25, moved / reach)] * 2 + [min(0.02, moved), _AMPLITUDES["roll"]]
    sizes += [_AMPLITUDES.get(name, 0.2) for name in instrument.joint_names]
    return Moving(
        instrument,
        world,
        np.asarray(base),
        np.array([*outer, *inner]),
        np.array(sizes)[:, None] * rng.dirichlet(np.ones(3), len(sizes)),
        rng.uniform(*_PERIODS, (len(sizes), 3)) / _SPEEDS[world.level],
        rng.uniform(0, 2 * np.pi, (len(sizes), 3)),
    )


def _generator(world: World, seed: int, *stream: int) -> np.random.Generator:
    """Return the random numbers of a part of a world."""
    return np.random.default_rng([seed, world.number, *stream])
