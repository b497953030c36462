"""Synthetic recordings of two arms: smooth motion of both, and in each frame the nearer tool hides the other.

The folder has what `synth.two_arms` writes, with a time and the visible share of the jaws in each row, of one view or
two, and images. Each arm has readings, a lag and cables of its own. The first arm moves as that of a recording of one
arm with the same seed.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Final

import numpy as np

from dvrk_cmaes.geometry import Float32
from dvrk_cmaes.io.json_file import write_json
from dvrk_cmaes.io.output import whole_folder
from dvrk_cmaes.synth.moving_arm import MotionLevel
from dvrk_cmaes.synth.moving_images import DrawnTool
from dvrk_cmaes.synth.passing import Occluder
from dvrk_cmaes.synth.recorded_frames import occluder_at, recorded_frame, shadow_directions
from dvrk_cmaes.synth.recording import (
    DrawnFrame,
    Pictures,
    RecordedArm,
    describe_recording,
    level_index,
    motion_level,
    record_arm,
    write_arms,
)
from dvrk_cmaes.synth.scene import exact_coverage, tool_depth
from dvrk_cmaes.synth.session import PLAN_FILE, SessionPlan, write_cameras
from dvrk_cmaes.synth.truth import Truth
from dvrk_cmaes.synth.two_arms import (
    ALONE,
    ARMS,
    MOST_HIDDEN,
    SECOND,
    from_far,
    hidden_shares,
    label_mask,
    tools_of_arms,
)

_CANDIDATES: Final = 6  # motions of the second arm, of which that whose tool crosses most is taken
_SAMPLES: Final = 8  # frames, and a fourth of the image's size, in which crossing is measured
_SHRINK: Final = 4
_LAGS: Final = (0.5, 1.5)  # range of the lag of the second arm's readings, relative to the level's


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
    plan: SessionPlan, part: int, truths: Sequence[list[Truth]], baseline: float = 0.0
) -> Iterator[DrawnFrame]:
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
        yield _frame(plan, truths, number, part, occluder, [next(own) for own in shadows])


def write_recording_of_arms(out: Path, plan: SessionPlan, *, pictures: Pictures, overwrite: bool = False) -> None:
    """Make a recording of two arms and write it to a folder, completely or, after an error, not at all.

    Images and errors as in `recording.write_recording`.
    """
    level = motion_level(plan)
    levels = (level, level if plan.lag is not None else _with_own_lag(plan, level))
    with whole_folder(out, "synth", overwrite=overwrite) as folder:
        arms = {f"_{name}": arm for name, arm in zip(ARMS, record_arms(plan, levels), strict=True)}
        write_arms(folder, plan, arms, partial(frames_of_arms, plan), pictures)
        write_cameras(folder, plan, tools_of_arms(plan))
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
    return [tool_depth(camera, truth) for truth in truths]


def _frame(
    plan: SessionPlan,
    truths: Sequence[list[Truth]],
    number: int,
    part: int,
    occluder: Occluder | None,
    shadows: Sequence[float | None],
) -> DrawnFrame:
    """Simulate the segmentation of both tools in a frame, with the same mistakes with the other tool and without.

    An image shows of the nearer tool all but what the other one hides of it.
    """
    now = [own[number] for own in truths]
    depths = [tool_depth(plan.camera, truth) for truth in now]
    behind = depths[1] < depths[0], depths[0] < depths[1]
    tools, masks = [], {}
    for tool, truth in enumerate(now):
        coverage = exact_coverage(plan.camera, truth)
        seen, lone = (
            recorded_frame(
                plan,
                truth,
                coverage,
                occluder,
                shadows[tool],
                np.random.default_rng([plan.seed, level_index(plan), 9, number, part, tool]),
                hiding,
            )
            for hiding in (behind[tool], None)
        )
        tools.append(seen)
        masks[f"{ALONE}/{ARMS[tool]}"] = lone.mask
    order = from_far(depths)
    drawn = []
    for k in order:
        coverage = tools[k].coverage if k == order[0] else np.where(behind[k], np.float32(0), tools[k].coverage)
        drawn.append(DrawnTool(truths[k], coverage, tools[k].shadow))
    labels = label_mask([tool.mask for tool in tools], order)
    return DrawnFrame({"masks": labels, **masks}, drawn, occluder, [tool.visible for tool in tools])
