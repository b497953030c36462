"""Synthetic endoscope images: a dark shaft and a bright steel wrist in front of moist tissue, lit from the lens.

They serve as the background of overlays and are not used for measurements.
"""

from __future__ import annotations

from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.camera import Camera
from dvrk_cmaes.geometry import Bool, Float32
from dvrk_cmaes.synth.masks import signed_distance, smooth_noise
from dvrk_cmaes.synth.scene import NOTHING, exact_coverage, pixel_rays, scene_of
from dvrk_cmaes.synth.truth import Truth

# colours are BGR, from 0 to 1
DARK_TISSUE: Final = np.array([0.10, 0.09, 0.34], np.float32)
PALE_TISSUE: Final = np.array([0.30, 0.33, 0.68], np.float32)
OCCLUDER_TISSUE: Final = np.array([0.33, 0.38, 0.74], np.float32)
SHAFT: Final = np.array([0.105, 0.10, 0.10], np.float32)
STEEL: Final = np.array([0.55, 0.54, 0.52], np.float32)


def draw_image(
    camera: Camera,
    truth: Truth,
    rng: np.random.Generator,
    *,
    holes: Bool | None = None,
    occluder: Bool | None = None,
    outside_lens: Bool | None = None,
) -> NDArray[np.uint8]:
    """Draw the image of a frame, (H, W, 3) uint8 BGR.

    Parameters
    ----------
    camera, truth
        The camera, and the instrument's true pose and joints.
    rng
        Random numbers for the tissue and the noise.
    holes
        (H, W), specular highlights on the steel.
    occluder
        (H, W), tissue in front of the instrument.
    outside_lens
        (H, W), pixels outside the lens's circular field of view, which are black.
    """
    shape = (camera.height, camera.width)
    tissue = draw_tissue(shape, rng)
    drawn = draw_tool(truth, exact_coverage(camera, truth), pixel_rays(camera))
    tool, alpha = drawn[..., :3], drawn[..., 3]
    shadow = cv2.GaussianBlur(np.roll(alpha, (9, 5), (0, 1)), (0, 0), 9)
    image = tissue * (1 - 0.55 * shadow[..., None])
    image = image * (1 - alpha[..., None]) + tool
    if holes is not None:
        glare = cv2.GaussianBlur(holes.astype(np.float32), (0, 0), 1.6)[..., None]
        image = image * (1 - glare) + glare
    if occluder is not None:
        image = blend_over(image, draw_lump(occluder, rng), occluder)
    image *= vignette(camera)[..., None]
    if outside_lens is not None:
        image *= cv2.GaussianBlur(1 - outside_lens.astype(np.float32), (0, 0), 2.0)[..., None]
    image = cv2.GaussianBlur(image, (0, 0), 0.6) + 0.004 * rng.standard_normal(image.shape).astype(np.float32)
    return np.asarray(np.clip(image * 255 + 0.5, 0, 255), dtype=np.uint8)


def draw_tool(truth: Truth, coverage: Float32, rays: Float32) -> Float32:
    """Return the instrument's colour times coverage, and its coverage, (H, W, 4), by the rays (H, W, 3) of pixels."""
    near = cv2.dilate((coverage > 0).astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
    colour = np.zeros((*coverage.shape, 4), np.float32)
    colour[near] = _shaded(truth, rays[near])
    around = cv2.blur(colour, (3, 3))  # a pixel whose centre is not covered takes its neighbours' colour
    border = near & (colour[..., 3] == 0)
    colour[border] = around[border] / np.maximum(around[border, 3:], 1e-6)
    colour[..., :3] *= coverage[..., None]
    colour[..., 3] = coverage
    return colour


def _shaded(truth: Truth, rays: Float32) -> Float32:
    """Return the colour of what rays (N, 3) meet, lit from the lens, and 1, (N, 4); zeros where they meet nothing."""
    scene = scene_of(truth)
    face, depth = scene.hits(rays)
    seen = face != NOTHING
    normal, depth = scene.normals(face[seen]).astype(np.float32), depth[seen]
    direction = rays[seen] / np.linalg.norm(rays[seen], axis=1, keepdims=True)
    facing = np.abs((normal * direction).sum(axis=-1))  # the light is at the lens
    shaft = truth.instrument.shaft
    end = -np.inf if shaft is None else shaft.distal_end
    along = (rays[seen] * depth[:, None] - truth.camera_from_root[:3, 3]) @ truth.camera_from_root[:3, 2]
    steel = (scene.link[face[seen]] > 0) | (along > end)
    albedo = np.where(steel[..., None], STEEL, SHAFT)
    # polished steel reflects a bright surrounding above and a dark one below
    mirrored = 0.5 - 0.5 * np.tanh(3 * normal[..., 1:2] + 0.6 * normal[..., :1])
    diffuse = albedo * (0.25 + 0.75 * facing[..., None]) * np.where(steel[..., None], 0.55 + 0.75 * mirrored, 1.0)
    gloss = np.where(steel, 0.75 * facing**24, 0.10 * facing**8)[..., None]
    nearer = np.minimum(0.11 / np.maximum(depth, 0.04), 1.25)
    colour = np.zeros((len(rays), 4), np.float32)
    colour[seen, :3] = np.clip((diffuse + gloss) * nearer[..., None], 0, 1)
    colour[seen, 3] = 1
    return colour


def draw_tissue(shape: tuple[int, int], rng: np.random.Generator) -> Float32:
    """Draw tissue with folds, grain and moist highlights, (H, W, 3)."""
    folds = (
        0.75 * smooth_noise(shape, rng, 260) + 0.35 * smooth_noise(shape, rng, 90) + 0.12 * smooth_noise(shape, rng, 24)
    )
    share = (0.5 + 0.5 * np.tanh(0.8 * folds))[..., None]
    colour = (1 - share) * DARK_TISSUE + share * PALE_TISSUE
    slope_v, slope_u = np.gradient(cv2.GaussianBlur(folds, (0, 0), 4))
    light = 1 + 9.0 * (slope_u - slope_v)[..., None]
    moist = np.clip(smooth_noise(shape, rng, 14) + 0.5 * folds - 2.7, 0, 1)[..., None]
    return np.asarray(np.clip(0.62 * colour * np.clip(light, 0.6, 1.5) + 0.55 * moist, 0, 1), np.float32)


def draw_lump(region: Bool, rng: np.random.Generator) -> Float32:
    """Draw rounded tissue in a region (H, W): an image (H, W, 3)."""
    height = np.sqrt(np.clip(signed_distance(region), 0, 40) / 40)
    grain = 1 + 0.10 * smooth_noise(region.shape, rng, 12)
    return np.asarray(OCCLUDER_TISSUE * (0.35 + 0.45 * height * grain)[..., None], np.float32)


def blend_over(below: Float32, above: Float32, region: Bool) -> Float32:
    """Blend image ``above`` over image ``below`` within a region (H, W) with a soft edge."""
    alpha = cv2.GaussianBlur(region.astype(np.float32), (0, 0), 0.8)[..., None]
    return np.asarray(below * (1 - alpha) + above * alpha, np.float32)


def vignette(camera: Camera) -> Float32:
    """Return the factor (H, W) by which the brightness falls towards the corners."""
    v, u = np.mgrid[: camera.height, : camera.width]
    radius = np.hypot(u - camera.cx, v - camera.cy) / (0.5 * camera.width)
    return np.asarray(1.12 - 0.42 * radius**2, np.float32)
