"""Synthetic recordings: masks of a moving arm with a segmenter's mistakes, images, readings and truth."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager, nullcontext
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Final, Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.camera import Camera
from dvrk_cmaes.errors import InputError
from dvrk_cmaes.instrument.arm import OUTER_JOINTS
from dvrk_cmaes.io.atomic import encoded_image, write_image, write_json, write_text
from dvrk_cmaes.io.atomic_folder import whole_folder
from dvrk_cmaes.io.video_file import whole_video
from dvrk_cmaes.synth.cable_motion import draw_cables
from dvrk_cmaes.synth.files import rounded, rounded_truth
from dvrk_cmaes.synth.levels import LEVELS
from dvrk_cmaes.synth.masks import simulate_segmentation
from dvrk_cmaes.synth.moving_arm import (
    FRAMES_A_SECOND,
    MOTION_LEVELS,
    arm_with_cables,
    cable_joints,
    level_offsets,
    read_moving,
)
from dvrk_cmaes.synth.moving_images import IMAGE_LEVELS, RecordingImages
from dvrk_cmaes.synth.passing import Occluder, passing_occluder
from dvrk_cmaes.synth.session import PLAN_FILE, SessionPlan, write_cameras
from dvrk_cmaes.synth.truth import Truth, exact_coverage
from dvrk_cmaes.synth.views import trace_links

Bool = NDArray[np.bool_]
Pictures = Literal["none", "files", "video"]

VIDEO: Final = "video.mp4"

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
    coverage: NDArray[np.float32]
    occluder: Occluder | None
    shadow: float | None


def recorded_frames(
    plan: SessionPlan, truths: list[Truth], rng: np.random.Generator, baseline: float = 0.0
) -> Iterator[RecordedFrame]:
    """Yield the frames of a recording with given true poses in a camera, ``baseline`` m to the right of the first."""
    level, scale = MOTION_LEVELS[plan.level.name], plan.camera.width / 640
    shadow: float | None = None
    for k, truth in enumerate(truths):
        occluder: Occluder | None = None
        if level.occluders:
            occluder = passing_occluder(plan.camera, truth, k / len(truths), rng, baseline)
        hidden = None if occluder is None else occluder.region
        coverage = exact_coverage(plan.body, plan.camera, truth)
        mask = np.asarray(coverage > 0.5)
        if rng.random() < 1 / FRAMES_A_SECOND:  # a shadow comes and goes about once in a second
            shadow = rng.uniform(0, 2 * np.pi) if rng.random() < level.shadow else None
        if shadow is not None:
            mask = _with_shadow(plan.camera, truth, mask, shadow, scale)
        visible = _visible_share(plan, truth, hidden)
        if mask.any() and plan.level.mistakes is not None:
            mask = simulate_segmentation(mask, rng, replace(plan.level.mistakes, holes=0), hidden).mask
        elif hidden is not None:
            mask = mask & ~hidden
        yield RecordedFrame(truth, mask, visible, coverage, occluder, shadow)


def write_recording(out: Path, plan: SessionPlan, *, pictures: Pictures = "none", overwrite: bool = False) -> None:
    """Make a recording and write it to the folder ``out``, completely or, after an error, not at all.

    ``pictures`` says whether images are drawn, and written as ``images/FRAME.jpg`` or, of one view, as ``video.mp4``.
    The truth is in the left camera, whose masks and images are those of a recording of one view.

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
        with ExitStack() as opened:
            views = [opened.enter_context(_view(folder, plan, truths, pictures, rng))]
            if plan.baseline is not None:
                views.append(opened.enter_context(_right_view(folder, plan, truths, pictures)))
            for k, (frame, *_) in enumerate(zip(*views, strict=True)):
                name = f"{k:0{digits}d}"
                cells = [f"{readings[joint][k]:.6f}" for joint in columns]
                rows.append(",".join([name, f"{k / FRAMES_A_SECOND:.6f}", *cells]))
                truth = rounded_truth(frame.truth, "T_camera_roll_link", "tips_camera_m")
                golden[name] = truth | {"visible": round(frame.visible, 3)}
        write_cameras(folder, plan)
        write_text(folder / "joints.csv", "\n".join(rows) + "\n")
        write_json(folder / "golden.json", {"camera_from_base": rounded(base), "frames": golden})
        drawn = {} if pictures == "none" else {"image_level": asdict(IMAGE_LEVELS[plan.level.name])}
        described = plan.describe() | {"motion_level": asdict(level), "cables": plan.cables} | drawn
        write_json(folder / PLAN_FILE, described)


@contextmanager
def _view(
    folder: Path,
    plan: SessionPlan,
    truths: list[Truth],
    pictures: Pictures,
    rng: np.random.Generator,
    baseline: float = 0.0,
) -> Iterator[Iterator[RecordedFrame]]:
    """Give the frames of a view with given true poses in its camera; mask and image of each are written as it is made.

    The view is the right one if it has a ``baseline``, m.
    """
    level = IMAGE_LEVELS[plan.level.name]
    seed = (plan.seed, list(LEVELS).index(plan.level.name), 5)
    images = None
    if pictures != "none":
        images = RecordingImages(plan.camera, truths, level, seed, 1 / FRAMES_A_SECOND, baseline)
    part = "" if plan.baseline is None else "right" if baseline else "left"
    digits = max(4, len(str(plan.frames - 1)))
    size = (plan.camera.width, plan.camera.height)
    with whole_video(folder / VIDEO, size, FRAMES_A_SECOND) if pictures == "video" else nullcontext() as video:

        def written() -> Iterator[RecordedFrame]:
            for number, frame in enumerate(recorded_frames(plan, truths, rng, baseline)):
                write_image(folder / "masks" / part / f"{number:0{digits}d}.png", frame.mask)
                if images is not None:
                    path = folder / "images" / part / f"{number:0{digits}d}.jpg"
                    image = images.draw(number, frame.coverage, frame.occluder, frame.shadow)
                    if video is None:
                        write_image(path, image, quality=level.quality)
                    else:
                        encoded = np.frombuffer(encoded_image(path, image, quality=level.quality), np.uint8)
                        video.write(cv2.imdecode(encoded, cv2.IMREAD_COLOR))
                yield frame

        yield written()


def _right_view(
    folder: Path, plan: SessionPlan, truths: list[Truth], pictures: Pictures
) -> AbstractContextManager[Iterator[RecordedFrame]]:
    """Give the frames of the right eye, with mistakes of their own, as `_view` does."""
    seen = [replace(truth, camera_from_root=plan.right_from_left @ truth.camera_from_root) for truth in truths]
    rng = np.random.default_rng([plan.seed, list(LEVELS).index(plan.level.name), 4])
    return _view(folder, plan, seen, pictures, rng, plan.baseline or 0.0)


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
