"""Pictures of instruments, drawn by rays before tissue or before things of a laboratory, with exact masks.

Instruments, cameras and motion are those of the worlds of ``scripts/worlds``. Shafts have a hue of their own; behind
them are plates, strips and boxes of all colours, whose straight edges are no shaft's.
"""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray
from worlds.drawing import draw_image, draw_tools
from worlds.motion import draw_motion, frame_times
from worlds.table import World, worlds

from dvrk_cmaes.errors import DvrkCmaesError
from measure.pictures import Picture

Float32 = NDArray[np.float32]

_LARGEST: Final = 800  # px, width of the pictures; larger worlds take long to draw
_THINGS: Final = 3, 9  # in a laboratory
_READ_DEG: Final = 3.0  # standard deviation of the readings


def drawn_picture(seed: int) -> Picture | None:
    """Draw a picture of a seed, half of them before tissue, and half with readings; None where no motion is in view."""
    rng = np.random.default_rng(seed)
    table = drawn_worlds()
    number = int(rng.permutation(len(table))[0])
    world = replace(table[number], colour="colour")
    try:
        moving = [draw_motion(world, seed, place) for place in range(world.tools)]
    except DvrkCmaesError:
        return None
    times = frame_times(world, "session", 4)
    placed = [own.placed(times)[int(rng.integers(4))] for own in moving]
    seen = draw_tools(world.camera, placed)
    covered = np.asarray(seen.coverage.sum(axis=0).clip(0, 1), np.float32)[..., None]
    image = draw_image(world, seed, number, seen) * np.where(covered > 0, rng.uniform(0.6, 1.4, 3), 1.0)
    if number % 2:
        image = covered * image + (1 - covered) * _laboratory(image.shape[:2], rng)
    readings = placed[0].joints + np.deg2rad(_READ_DEG) * rng.standard_normal(len(placed[0].joints))
    joints = dict(zip(moving[0].instrument.joint_names, readings.tolist(), strict=True)) if number % 4 < 2 else {}
    tools = tuple(np.asarray(share > 0.5) for share in seen.coverage if (share > 0.5).any())
    drawn = np.clip(image, 0, 255).astype(np.uint8)
    return Picture("drawn", str(seed), drawn, world.camera, world.instrument, False, joints, tools)


@lru_cache(maxsize=1)
def drawn_worlds() -> list[World]:
    """Return the worlds of which pictures are drawn: small ones without a border."""
    return [world for world in worlds() if world.size[0] <= _LARGEST and world.border == "none"]


def _laboratory(size: tuple[int, int], rng: np.random.Generator) -> Float32:
    """Draw things of a laboratory, (H, W, 3): rectangles and strips in any direction, lit from one side."""
    height, width = size
    scene = np.full((height, width, 3), rng.uniform(40, 220, 3), np.float32)
    for _ in range(int(rng.integers(*_THINGS))):
        centre = rng.uniform(0, 1, 2) * (width, height)
        long, wide = rng.uniform(0.2, 1.2) * width, rng.uniform(0.03, 0.5) * width
        corners = cv2.boxPoints(((float(centre[0]), float(centre[1])), (float(long), float(wide)), rng.uniform(0, 180)))
        colour = rng.uniform(10, 245) * np.clip(1 + rng.choice([0.05, 0.4]) * rng.standard_normal(3), 0.1, 1.6)
        shadow = scene.copy()
        cv2.fillConvexPoly(
            shadow, (corners + rng.uniform(2, 12, 2)).astype(np.int32), (scene.mean(axis=(0, 1)) * 0.5).tolist()
        )
        scene = 0.5 * scene + 0.5 * cv2.GaussianBlur(shadow, (0, 0), 4)
        cv2.fillConvexPoly(scene, corners.astype(np.int32), np.clip(colour, 5, 250).tolist())
    light = np.linspace(rng.uniform(0.6, 1), rng.uniform(0.6, 1), width, dtype=np.float32)[None, :, None]
    noise = rng.standard_normal(scene.shape).astype(np.float32)
    return np.asarray(cv2.GaussianBlur(scene, (0, 0), 1.0) * light + 3 * noise, np.float32)
