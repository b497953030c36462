"""Synthetic recordings: masks of a moving arm with a segmenter's mistakes, images, readings and truth."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Final, Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.frames.truth import truth_entry
from dvrk_cmaes.geometry import Float64
from dvrk_cmaes.instrument.arm import OUTER_JOINTS
from dvrk_cmaes.io.csv_file import csv_text
from dvrk_cmaes.io.encode import rounded_array
from dvrk_cmaes.io.json_file import encoded_image, write_image, write_json, write_text
from dvrk_cmaes.io.output import whole_folder
from dvrk_cmaes.io.video_writer import whole_video
from dvrk_cmaes.joints.names import ECM_JOINTS
from dvrk_cmaes.synth.cable_motion import draw_cables
from dvrk_cmaes.synth.levels import LEVELS
from dvrk_cmaes.synth.moving_arm import (
    FRAMES_A_SECOND,
    MOTION_LEVELS,
    MotionLevel,
    cable_joints,
    level_offsets,
    moving_arm,
    read_moving,
)
from dvrk_cmaes.synth.moving_images import IMAGE_LEVELS, DrawnTool, RecordingImages
from dvrk_cmaes.synth.passing import Occluder
from dvrk_cmaes.synth.recorded_frames import recorded_frames
from dvrk_cmaes.synth.session import PLAN_FILE, SessionPlan, check_shaft, frame_name, write_cameras
from dvrk_cmaes.synth.steering import Steering
from dvrk_cmaes.synth.truth import Truth

Pictures = Literal["none", "files", "video"]

VIDEO: Final = "video.mp4"


@dataclass(frozen=True, eq=False)
class RecordedArm:
    """An arm of a recording: ``camera_from_base`` (4, 4), each frame's truth, and the readings (frames,) by joint.

    With ``steering``, of the endoscope, the base is that of the first frame.
    """

    base: Float64
    truths: list[Truth]
    readings: Mapping[str, Float64]
    steering: Steering | None = None


@dataclass(frozen=True, eq=False)
class DrawnFrame:
    """A frame of a view as it is written.

    masks : (H, W) by the folder they are in. tools : the instruments in the image, the farthest first. occluder : what
    is before them. visible : share of the jaws of each arm that can be seen.
    """

    masks: Mapping[str, NDArray[Any]]
    tools: Sequence[DrawnTool]
    occluder: Occluder | None
    visible: Sequence[float]


def level_index(plan: SessionPlan) -> int:
    """Return the place of a plan's level among all levels, a part of the seeds."""
    return list(LEVELS).index(plan.level.name)


def motion_level(plan: SessionPlan) -> MotionLevel:
    """Return the difficulty of a plan's motion, with the lag that it asks for."""
    level = MOTION_LEVELS[plan.level.name]
    return level if plan.lag is None else replace(level, lag=plan.lag)


def record_arm(plan: SessionPlan, level: MotionLevel, rng: np.random.Generator) -> RecordedArm:
    """Draw the motion of an arm, its readings and the errors of its cables; errors as `write_recording`."""
    check_shaft(plan)
    names = cable_joints(plan.body)
    cables = draw_cables(names, level_offsets(names, level), rng) if plan.cables == "measured" else None
    steering = Steering.draw(plan.seed, plan.frames) if plan.steered else None
    steered, drawn = (
        None if steering is None else steering.camera_from_first,
        (plan.body, plan.camera, rng, plan.frames),
    )
    base, truths, paths = moving_arm(*drawn, level, cables, arm=plan.arm, steered=steered)
    readings = read_moving(truths, rng, level, cables, None if cables is None else paths)
    if steering is not None:
        readings |= steering.late(level.lag)
    return RecordedArm(base, truths, readings, steering)


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
    level = motion_level(plan)
    rng = np.random.default_rng([plan.seed, level_index(plan), 2])

    def frames(part: int, truths: Sequence[list[Truth]], baseline: float) -> Iterator[DrawnFrame]:
        """Yield the frames of a view; the mistakes of the right eye are its own."""
        own = np.random.default_rng([plan.seed, level_index(plan), 4]) if part else rng
        for frame in recorded_frames(plan, truths[0], own, baseline):
            tools = [DrawnTool(truths[0], frame.coverage, frame.shadow)]
            yield DrawnFrame({"masks": frame.mask}, tools, frame.occluder, (frame.visible,))

    with whole_folder(out, "synth", overwrite=overwrite) as folder:
        write_arms(folder, plan, {"": record_arm(plan, level, rng)}, frames, pictures)
        write_cameras(folder, plan, plan.tools)
        write_json(folder / PLAN_FILE, describe_recording(plan, level, pictures))


def write_arms(
    folder: Path,
    plan: SessionPlan,
    arms: Mapping[str, RecordedArm],
    frames: Callable[[int, Sequence[list[Truth]], float], Iterator[DrawnFrame]],
    pictures: Pictures,
) -> None:
    """Write masks and images of all views of a recording, and the readings and the truth of its arms.

    Parameters
    ----------
    folder, plan
        The folder of the recording, and its parameters.
    arms
        The arms, by what is added to the names of their files.
    frames
        Yields the frames of a view: of its number, the arms' truths in its camera, and how far it is to the right of
        the first one, m.
    pictures
        Whether and how images are written.
    """
    seen = [arm.truths for arm in arms.values()]
    views = {"" if plan.baseline is None else "left": (seen, 0.0)}
    if plan.baseline is not None:
        of_right = [
            [replace(truth, camera_from_root=plan.right_from_left @ truth.camera_from_root) for truth in own]
            for own in seen
        ]
        views["right"] = of_right, plan.baseline
    visible: list[Sequence[float]] = []
    for part, (view, (truths, baseline)) in enumerate(views.items()):
        with picture_writer(folder, plan, pictures, view, baseline) as write_picture:
            for number, frame in enumerate(frames(part, truths, baseline)):
                for to, mask in frame.masks.items():
                    write_image(folder / to / view / f"{frame_name(plan, number)}.png", mask)
                write_picture(number, frame.tools, frame.occluder)
                if part == 0:
                    visible.append(frame.visible)
    for k, (suffix, arm) in enumerate(arms.items()):
        write_recorded_arm(folder, plan, arm, [shares[k] for shares in visible], suffix)


def write_recorded_arm(
    folder: Path, plan: SessionPlan, arm: RecordedArm, visible: Sequence[float], suffix: str = ""
) -> None:
    """Write joints.csv and golden.json of an arm, whose jaws' shares ``visible`` can be seen in the frames.

    ``suffix`` is added to the names of the files.
    """
    columns = (*OUTER_JOINTS, *plan.body.instrument.joint_names, *(ECM_JOINTS if arm.steering else ()))
    rows, golden = [], {}
    for k, (truth, share) in enumerate(zip(arm.truths, visible, strict=True)):
        name = frame_name(plan, k)
        cells = [f"{arm.readings[joint][k]:.6f}" for joint in columns]
        rows.append([name, f"{k / FRAMES_A_SECOND:.6f}", *cells])
        golden[name] = truth_entry(truth.stated) | {"visible": round(share, 3)}
    write_text(folder / f"joints{suffix}.csv", csv_text(("frame", "time", *columns), rows))
    document: dict[str, Any] = {"camera_from_base": rounded_array(arm.base), "frames": golden}
    if arm.steering is not None:
        for own, base in zip(golden.values(), arm.steering.camera_from_first @ arm.base, strict=True):
            own["camera_from_base"] = rounded_array(base)
        document["endoscope"] = arm.steering.describe(arm.base)
    write_json(folder / f"golden{suffix}.json", document)


def describe_recording(plan: SessionPlan, level: MotionLevel, pictures: Pictures) -> dict[str, Any]:
    """Return the parameters of a recording as plain values for JSON."""
    drawn = {} if pictures == "none" else {"image_level": asdict(IMAGE_LEVELS[plan.level.name])}
    return plan.describe() | {"motion_level": asdict(level), "cables": plan.cables} | drawn


@contextmanager
def picture_writer(
    folder: Path, plan: SessionPlan, pictures: Pictures, part: str, baseline: float = 0.0
) -> Iterator[Callable[[int, Sequence[DrawnTool], Occluder | None], None]]:
    """Give a function that draws a frame of a view, by number, tools and occluder, and writes it as ``pictures`` says.

    ``part`` is the view's folder, ``baseline`` m how far it is to the right of the first one.
    """
    level = IMAGE_LEVELS[plan.level.name]
    if pictures == "none":
        yield lambda number, tools, occluder: None
        return
    images = RecordingImages(plan.camera, level, (plan.seed, level_index(plan), 5), 1 / FRAMES_A_SECOND, baseline)
    size = (plan.camera.width, plan.camera.height)
    with whole_video(folder / VIDEO, size, FRAMES_A_SECOND) if pictures == "video" else nullcontext() as video:

        def write(number: int, tools: Sequence[DrawnTool], occluder: Occluder | None) -> None:
            path = folder / "images" / part / f"{frame_name(plan, number)}.jpg"
            image = images.draw(number, tools, occluder)
            if video is None:
                write_image(path, image, quality=level.quality)
            else:
                encoded = np.frombuffer(encoded_image(path, image, quality=level.quality), np.uint8)
                video.write(cv2.imdecode(encoded, cv2.IMREAD_COLOR))

        yield write
