"""Synthetic sessions of two arms whose tools cross in the image; the nearer tool hides the other.

The folder has masks of labels, readings and the truth of each arm (joints_ARM.csv, golden_ARM.json), camera.yaml,
session.toml and synth.json. ``alone/ARM`` has the masks that each tool would have without the other, with the same
mistakes, for comparison.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.frames.session_toml import ToolEntry
from dvrk_cmaes.frames.truth import SessionTruth, write_golden
from dvrk_cmaes.geometry import Bool, Float32, Float64
from dvrk_cmaes.instrument.arm import OUTER_JOINTS
from dvrk_cmaes.io.json_file import write_image, write_json
from dvrk_cmaes.io.output import whole_folder
from dvrk_cmaes.synth.files import write_joints
from dvrk_cmaes.synth.masks import simulate_segmentation
from dvrk_cmaes.synth.occluders import outside_lens_circle
from dvrk_cmaes.synth.readings import sample_readings
from dvrk_cmaes.synth.scene import tool_depth
from dvrk_cmaes.synth.session import PLAN_FILE, SessionPlan, frame_name, make_truths, write_cameras
from dvrk_cmaes.synth.truth import Truth

ARMS: Final = ("PSM1", "PSM2")
ALONE: Final = "alone"
_CANDIDATES: Final = 4  # poses of the second arm for each frame, of which those that cross most are taken
MOST_HIDDEN: Final = 0.3  # share of a tool's pixels that the other may hide
SECOND: Final = 104_729  # added to the seed for the second arm


def make_arms(plan: SessionPlan) -> tuple[tuple[Float64, list[Truth]], tuple[Float64, list[Truth]]]:
    """Draw the poses of two arms, such that their tools cross in as many frames as possible; errors as `make_truths`.

    Returns ``camera_from_base`` (4, 4) and the truth in each frame of both arms. At most 30 % of a tool are hidden by
    the other one.
    """
    first_base, first = make_truths(plan)
    second_base, offered = make_truths(replace(plan, seed=plan.seed + SECOND, frames=_CANDIDATES * plan.frames))
    assert first_base is not None
    assert second_base is not None
    depths = [tool_depth(plan.camera, truth) for truth in offered]
    left = list(range(len(offered)))
    second = []
    for truth in first:
        near = tool_depth(plan.camera, truth)
        shares = [max(hidden_shares(near, depths[k])) for k in left]
        allowed = [share if share <= MOST_HIDDEN else -share for share in shares]
        second.append(offered[left.pop(int(np.argmax(allowed)))])
    return (first_base, first), (second_base, second)


def hidden_shares(first: Float32, second: Float32) -> tuple[float, float]:
    """Return the share of each tool's pixels that the other hides, from their depths (H, W), infinite where absent."""
    there = np.isfinite(first), np.isfinite(second)
    hidden = there[0] & (second < first), there[1] & (first < second)
    counts = [(float(h.sum()), max(float(t.sum()), 1.0)) for h, t in zip(hidden, there, strict=True)]
    return counts[0][0] / counts[0][1], counts[1][0] / counts[1][1]


def write_two_arms(out: Path, plan: SessionPlan, *, overwrite: bool = False) -> None:
    """Make a session of two arms and write it to a folder, completely or, after an error, not at all.

    Errors as `synth.session.write_session`.
    """
    with whole_folder(out, "synth", overwrite=overwrite) as folder:
        arms = make_arms(plan)
        names = [frame_name(plan, k) for k in range(plan.frames)]
        for k, name in enumerate(names):
            _write_frame(folder, plan, name, k, [truths[k] for _, truths in arms])
        for number, (arm, (base, truths)) in enumerate(zip(ARMS, arms, strict=True)):
            rng = np.random.default_rng([plan.seed, number, 1])
            readings = sample_readings(truths, rng, plan.level, one_session=True)
            columns = [*OUTER_JOINTS, *plan.body.instrument.joint_names]
            write_joints(folder / f"joints_{arm}.csv", dict(zip(names, readings, strict=True)), columns)
            stated = {name: truth.stated for name, truth in zip(names, truths, strict=True)}
            write_golden(folder / f"golden_{arm}.json", SessionTruth(stated, base))
        write_cameras(folder, plan, tools_of_arms(plan))
        write_json(folder / PLAN_FILE, {**plan.describe(), "arms": list(ARMS)})


def _write_frame(folder: Path, plan: SessionPlan, name: str, number: int, truths: Sequence[Truth]) -> None:
    """Write the mask of labels of a frame, the ignored pixels, and the masks of each tool alone."""
    depths = [tool_depth(plan.camera, truth) for truth in truths]
    edge = plan.level.lens_edge
    outside = None if edge is None else outside_lens_circle(plan.camera, edge)
    masks = []
    for tool, depth in enumerate(depths):
        there, other = np.isfinite(depth), depths[1 - tool] < depth
        masks.append(_segmented(plan, there & ~other, number, tool, outside))
        alone = _segmented(plan, there, number, tool, outside)
        write_image(folder / ALONE / ARMS[tool] / f"{name}.png", alone)
    write_image(folder / "masks" / f"{name}.png", label_mask(masks, from_far(depths)))
    if outside is not None:
        write_image(folder / "ignore" / f"{name}.png", outside)


def from_far(depths: Sequence[Float32]) -> list[int]:
    """Return the indices of tools from the farthest to the nearest, from their depths (H, W), infinite where absent."""
    seen = [depth[np.isfinite(depth)] for depth in depths]
    distances = [float(np.median(depth)) if depth.size else np.inf for depth in seen]
    return sorted(range(len(depths)), key=lambda tool: -distances[tool])


def label_mask(masks: Sequence[Bool], order: Sequence[int]) -> NDArray[np.uint8]:
    """Return a mask of labels (H, W): each tool's place, from 1; where several are, that of the last in order."""
    labels = np.zeros(masks[0].shape, np.uint8)
    for tool in order:
        labels[masks[tool]] = tool + 1
    return labels


def _segmented(plan: SessionPlan, exact: Bool, number: int, tool: int, outside: Bool | None) -> Bool:
    """Simulate the segmentation of a tool's exact mask (H, W); with the same mistakes for the same frame and tool."""
    if plan.level.mistakes is None:
        return exact if outside is None else exact & ~outside
    rng = np.random.default_rng([plan.seed, number, tool, 2])
    return simulate_segmentation(exact, rng, plan.level.mistakes, outside).mask


def tools_of_arms(plan: SessionPlan) -> list[ToolEntry]:
    """Return the entries of the tools of both arms, with their labels and files of readings."""
    return [
        replace(plan.tool or ToolEntry(arm), arm=arm, label=(label,), joints=Path(f"joints_{arm}.csv"))
        for label, arm in enumerate(ARMS, start=1)
    ]
