"""Synthetic recordings of two arms: smooth motion of both, and in each frame the nearer tool hides the other.

The folder has what `synth.two_arms` writes, with a time and the visible share of the jaws in each row, of one view or
two, and images. Each arm has readings, a lag and cables of its own. The first arm moves as that of a recording of one
arm with the same seed.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.frames.session_toml import ToolEntry
from dvrk_cmaes.geometry import Bool, Float32
from dvrk_cmaes.io.atomic import write_image, write_json
from dvrk_cmaes.io.output import whole_folder
from dvrk_cmaes.synth.moving_arm import MotionLevel
from dvrk_cmaes.synth.moving_images import DrawnTool
from dvrk_cmaes.synth.passing import Occluder
from dvrk_cmaes.synth.recorded_frames import RecordedFrame, occluder_at, recorded_frame, shadow_directions
from dvrk_cmaes.synth.recording import (
    Pictures,
    RecordedArm,
    describe_recording,
    level_index,
    motion_level,
    picture_writer,
    record_arm,
    seen_by_right,
    write_recorded_arm,
)
from dvrk_cmaes.synth.session import PLAN_FILE, SessionPlan, frame_name, write_cameras
from dvrk_cmaes.synth.truth import Truth, exact_coverage
from dvrk_cmaes.synth.two_arms import (
    ALONE,
    ARMS,
    MOST_HIDDEN,
    SECOND,
    from_far,
    hidden_shares,
    label_mask,
    tool_depth,
    tools_of_arms,
)

_CANDIDATES: Final = 6  # motions of the second arm, of which that whose tool crosses most is taken
_SAMPLES: Final = 8  # frames, and a fourth of the image's size, in which crossing is measured
_SHRINK: Final = 4
_LAGS: Final = (0.5, 1.5)  # range of the lag of the second arm's readings, relative to the level's


@dataclass(frozen=True, eq=False)
class FrameOfArms:
    """A frame of two arms in one view.

    tools : as each tool is seen, in the order of the arms. alone : masks (H, W) that each would have without the other.
    order : indices of the tools from the farthest to the nearest. behind : pixels (H, W) in which the other tool is
    nearer than each. occluder : what is before both.
    """

    tools: tuple[RecordedFrame, RecordedFrame]
    alone: tuple[Bool, Bool]
    order: tuple[int, ...]
    behind: tuple[Bool, Bool]
    occluder: Occluder | None

    @property
    def labels(self) -> NDArray[np.uint8]:
        """The mask of labels (H, W), the place of each arm from 1."""
        return label_mask([tool.mask for tool in self.tools], self.order)


def record_arms(plan: SessionPlan, levels: Sequence[MotionLevel]) -> tuple[RecordedArm, RecordedArm]:
    """Draw the motion and the readings of two arms whose tools cross; errors as `recording.record_arm`.

    Of several motions of the second arm, that in which the tools hide most of each other is taken, but rather one that
    hides at most 30 % of a tool in all frames that are looked at.
    """
    first = record_arm(plan, levels[0], np.random.default_rng([plan.seed, level_index(plan), 2]))
    offered = [
        record_arm(plan, levels[1], np.random.default_rng([plan.seed + SECOND, level_index(plan), 2, number]))
        for number in range(_CANDIDATES)
    ]
    chosen = sorted({*np.linspace(0, plan.frames - 1, _SAMPLES).astype(int).tolist()})
    depths = _small_depths(plan, [first.truths[k] for k in chosen])
    return first, max(offered, key=lambda second: _crossing(plan, [second.truths[k] for k in chosen], depths))


def frames_of_arms(
    plan: SessionPlan, truths: Sequence[Sequence[Truth]], part: int, baseline: float = 0.0
) -> Iterator[FrameOfArms]:
    """Yield the frames of two arms with given true poses in a camera, ``baseline`` m to the right of the first.

    ``part`` is a part of the seed, different for each view.
    """
    first = np.random.default_rng([plan.seed, level_index(plan), 6, part])
    shadows = [
        shadow_directions(plan, np.random.default_rng([plan.seed, level_index(plan), 7, part, tool]))
        for tool in range(len(ARMS))
    ]
    for number in range(plan.frames):
        occluder = occluder_at(plan, truths[0][number], number, first, baseline)
        yield _frame(plan, [own[number] for own in truths], (number, part), occluder, [next(own) for own in shadows])


def write_recording_of_arms(
    out: Path, plan: SessionPlan, tool: ToolEntry, *, pictures: Pictures = "none", overwrite: bool = False
) -> None:
    """Make a recording of two arms and write it to a folder, completely or, after an error, not at all.

    ``tool`` is what session.toml says of the instrument of both arms. Images and errors as in
    `recording.write_recording`.
    """
    level = motion_level(plan)
    levels = (level, level if plan.lag is not None else _with_own_lag(plan, level))
    with whole_folder(out, "synth", overwrite=overwrite) as folder:
        arms = record_arms(plan, levels)
        visible = _write_views(folder, plan, arms, pictures)
        for number, (name, arm) in enumerate(zip(ARMS, arms, strict=True)):
            write_recorded_arm(folder, plan, arm, [shares[number] for shares in visible], f"_{name}")
        write_cameras(folder, plan, tools_of_arms(tool))
        lags = {name: own.lag for name, own in zip(ARMS, levels, strict=True)}
        write_json(folder / PLAN_FILE, {**describe_recording(plan, level, pictures), "arms": list(ARMS), "lags": lags})


def _with_own_lag(plan: SessionPlan, level: MotionLevel) -> MotionLevel:
    """Return the level with a lag of the second arm."""
    rng = np.random.default_rng([plan.seed + SECOND, level_index(plan), 8])
    return replace(level, lag=round(level.lag * rng.uniform(*_LAGS), 3))


def _crossing(plan: SessionPlan, truths: Sequence[Truth], depths: Sequence[Float32]) -> tuple[float, float]:
    """Return by how much the largest hidden share of a tool exceeds what is allowed, negated, and the mean share.

    ``truths`` are those of the second arm in the frames that are looked at, ``depths`` (H, W) those of the first one.
    """
    own = _small_depths(plan, truths)
    shares = [max(hidden_shares(*pair)) for pair in zip(depths, own, strict=True)]
    return min(MOST_HIDDEN - max(shares), 0.0), float(np.mean(shares))


def _small_depths(plan: SessionPlan, truths: Sequence[Truth]) -> list[Float32]:
    """Trace the depths of a tool in a smaller image."""
    camera = plan.camera.scaled(plan.camera.width // _SHRINK, plan.camera.height // _SHRINK)
    return [tool_depth(plan.body, camera, truth) for truth in truths]


def _frame(
    plan: SessionPlan,
    truths: Sequence[Truth],
    seed: tuple[int, int],
    occluder: Occluder | None,
    shadows: Sequence[float | None],
) -> FrameOfArms:
    """Simulate the segmentation of both tools in a frame, with the same mistakes with the other tool and without."""
    depths = [tool_depth(plan.body, plan.camera, truth) for truth in truths]
    behind = depths[1] < depths[0], depths[0] < depths[1]
    tools, alone = [], []
    for tool, truth in enumerate(truths):
        coverage = exact_coverage(plan.body, plan.camera, truth)
        seen, lone = (
            recorded_frame(
                plan,
                truth,
                coverage,
                occluder,
                shadows[tool],
                np.random.default_rng([plan.seed, level_index(plan), 9, *seed, tool]),
                hiding,
            )
            for hiding in (behind[tool], None)
        )
        tools.append(seen)
        alone.append(lone.mask)
    return FrameOfArms((tools[0], tools[1]), (alone[0], alone[1]), tuple(from_far(depths)), behind, occluder)


def _write_views(
    folder: Path, plan: SessionPlan, arms: Sequence[RecordedArm], pictures: Pictures
) -> list[tuple[float, ...]]:
    """Write masks and images of all views; returns each frame's shares of the jaws that the first view sees, by arm."""
    seen = [arm.truths for arm in arms]
    if plan.baseline is None:
        views = {"": (seen, 0.0)}
    else:
        views = {"left": (seen, 0.0), "right": ([seen_by_right(plan, own) for own in seen], plan.baseline)}
    visible: list[tuple[float, ...]] = []
    with ExitStack() as opened:
        for part, (view, (truths, baseline)) in enumerate(views.items()):
            write_picture = opened.enter_context(picture_writer(folder, plan, pictures, view, baseline))
            for number, frame in enumerate(frames_of_arms(plan, truths, part, baseline)):
                name = f"{frame_name(plan, number)}.png"
                write_image(folder / "masks" / view / name, frame.labels)
                for arm, mask in zip(ARMS, frame.alone, strict=True):
                    write_image(folder / ALONE / arm / view / name, mask)
                write_picture(number, _drawn(frame, truths), frame.occluder)
                if part == 0:
                    visible.append(tuple(tool.visible for tool in frame.tools))
    return visible


def _drawn(frame: FrameOfArms, truths: Sequence[Sequence[Truth]]) -> list[DrawnTool]:
    """Return the tools as an image shows them, the farthest first, without what the other one hides of the nearer."""
    far, *_ = frame.order
    tools = []
    for number in frame.order:
        tool = frame.tools[number]
        coverage = tool.coverage if number == far else np.where(frame.behind[number], np.float32(0), tool.coverage)
        tools.append(DrawnTool(truths[number], coverage, tool.shadow))
    return tools
