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
from dvrk_cmaes.synth.truth import Truth
from dvrk_cmaes.synth.views import NOTHING, LinkView, trace_links

# colours are BGR, from 0 to 1
DARK_TISSUE: Final = np.array([0.10, 0.09, 0.34], np.float32)
PALE_TISSUE: Final = np.array([0.30, 0.33, 0.68], np.float32)
OCCLUDER_TISSUE: Final = np.array([0.33, 0.38, 0.74], np.float32)
SHAFT: Final = np.array([0.105, 0.10, 0.10], np.float32)
STEEL: Final = np.array([0.55, 0.54, 0.52], np.float32)
SAMPLES: Final = 2  # rays per pixel along each side


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
    tool, alpha = _tool(camera, truth)
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


def _tool(camera: Camera, truth: Truth) -> tuple[Float32, Float32]:
    """Render the instrument: its shaded colour times coverage (H, W, 3), and its coverage (H, W)."""
    fine = camera.scaled(camera.width * SAMPLES, camera.height * SAMPLES)
    view = trace_links(truth.instrument, fine, truth.camera_from_root, truth.values)
    seen = (view.link != NOTHING).astype(np.float32)
    size = (camera.width, camera.height)
    shaded = cv2.resize(shaded_links(truth, view), size, interpolation=cv2.INTER_AREA)
    alpha = cv2.resize(seen, size, interpolation=cv2.INTER_AREA)
    return np.asarray(shaded, np.float32), np.asarray(alpha, np.float32)


def shaded_links(truth: Truth, view: LinkView) -> Float32:
    """Return the colour (..., 3) of what is seen along rays, lit from the lens; 0 where no link is seen."""
    seen = view.link != NOTHING
    normal, direction, depth = view.normal[seen], view.direction[seen], view.depth[seen]
    facing = np.abs((normal * direction).sum(axis=-1))  # the light is at the lens
    shaft = truth.instrument.shaft
    end = -np.inf if shaft is None else shaft.distal_end
    steel = (view.link[seen] > 0) | (_along_shaft(truth, direction, depth) > end)
    albedo = np.where(steel[..., None], STEEL, SHAFT)
    # polished steel reflects a bright surrounding above and a dark one below
    mirrored = 0.5 - 0.5 * np.tanh(3 * normal[..., 1:2] + 0.6 * normal[..., :1])
    diffuse = albedo * (0.25 + 0.75 * facing[..., None]) * np.where(steel[..., None], 0.55 + 0.75 * mirrored, 1.0)
    gloss = np.where(steel, 0.75 * facing**24, 0.10 * facing**8)[..., None]
    nearer = np.minimum(0.11 / np.maximum(depth, 0.04), 1.25)
    colour = np.zeros((*seen.shape, 3), np.float32)
    colour[seen] = np.clip((diffuse + gloss) * nearer[..., None], 0, 1)
    return colour


def _along_shaft(truth: Truth, direction: Float32, depth: Float32) -> Float32:
    """Return the coordinate along the shaft of the points seen along rays (...), m from the root's origin."""
    points = direction / direction[..., 2:] * depth[..., None] - truth.camera_from_root[:3, 3]
    return np.asarray(points @ truth.camera_from_root[:3, 2], np.float32)


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
