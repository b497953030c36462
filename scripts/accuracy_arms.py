"""Two arms that cross: each tool with the other before or beside it, against the same tool alone.

The sessions are those of `dvrk-cmaes synth --arms 2`, which have the masks of each tool without the other as well.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np
from accuracy_cases import print_progress
from accuracy_errors import RIGHT_MODE_DEG

from dvrk_cmaes.config import EstimateConfig
from dvrk_cmaes.errors import InputError
from dvrk_cmaes.estimation import ToolInFrame, estimate, estimate_tools
from dvrk_cmaes.evaluate.pose_error import compare_poses
from dvrk_cmaes.frames.frame import FrameFiles, read_frame
from dvrk_cmaes.frames.session_folder import Session, read_session
from dvrk_cmaes.frames.session_toml import read_session_toml
from dvrk_cmaes.frames.session_video import SessionVideo
from dvrk_cmaes.frames.tool_frames import frames_of_tool
from dvrk_cmaes.frames.truth import FrameTruth, SessionTruth, read_golden
from dvrk_cmaes.results.result import Result
from dvrk_cmaes.silhouette import Body
from dvrk_cmaes.silhouette.prepare import prepare

CROSSED: Final = "with the other tool"
ONE_BY_ONE: Final = "with the other tool, by itself"
ALONE: Final = "alone"


@dataclass(frozen=True)
class Found:
    """One estimate: its kind, the share of the tool that is hidden, the error of the tips, mm, and of the mode.

    ``again`` tells whether it was refined with the other tool as background.
    """

    kind: str
    hidden: float
    tip_mm: float
    right_mode: bool
    ok: bool
    again: bool


def arms_report(
    folders: Sequence[str], instrument: str, config: EstimateConfig, *, frames: int | None
) -> dict[str, list[dict[str, Any]]]:
    """Estimate every tool of the sessions with and without the other, and return tables of their errors.

    With the other tool, both are estimated together, and each by itself, without the pixels of the other.

    Raises
    ------
    InputError
        A session names no tools, or has no masks of the tools alone.
    """
    body, single = prepare(instrument), replace(config, threads=1)
    found = [one for folder in folders for one in _session(folder, body, single, frames)]
    rows = [_summary(kind, [one for one in found if one.kind == kind]) for kind in (CROSSED, ONE_BY_ONE, ALONE)]
    alone = rows[-1]["tip_mm"][0]
    ratios = [{"tool": row["tool"], "tips median": round(row["tip_mm"][0] / alone, 3)} for row in rows[:-1]]
    return {"estimates": rows, "against alone": ratios}


def named_arms(folder: str | Path) -> tuple[str, ...]:
    """Return the arms of a session's session.toml if it names several; else none."""
    entries = read_session_toml(folder)
    arms = () if entries is None else tuple(tool.arm for tool in entries.tools)
    return arms if len(arms) > 1 else ()


def golden_of(folder: str | Path, arm: str | None) -> Path:
    """Return the path of the truth of a session, or of one of its arms."""
    return Path(folder) / ("golden.json" if arm is None else f"golden_{arm}.json")


def read_session_of_arm(folder: str | Path, arm: str, body: Body, video: SessionVideo | None = None) -> Session:
    """Read a session with the masks and readings of one of its arms; InputError if it names no such arm."""
    entries = read_session_toml(folder)
    if entries is None:
        raise InputError(f"{folder}: expected a session.toml that names tools, got none")
    joints = entries.tool(arm).joints
    known, files = body.instrument.joint_names, () if joints is None else (joints,)
    return frames_of_tool(read_session(folder, known=known, joints=files, video=video), entries, arm)


def _session(folder: str, body: Body, config: EstimateConfig, frames: int | None) -> Iterator[Found]:
    """Yield the estimates of all tools of a session, by its first view."""
    arms = named_arms(folder)
    if not arms:
        raise InputError(f"{folder}: expected a session.toml that names several tools, got none")
    sessions = {arm: read_session_of_arm(folder, arm, body) for arm in arms}
    golden = {arm: read_golden(golden_of(folder, arm)) for arm in arms}
    count = len(sessions[arms[0]].frames[:frames])
    for number in range(count):
        files = {arm: session.frames[number] for arm, session in sessions.items()}
        yield from _frame(Path(folder), files, sessions, golden, body, config)
        print_progress(Path(folder).name, number + 1, count)


def _frame(
    folder: Path,
    files: Mapping[str, FrameFiles],
    sessions: Mapping[str, Session],
    golden: Mapping[str, SessionTruth],
    body: Body,
    config: EstimateConfig,
) -> Iterator[Found]:
    """Yield the estimates of all tools in one frame, given its files as each arm sees them."""
    whole = {arm: read_frame(replace(one, other_tools=()), sessions[arm].camera) for arm, one in files.items()}
    tools = {arm: ToolInFrame(data.mask, files[arm].readings, body) for arm, data in whole.items()}
    any_arm = next(iter(whole.values()))
    together = estimate_tools(tools, any_arm.camera, ignore=any_arm.ignore, config=config)
    for arm, one in files.items():
        lone = folder / "alone" / arm / sessions[arm].view_names[0] / f"{one.name}.png"
        alone = read_frame(replace(one, mask=lone, label=None, other_tools=()), sessions[arm].camera)
        results = {CROSSED: together[arm]}
        for kind, data in ((ONE_BY_ONE, read_frame(one, sessions[arm].camera)), (ALONE, alone)):
            results[kind] = estimate(data.mask, data.camera, one.readings, body, ignore=data.ignore, config=config)
        hidden = 1 - float(whole[arm].mask.sum() / alone.mask.sum())
        for kind, result in results.items():
            yield _found(kind, hidden, result, golden[arm].frames[one.name], body)


def _found(kind: str, hidden: float, result: Result, truth: FrameTruth, body: Body) -> Found:
    """Compare an estimate with the truth."""
    assert result.camera_from_root is not None
    error = compare_poses(
        body.instrument, (result.camera_from_root, result.joints), (truth.camera_from_root, truth.joints)
    )
    assert error.tip_mm is not None
    again = "behind" in result.other_tools.values()
    return Found(kind, hidden, error.tip_mm, error.rotation_deg < RIGHT_MODE_DEG, result.status == "ok", again)


def _summary(kind: str, found: Sequence[Found]) -> dict[str, Any]:
    """Return shares, percentiles (50, 90, 100) and means of the errors of estimates of one kind."""
    return {
        "tool": kind,
        "estimates": len(found),
        "hidden, largest": round(max(one.hidden for one in found), 3),
        "right mode": sum(one.right_mode for one in found),
        "tip_mm": [round(float(np.percentile([one.tip_mm for one in found], p)), 3) for p in (50, 90, 100)],
        "mean_mm": round(float(np.mean([one.tip_mm for one in found])), 3),
        "ok": sum(one.ok for one in found),
        "ok, more than 3 mm off": sum(one.ok and one.tip_mm > 3 for one in found),
        "solved again": sum(one.again for one in found),
    }
