"""Pictures of instruments by rays (Embree): what each covers of every pixel, and a shaded image.

Rays go through the middles of the pixels, of large images of every second one. Pixels near which these differ are
divided into ``SAMPLES`` x ``SAMPLES`` rays. The lens is that of the camera; nothing else of the package draws.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.camera import Camera
from dvrk_cmaes.synth.masks import smooth_noise
from worlds.motion import bar_share, circle_radius
from worlds.scene import Placed, Scene
from worlds.table import World

Float32 = NDArray[np.float32]
Float64 = NDArray[np.float64]
Bool = NDArray[np.bool_]

SAMPLES: Final = 5
_LARGE: Final = 1500  # px, width from which on every second pixel is looked at first
_TISSUE: Final = (960, 720)  # px, at which the background is drawn, whatever the image's size
_DARK: Final = np.array([0.08, 0.08, 0.28])  # of the tissue, BGR
_PALE: Final = np.array([0.25, 0.28, 0.58])
_ALBEDO: Final = (0.10, 0.52)  # of the shaft, and of steel
_BLUR: Final = 0.5  # px, of the image


@dataclass(frozen=True, eq=False)
class Seen:
    """What is seen of T tools: the share of each pixel that each covers, (T, H, W), and their shading (H, W)."""

    coverage: Float32
    shading: Float32


def rays_of(camera: Camera, pixels: Float64) -> Float32:
    """Return the rays (N, 3) of pixels (N, 2), points of the camera's frame at z = 1."""
    return np.asarray(np.c_[camera.normalise(pixels), np.ones(len(pixels))], np.float32)


@lru_cache(maxsize=1)
def _first_rays(camera: Camera, step: int) -> tuple[Float32, tuple[int, int]]:
    """Return the rays through every ``step``-th pixel, and the numbers of rows and columns of these."""
    v, u = np.mgrid[: camera.height : step, : camera.width : step].astype(np.float64)
    return rays_of(camera, np.stack([u.ravel(), v.ravel()], axis=1)), u.shape


def draw_tools(camera: Camera, tools: Sequence[Placed]) -> Seen:
    """Draw what is seen of instruments, of which the nearer hides the farther."""
    scene = Scene(tools)
    step = 2 if camera.width > _LARGE else 1
    rays, shape = _first_rays(camera, step)
    face, depth = scene.hits(rays)
    tool = np.where(face < 0, -1, scene.tool[face]).reshape(shape)
    whole, spread = (slice(camera.height), slice(camera.width)), np.ones((step, step), np.int64)
    shading = np.kron(_shaded(scene, rays, face, depth).reshape(shape), spread)[whole].astype(np.float32)
    tool = np.kron(tool, spread)[whole]
    coverage = np.stack([tool == number for number in range(len(tools))]).astype(np.float32)

    around = np.ones((2 * step + 3, 2 * step + 3), np.uint8)
    codes = (tool + 1).astype(np.uint8)
    rows, columns = np.nonzero(cv2.dilate(codes, around) != cv2.erode(codes, around))
    if len(rows):
        inner = (np.arange(SAMPLES) + 0.5) / SAMPLES - 0.5
        within = np.stack(np.meshgrid(inner, inner), axis=-1).reshape(-1, 2)
        pixels = np.stack([columns, rows], axis=1)[:, None] + within
        face, _ = scene.hits(rays_of(camera, pixels.reshape(-1, 2)))
        seen = np.where(face < 0, -1, scene.tool[face]).reshape(len(rows), -1)
        for number in range(len(tools)):
            coverage[number, rows, columns] = (seen == number).mean(axis=1)
    near = cv2.dilate(shading, np.ones((2 * step + 1, 2 * step + 1), np.uint8))
    return Seen(coverage, np.where(shading > 0, shading, near))


def _shaded(scene: Scene, rays: Float32, face: NDArray[np.int64], depth: Float32) -> Float32:
    """Return the brightness of what rays (N, 3) meet, lit from the camera; 0 where they meet nothing."""
    bright = np.zeros(len(rays), np.float32)
    hit = face >= 0
    if not hit.any():
        return bright
    towards = rays[hit] / np.linalg.norm(rays[hit], axis=1, keepdims=True)
    facing = np.abs((scene.normals(face[hit]) * towards).sum(axis=1))
    steel = scene.steel(face[hit])
    light = np.clip(np.median(depth[hit]) / depth[hit], 0.5, 1.5)
    gloss = np.where(steel, 0.7, 0.1) * facing**20
    bright[hit] = np.clip((np.where(steel, *_ALBEDO[::-1]) * (0.25 + 0.75 * facing) + gloss) * light, 0.02, 1)
    return bright


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
    image = _background(world, seed) * (1 - covered) + seen.shading[..., None] * covered
    image = cv2.GaussianBlur(image.astype(np.float32), (0, 0), _BLUR)
    noise = np.random.default_rng([seed, world.number, 6, number]).standard_normal(image.shape, dtype=np.float32)
    image = (image + (0.004 if world.level == "easy" else 0.015) * noise) * picture(world)[..., None]
    drawn = np.asarray(np.clip(255 * image + 0.5, 0, 255), np.uint8)
    return drawn if world.colour == "colour" else np.asarray(cv2.cvtColor(drawn, cv2.COLOR_BGR2GRAY))
