"""Frames of a synthetic recording: masks with a segmenter's mistakes, shadows, what passes before the instrument."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Final

import cv2
import numpy as np

from dvrk_cmaes.camera import Camera
from dvrk_cmaes.geometry import Bool, Float32
from dvrk_cmaes.synth.masks import simulate_segmentation
from dvrk_cmaes.synth.moving_arm import FRAMES_A_SECOND, MOTION_LEVELS
from dvrk_cmaes.synth.passing import Occluder, passing_occluder
from dvrk_cmaes.synth.scene import exact_coverage, links_seen
from dvrk_cmaes.synth.session import SessionPlan
from dvrk_cmaes.synth.truth import Truth

_SHADOW: Final = (7.0, 70.0)  # px at 640 x 480, shift of the shadow, and radius about the wrist in which it counts
_VISIBLE_SHRINK: Final = 4  # factor on the size of the image in which the visible share of the jaws is counted


@dataclass(frozen=True, eq=False)
class RecordedFrame:
    """A frame of a synthetic recording.

    truth : true pose and joints. mask : (H, W), with a segmenter's mistakes. visible : share of the jaws that can be
    seen. coverage : (H, W), share of each pixel that the instrument covers. occluder : what is before it. shadow :
    direction in the image, rad, of a shadow that is taken for it.
    """

    truth: Truth
    mask: Bool
    visible: float
    coverage: Float32
    occluder: Occluder | None
    shadow: float | None


def recorded_frames(
    plan: SessionPlan, truths: list[Truth], rng: np.random.Generator, baseline: float = 0.0
) -> Iterator[RecordedFrame]:
    """Yield the frames of a recording with given true poses in a camera, ``baseline`` m to the right of the first."""
    shadows = shadow_directions(plan, rng)
    for k, truth in enumerate(truths):
        occluder = occluder_at(plan, truth, k, rng, baseline)
        coverage = exact_coverage(plan.camera, truth)
        yield recorded_frame(plan, truth, coverage, occluder, next(shadows), rng)


def occluder_at(
    plan: SessionPlan, truth: Truth, number: int, rng: np.random.Generator, baseline: float
) -> Occluder | None:
    """Draw what passes before the instrument in a frame; None if nothing does, as at the lower levels."""
    if not MOTION_LEVELS[plan.level.name].occluders:
        return None
    return passing_occluder(plan.camera, truth, number / plan.frames, rng, baseline)


def shadow_directions(plan: SessionPlan, rng: np.random.Generator) -> Iterator[float | None]:
    """Yield for each frame the direction, rad, of a shadow that is taken for the instrument, or None."""
    shadow: float | None = None
    while True:
        if rng.random() < 1 / FRAMES_A_SECOND:  # a shadow comes and goes about once in a second
            shadow = rng.uniform(0, 2 * np.pi) if rng.random() < MOTION_LEVELS[plan.level.name].shadow else None
        yield shadow


def recorded_frame(
    plan: SessionPlan,
    truth: Truth,
    coverage: Float32,
    occluder: Occluder | None,
    shadow: float | None,
    rng: np.random.Generator,
    behind: Bool | None = None,
) -> RecordedFrame:
    """Simulate the segmentation of a frame; ``behind`` (H, W) are the pixels in which another tool is nearer."""
    hidden = None if occluder is None else occluder.region
    mask = np.asarray(coverage > 0.5)
    if shadow is not None:
        mask = _with_shadow(plan.camera, truth, mask, shadow, plan.camera.width / 640)
    unseen = hidden
    if behind is not None:
        mask, unseen = mask & ~behind, behind if hidden is None else hidden | behind
    visible = _visible_share(plan, truth, unseen)
    if mask.any() and plan.level.mistakes is not None:
        mask = simulate_segmentation(mask, rng, replace(plan.level.mistakes, holes=0), hidden).mask
    elif hidden is not None:
        mask = mask & ~hidden
    return RecordedFrame(truth, mask, visible, coverage, occluder, shadow)


def _with_shadow(camera: Camera, truth: Truth, mask: Bool, direction: float, scale: float) -> Bool:
    """Return a mask (H, W) to which a shadow along the shaft is added."""
    wrist = truth.point_on_shaft(0.0)
    if wrist[2] <= 0:
        return mask
    shift = _SHADOW[0] * scale * np.array([np.cos(direction), np.sin(direction)])
    matrix = np.array([[1, 0, shift[0]], [0, 1, shift[1]]], dtype=np.float32)
    moved = cv2.warpAffine(mask.astype(np.uint8), matrix, (mask.shape[1], mask.shape[0])) > 0
    u, v = camera.project(wrist)
    rows, columns = np.mgrid[: mask.shape[0], : mask.shape[1]]
    near = (columns - u) ** 2 + (rows - v) ** 2 < (_SHADOW[1] * scale) ** 2
    return np.asarray(mask | (moved & near))


def _visible_share(plan: SessionPlan, truth: Truth, hidden: Bool | None) -> float:
    """Compute the share of the jaws' pixels that lie in the image and are not hidden; 1 without jaws."""
    jaws = [tip.link for tip in plan.body.instrument.jaw_tips]
    if not jaws:
        return 1.0
    small = plan.camera.scaled(plan.camera.width // _VISIBLE_SHRINK, plan.camera.height // _VISIBLE_SHRINK)
    width, height = small.width, small.height
    wide = small.cropped(-width, -height, 3 * width, 3 * height)
    jaw = np.isin(links_seen(wide, truth), jaws)
    inside = jaw[height : 2 * height, width : 2 * width]
    if hidden is not None:
        inside = inside & (cv2.resize(hidden.astype(np.float32), (width, height), interpolation=cv2.INTER_AREA) < 0.5)
    return float(inside.sum() / max(jaw.sum(), 1))
