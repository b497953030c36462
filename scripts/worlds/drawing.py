"""Shaded images of instruments of a world, before tissue and with a border."""

from __future__ import annotations

from functools import lru_cache
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.geometry import apply, inverse
from dvrk_cmaes.synth.masks import smooth_noise
from dvrk_cmaes.synth.scene import Scene, Seen
from worlds.motion import bar_share, circle_radius
from worlds.table import World

Float32 = NDArray[np.float32]
Bool = NDArray[np.bool_]

_TISSUE: Final = (960, 720)  # px, at which the background is drawn, whatever the image's size
_DARK: Final = np.array([0.08, 0.08, 0.28])  # of the tissue, BGR
_PALE: Final = np.array([0.25, 0.28, 0.58])
_ALBEDO: Final = (0.10, 0.52)  # of the shaft, and of steel
_BLUR: Final = 0.5  # px, of the image


def _shading(seen: Seen) -> Float32:
    """Return the brightness (H, W) of instruments, lit from the camera; beside them that of their border."""
    around = np.ones((2 * seen.step + 1, 2 * seen.step + 1), np.uint8)
    bright = np.zeros(seen.face.shape, np.float32)
    hit = seen.face >= 0
    if hit.any():
        face, depth = seen.face[hit], seen.depth[hit]
        towards = seen.rays[hit] / np.linalg.norm(seen.rays[hit], axis=1, keepdims=True)
        facing = np.abs((seen.scene.normals(face) * towards).sum(axis=1))
        steel = _steel(seen.scene, face)
        light = np.clip(np.median(depth) / depth, 0.5, 1.5)
        gloss = np.where(steel, 0.7, 0.1) * facing**20
        bright[hit] = np.clip((np.where(steel, *_ALBEDO[::-1]) * (0.25 + 0.75 * facing) + gloss) * light, 0.02, 1)
    shading = seen.whole(bright)
    return np.where(shading > 0, shading, cv2.dilate(shading, around))


def _steel(scene: Scene, face: NDArray[np.int64]) -> Bool:
    """Return whether triangles (N,) are beyond the end of the black shaft."""
    found = scene.link[face] > 0
    for number, placed in enumerate(scene.tools):
        shaft, own = placed.instrument.shaft, scene.tool[face] == number
        if shaft is not None:
            middles = scene.points[scene.faces[face[own]]].mean(axis=1)
            found[own] |= apply(inverse(placed.camera_from_root), middles)[:, 2] > shaft.distal_end
    return np.asarray(found)


@lru_cache(maxsize=1)
def _background(world: World, seed: int) -> Float32:
    """Draw the tissue behind the instruments, (H, W, 3)."""
    rng = np.random.default_rng([seed, world.number, 5])
    folds = 0.6 * smooth_noise(_TISSUE[::-1], rng, 200) + 0.3 * smooth_noise(_TISSUE[::-1], rng, 60)
    share = (0.5 + 0.5 * np.tanh(folds))[..., None]
    tissue = (1 - share) * _DARK + share * _PALE + 0.02 * smooth_noise(_TISSUE[::-1], rng, 8)[..., None]
    return np.asarray(cv2.resize(tissue, world.size, interpolation=cv2.INTER_LINEAR), np.float32)


@lru_cache(maxsize=1)
def picture(world: World) -> Bool:
    """Return the pixels (H, W) inside the border."""
    width, height = world.size
    v, u = np.mgrid[:height, :width]
    if world.border == "circle":
        return np.asarray(np.hypot(u - (width - 1) / 2, v - (height - 1) / 2) <= circle_radius(world))
    bar = round(bar_share(world) * width)
    return np.asarray((u >= bar) & (u < width - bar))


def draw_image(world: World, seed: int, number: int, seen: Seen) -> NDArray[np.uint8]:
    """Draw the image of a frame: (H, W, 3) BGR, or (H, W) of a grey camera."""
    covered = seen.coverage.sum(axis=0)[..., None]
    image = _background(world, seed) * (1 - covered) + _shading(seen)[..., None] * covered
    image = cv2.GaussianBlur(image.astype(np.float32), (0, 0), _BLUR)
    noise = np.random.default_rng([seed, world.number, 6, number]).standard_normal(image.shape, dtype=np.float32)
    image = (image + (0.004 if world.level == "easy" else 0.015) * noise) * picture(world)[..., None]
    drawn = np.asarray(np.clip(255 * image + 0.5, 0, 255), np.uint8)
    return drawn if world.colour == "colour" else np.asarray(cv2.cvtColor(drawn, cv2.COLOR_BGR2GRAY))
