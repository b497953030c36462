"""Images of a synthetic recording: the instrument before tissue that moves, lit from the lens, and compressed.

Tissue is one large picture that is shifted and deformed as by breathing and the pulse; on it lie blood and the
shadow of the instrument. What passes before the instrument in the masks passes in the images, too. Only the pixels that
the instrument covers are traced, so that an image takes a fraction of the time of `synth.images.draw_image`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.camera import Camera
from dvrk_cmaes.geometry import Bool, Float32
from dvrk_cmaes.synth.images import SHAFT, blend_over, draw_lump, draw_tissue, draw_tool, vignette
from dvrk_cmaes.synth.masks import signed_distance, smooth_noise
from dvrk_cmaes.synth.passing import Occluder
from dvrk_cmaes.synth.scene import pixel_rays
from dvrk_cmaes.synth.truth import Truth

_TISSUE_DEPTH: Final = 0.16  # m
_BREATH: Final = 3.7  # s, period of the breathing
_PULSE: Final = 0.85  # s
_PULSE_SHARE: Final = 0.25  # of the motion
_WAVES: Final = (420.0, 260.0)  # px at 640 x 480, wavelengths of the deformation along u and v
_NODES: Final = 16  # px between the nodes at which the motion is computed
_SHADOW: Final = ((5.0, 9.0), 9.0)  # px at 640 x 480, shift and blur of the usual shadow
_HARD_SHADOW: Final = 1.6  # px at 640 x 480, blur of a shadow that is taken for the instrument
_BLOOD: Final = np.array([0.03, 0.02, 0.24], np.float32)
_SMOKE: Final = np.array([0.66, 0.66, 0.64], np.float32)
_SMOKE_SPEED: Final = (31.0, -12.0)  # px a second at 640 x 480
_SMOKE_PERIOD: Final = 6.0  # s, in which the smoke comes and goes
_LONGEST_BLUR: Final = 25  # px


@dataclass(frozen=True)
class ImageLevel:
    """Difficulty of a recording's images.

    motion : of the tissue, px at 640 x 480. shadow : share of the light that the instrument takes from the tissue.
    blood : share of the tissue that is covered by blood, about. smoke : largest opacity. exposure : share of the time
    between two frames during which light is gathered. noise : standard deviation where it is bright, of 1. quality :
    of the JPEG compression.
    """

    motion: float
    shadow: float
    blood: float
    smoke: float
    exposure: float
    noise: float
    quality: int


IMAGE_LEVELS: Final[Mapping[str, ImageLevel]] = {
    "clean": ImageLevel(0.0, 0.4, 0.0, 0.0, 0.0, 0.0, 98),
    "easy": ImageLevel(3.0, 0.5, 0.0, 0.0, 0.1, 0.008, 92),
    "medium": ImageLevel(6.0, 0.6, 0.06, 0.15, 0.3, 0.015, 80),
    "hard": ImageLevel(10.0, 0.7, 0.14, 0.35, 0.5, 0.025, 60),
}


@dataclass(frozen=True, eq=False)
class DrawnTool:
    """An instrument in an image.

    truths : its true pose and joints in each frame of the recording. coverage : (H, W), share of each pixel that it
    covers. shadow : direction in the image, rad, of the shadow that a segmenter takes for it.
    """

    truths: Sequence[Truth]
    coverage: Float32
    shadow: float | None = None


class RecordingImages:
    """Draws the images of a recording; each depends on its number, what is in it, and the seed only.

    Parameters
    ----------
    camera
        The camera.
    level
        Difficulty of the images.
    seed
        Seeds of the random numbers.
    interval
        Time between two frames, s.
    baseline
        How far the camera is to the right of the one that sees the same tissue with a baseline of 0, m.
    """

    def __init__(
        self, camera: Camera, level: ImageLevel, seed: Sequence[int], interval: float, baseline: float = 0.0
    ) -> None:
        self._camera, self._level = camera, level
        self._seed, self._interval = tuple(seed), interval
        self._noise = int(baseline > 0)  # each camera has its own
        self._shift = camera.fx * baseline / _TISSUE_DEPTH
        self._scale = camera.width / 640
        self._rays = pixel_rays(camera)
        self._light = vignette(camera)[..., None]
        rng = np.random.default_rng([*self._seed, 0])
        self._margin = int(np.ceil(2 * level.motion * self._scale)) + 2
        shape = (camera.height + 2 * self._margin, camera.width + 2 * self._margin)
        self._tissue = _with_blood(draw_tissue(shape, rng), level.blood, self._scale, rng)
        self._phases = rng.uniform(0, 2 * np.pi, 4)
        self._smoke = 0.5 + 0.5 * np.tanh(smooth_noise((camera.height // 4, camera.width // 4), rng, 60 * self._scale))

    def draw(self, number: int, tools: Sequence[DrawnTool], occluder: Occluder | None = None) -> NDArray[np.uint8]:
        """Draw an image, (H, W, 3) uint8 BGR, before its compression.

        Parameters
        ----------
        number
            Number of the frame, from 0.
        tools
            The instruments, the farthest first.
        occluder
            What is before them.
        """
        rng = np.random.default_rng([*self._seed, 1, number, self._noise])
        image = self._moved_tissue(number * self._interval)
        for tool in tools:
            image *= 1 - self._level.shadow * self._shadow(tool.coverage, tool.shadow)[..., None]
        for tool in tools:
            if tool.coverage.any():
                part = _around(tool.coverage > 0, _LONGEST_BLUR)
                drawn = draw_tool(tool.truths[number], tool.coverage[part], self._rays[part])
                drawn = self._blurred(tool.truths, number, drawn)
                image[part] *= 1 - drawn[..., 3:]
                image[part] += drawn[..., :3]
        if occluder is not None:
            image = blend_over(image, self._before(occluder), occluder.region)
        image *= self._light
        if self._level.smoke:
            image += self._smoke_at(number * self._interval)[..., None] * (_SMOKE - image)
        image = np.asarray(cv2.GaussianBlur(image, (0, 0), 0.6), np.float32)
        if self._level.noise:
            noise = rng.standard_normal(image.shape, dtype=np.float32)
            image += self._level.noise * np.sqrt(np.clip(image, 0.04, 1)) * noise
        return np.asarray(np.clip(image * 255 + 0.5, 0, 255), dtype=np.uint8)

    def _moved_tissue(self, time: float) -> Float32:
        """Return the tissue behind the instrument at a time, s, (H, W, 3)."""
        height, width = self._camera.height, self._camera.width
        if not self._level.motion and not self._shift:
            m = self._margin
            return self._tissue[m : m + height, m : m + width].copy()
        v, u = np.mgrid[: height + _NODES : _NODES, : width + _NODES : _NODES].astype(np.float32)
        breath = 2 * np.pi * time / _BREATH + self._phases[:2]
        pulse = _PULSE_SHARE * np.sin(2 * np.pi * time / _PULSE)
        along_u, along_v = (2 * np.pi / (wave * self._scale) for wave in _WAVES)
        size = self._level.motion * self._scale
        shift_u = size * (0.6 * np.sin(breath[0]) + pulse + 0.4 * np.sin(along_u * u + breath[1]))
        shift_v = size * (0.6 * np.sin(breath[1]) + 0.4 * np.sin(along_v * v + breath[0]))
        nodes = np.dstack([u + shift_u + self._shift, v + shift_v]).astype(np.float32) + np.float32(self._margin - 0.5)
        fine = cv2.resize(nodes, None, fx=_NODES, fy=_NODES, interpolation=cv2.INTER_LINEAR)
        offset = _NODES // 2  # the first node of a resized grid lies half a pixel before
        places = fine[offset : offset + height, offset : offset + width]
        across, down = np.ascontiguousarray(places[..., 0]), np.ascontiguousarray(places[..., 1])
        moved = cv2.remap(self._tissue, across, down, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT)
        return np.asarray(moved, np.float32)

    def _shadow(self, coverage: Float32, direction: float | None) -> Float32:
        """Return the share (H, W) of the light on the tissue that the instrument takes, of the most it can take."""
        (across, down), blur = _SHADOW
        if direction is not None:
            length = float(np.hypot(across, down))
            across, down, blur = length * np.cos(direction), length * np.sin(direction), _HARD_SHADOW
        shift = self._scale * np.array([[0, 0, across], [0, 0, down]]) + np.eye(2, 3)
        size = (self._camera.width, self._camera.height)
        moved = cv2.warpAffine(coverage, shift.astype(np.float32), size)
        return np.asarray(cv2.GaussianBlur(moved, (0, 0), blur * self._scale))

    def _blurred(self, truths: Sequence[Truth], number: int, picture: Float32) -> Float32:
        """Blur a picture (H, W, C) along the motion of the wrist in the image during the exposure."""
        after, before = min(number + 1, len(truths) - 1), max(number - 1, 0)
        ends = [truths[k].camera_from_root[:3, 3] for k in (before, after)]
        if after == before or min(end[2] for end in ends) <= 0:
            return picture
        pixels = self._camera.project(np.array(ends))
        motion = (pixels[1] - pixels[0]) / (after - before) * self._level.exposure
        length = min(float(np.hypot(*motion)), _LONGEST_BLUR)
        if length < 0.5:
            return picture
        kernel = _line_kernel(length, float(np.arctan2(motion[1], motion[0])))
        return np.asarray(cv2.filter2D(picture, -1, kernel, borderType=cv2.BORDER_REPLICATE))

    def _before(self, occluder: Occluder) -> Float32:
        """Draw what is before the instrument, (H, W, 3), valid in its region."""
        if occluder.kind == "tissue":
            return draw_lump(occluder.region, np.random.default_rng([*self._seed, 2]))
        inside = np.clip(signed_distance(occluder.region), 0, None)
        across = 1 - inside / max(float(inside.max()), 1.0)  # 0 on the other shaft's axis, 1 at its edge
        facing = np.sqrt(np.clip(1 - across**2, 0, 1))[..., None]
        return np.asarray(SHAFT * (0.25 + 0.75 * facing) + 0.10 * facing**8, np.float32)

    def _smoke_at(self, time: float) -> Float32:
        """Return the opacity (H, W) of the smoke at a time, s."""
        drift = np.eye(2, 3) + np.array([[0, 0, s * time * self._scale / 4] for s in _SMOKE_SPEED])
        height, width = self._smoke.shape
        moved = cv2.warpAffine(self._smoke, drift.astype(np.float32), (width, height), borderMode=cv2.BORDER_REFLECT)
        strength = 0.5 - 0.5 * np.cos(2 * np.pi * time / _SMOKE_PERIOD + self._phases[2])
        size = (self._camera.width, self._camera.height)
        opacity = cv2.resize(moved, size, interpolation=cv2.INTER_LINEAR)
        return np.asarray(self._level.smoke * strength * opacity, np.float32)


def _around(region: Bool, margin: int) -> tuple[slice, slice]:
    """Return the rows and columns of a region (H, W) that is not empty, with a margin, px."""
    left, top, width, height = cv2.boundingRect(region.astype(np.uint8))
    return (
        slice(max(top - margin, 0), min(top + height + margin, region.shape[0])),
        slice(max(left - margin, 0), min(left + width + margin, region.shape[1])),
    )


def _with_blood(tissue: Float32, share: float, scale: float, rng: np.random.Generator) -> Float32:
    """Return tissue (H, W, 3) of which about a share is covered by blood."""
    if not share:
        return tissue
    noise = smooth_noise(tissue.shape[:2], rng, 120 * scale)
    depth = np.clip((noise - np.quantile(noise, 1 - share)) * 6, 0, 1)[..., None]
    return np.asarray(tissue * (1 - 0.85 * depth) + 0.85 * depth * _BLOOD, np.float32)


def _line_kernel(length: float, angle: float) -> Float32:
    """Return the kernel (K, K), of sum 1, that blurs over a line of a length, px, in a direction, rad."""
    half = int(np.ceil(length / 2))
    side = 2 * half + 1
    fine = np.linspace(-length / 2, length / 2, max(8 * side, 2))
    kernel = np.zeros((side, side), np.float32)
    u, v = half + fine * np.cos(angle), half + fine * np.sin(angle)
    column, row = np.floor(u).astype(int), np.floor(v).astype(int)
    for down in (0, 1):
        for right in (0, 1):
            weight = np.abs(1 - down - (v - row)) * np.abs(1 - right - (u - column))
            at = np.clip(row + down, 0, side - 1), np.clip(column + right, 0, side - 1)
            np.add.at(kernel, at, weight)
    return np.asarray(kernel / kernel.sum(), np.float32)
