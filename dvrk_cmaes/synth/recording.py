"""Synthetic recordings: consecutive masks of a moving arm with the mistakes of a segmenter, readings and truth."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.camera import Camera
from dvrk_cmaes.errors import InputError
from dvrk_cmaes.instrument.arm import OUTER_JOINTS
from dvrk_cmaes.io.atomic import write_image, write_json, write_text
from dvrk_cmaes.io.atomic_folder import whole_folder
from dvrk_cmaes.synth.cable_motion import draw_cables
from dvrk_cmaes.synth.files import rounded, rounded_truth
from dvrk_cmaes.synth.levels import LEVELS
from dvrk_cmaes.synth.masks import simulate_segmentation, tissue_region
from dvrk_cmaes.synth.moving_arm import (
    FRAMES_A_SECOND,
    MOTION_LEVELS,
    MotionLevel,
    arm_with_cables,
    cable_joints,
    level_offsets,
    read_moving,
)
from dvrk_cmaes.synth.session import PLAN_FILE, SessionPlan, write_cameras
from dvrk_cmaes.synth.truth import Truth, exact_mask
from dvrk_cmaes.synth.views import trace_links

Bool = NDArray[np.bool_]

_SHAFT_PASSES: Final = (0.3, 0.42)  # shares of the recording between which another shaft passes
_TISSUE_COVERS: Final = (0.78, 0.86)  # between which tissue covers the tips
_SHAFT_WIDTH: Final = 0.044  # of the image's width, half that of the other shaft
_TISSUE: Final = 34.0  # px at 640 x 480, radius
_SHADOW: Final = (7.0, 70.0)  # px at 640 x 480, shift of the shadow, and radius about the wrist in which it counts
_VISIBLE_SHRINK: Final = 4  # factor on the size of the image in which the visible share of the jaws is counted


@dataclass(frozen=True, eq=False)
class RecordedFrame:
    """A frame of a synthetic recording: its truth, its mask (H, W), and the share of its jaws that can be seen."""

    truth: Truth
    mask: Bool
    visible: float


def recorded_frames(plan: SessionPlan, truths: list[Truth], rng: np.random.Generator) -> Iterator[RecordedFrame]:
    """Yield the frames of a recording with given true poses."""
    level, scale = MOTION_LEVELS[plan.level.name], plan.camera.width / 640
    shadow: float | None = None
    for k, truth in enumerate(truths):
        hidden = _occluder(plan.camera, truth, k / len(truths), rng) if level.occluders else None
        mask = exact_mask(plan.body, plan.camera, truth)
        if rng.random() < 1 / FRAMES_A_SECOND:  # a shadow comes and goes about once in a second
            shadow = rng.uniform(0, 2 * np.pi) if rng.random() < level.shadow else None
        if shadow is not None:
            mask = _with_shadow(plan.camera, truth, mask, shadow, scale)
        visible = _visible_share(plan, truth, hidden)
        if mask.any() and plan.level.mistakes is not None:
            mask = simulate_segmentation(mask, rng, replace(plan.level.mistakes, holes=0), hidden).mask
        elif hidden is not None:
            mask = mask & ~hidden
        yield RecordedFrame(truth, mask, visible)


def write_recording(out: Path, plan: SessionPlan, *, overwrite: bool = False) -> None:
    """Make a recording and write it to the folder ``out``, completely or, after an error, not at all.

    Raises
    ------
    InputError
        The folder is not empty, or cannot be written to; the instrument has no shaft.
    DvrkCmaesError
        No motion was found that keeps the instrument in view.
    """
    if plan.body.instrument.shaft is None:
        raise InputError(f"{plan.body.instrument.name}: expected an instrument with a straight shaft, got one without")
    level = MOTION_LEVELS[plan.level.name]
    level = level if plan.lag is None else replace(level, lag=plan.lag)
    rng = np.random.default_rng([plan.seed, list(LEVELS).index(plan.level.name), 2])
    with whole_folder(out, sign=PLAN_FILE, overwrite=overwrite) as folder:
        names = cable_joints(plan.body)
        cables = draw_cables(names, level_offsets(names, level), rng) if plan.cables == "measured" else None
        base, truths, paths = arm_with_cables(plan.body, plan.camera, rng, plan.frames, level, cables, arm=plan.arm)
        readings = read_moving(truths, rng, level, cables, None if cables is None else paths)
        digits = max(4, len(str(plan.frames - 1)))
        columns = (*OUTER_JOINTS, *plan.body.instrument.joint_names)
        rows, golden = [",".join(["frame", "time", *columns])], {}
        for k, frame in enumerate(recorded_frames(plan, truths, rng)):
            name = f"{k:0{digits}d}"
            write_image(folder / "masks" / f"{name}.png", frame.mask)
            cells = [f"{readings[joint][k]:.6f}" for joint in columns]
            rows.append(",".join([name, f"{k / FRAMES_A_SECOND:.6f}", *cells]))
            truth = rounded_truth(frame.truth, "T_camera_roll_link", "tips_camera_m")
            golden[name] = truth | {"visible": round(frame.visible, 3)}
        write_cameras(folder, plan)
        write_text(folder / "joints.csv", "\n".join(rows) + "\n")
        write_json(folder / "golden.json", {"camera_from_base": rounded(base), "frames": golden})
        write_json(folder / PLAN_FILE, plan.describe() | {"motion_level": _described(level), "cables": plan.cables})


def _described(level: MotionLevel) -> dict[str, float | bool]:
    """Return the parameters of a level by name."""
    return dict(vars(level))


def _occluder(camera: Camera, truth: Truth, share: float, rng: np.random.Generator) -> Bool | None:
    """Draw what passes before the instrument at a share of the recording, (H, W); None if nothing does."""
    shape = (camera.height, camera.width)
    begin, end = _SHAFT_PASSES
    if begin < share < end:
        v, u = np.mgrid[: shape[0], : shape[1]]
        along = (u - shape[1] / 2) * np.cos(0.5) + (v - shape[0] / 2) * np.sin(0.5)
        place = ((share - begin) / (end - begin) - 0.5) * 1.4 * shape[1]
        return np.asarray(np.abs(along - place) < _SHAFT_WIDTH * shape[1])
    begin, end = _TISSUE_COVERS
    if begin < share < end and (truth.tips[:, 2] > 0).all():
        centre = camera.project(truth.tips).mean(axis=0)
        return tissue_region(shape, rng, centre, _TISSUE * shape[1] / 640)
    return None


def _with_shadow(camera: Camera, truth: Truth, mask: Bool, direction: float, scale: float) -> Bool:
    """Return a mask (H, W) to which a shadow beside the shaft is added."""
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
    link = trace_links(plan.body.instrument, wide, truth.camera_from_root, truth.values).link
    jaw = np.isin(link, jaws)
    inside = jaw[height : 2 * height, width : 2 * width]
    if hidden is not None:
        inside = inside & (cv2.resize(hidden.astype(np.float32), (width, height), interpolation=cv2.INTER_AREA) < 0.5)
    return float(inside.sum() / max(jaw.sum(), 1))
