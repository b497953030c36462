"""Two arms that cross: each tool with the other before or beside it, against the same tool alone.

The sessions are those of `dvrk-cmaes synth --arms 2`, which have the masks of each tool without the other as well.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np
from accuracy_cases import print_progress
from accuracy_errors import RIGHT_MODE_DEG

from dvrk_cmaes.config import EstimateConfig
from dvrk_cmaes.errors import InputError
from dvrk_cmaes.estimation import estimate
from dvrk_cmaes.evaluate.pose_error import compare_poses
from dvrk_cmaes.frames.frame import read_frame
from dvrk_cmaes.frames.session_folder import Session, read_session
from dvrk_cmaes.frames.session_toml import read_session_toml
from dvrk_cmaes.frames.session_video import SessionVideo
from dvrk_cmaes.frames.tool_frames import frames_of_tool
from dvrk_cmaes.frames.truth import read_golden
from dvrk_cmaes.silhouette import Body
from dvrk_cmaes.silhouette.prepare import prepare

CROSSED: Final = "with the other tool"
ALONE: Final = "alone"


@dataclass(frozen=True)
class Found:
    """One estimate: its kind, the share of the tool that is hidden, the error of the tips, mm, and of the mode."""

    kind: str
    hidden: float
    tip_mm: float
    right_mode: bool
    ok: bool


def arms_report(
    folders: Sequence[str], instrument: str, config: EstimateConfig, *, frames: int | None
) -> dict[str, list[dict[str, Any]]]:
    """Estimate every tool of the sessions with and without the other, and return tables of their errors.

    Raises
    ------
    InputError
        A session names no tools, or has no masks of the tools alone.
    """
    body, single = prepare(instrument), replace(config, threads=1)
    found = [one for folder in folders for one in _session(folder, body, single, frames)]
    kinds = {kind: [one for one in found if one.kind == kind] for kind in (CROSSED, ALONE)}
    rows = [_summary(kind, own) for kind, own in kinds.items()]
    ratio = rows[0]["tip_mm"][0] / rows[1]["tip_mm"][0]
    return {"estimates": rows, "with the other tool against alone": [{"tips median": round(ratio, 3)}]}


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
    for arm in arms:
        session = read_session_of_arm(folder, arm, body)
        golden = read_golden(golden_of(folder, arm))
        files = session.frames[:frames]
        for count, one in enumerate(files, start=1):
            crossed = read_frame(one, session.camera)
            lone = Path(folder) / "alone" / arm / session.view_names[0] / f"{one.name}.png"
            alone = read_frame(replace(one, mask=lone, label=None, other_tools=()), session.camera)
            hidden = 1 - crossed.mask.sum() / alone.mask.sum()
            truth = golden.frames[one.name]
            for kind, data in ((CROSSED, crossed), (ALONE, alone)):
                result = estimate(data.mask, data.camera, one.readings, body, ignore=data.ignore, config=config)
                assert result.camera_from_root is not None
                error = compare_poses(
                    body.instrument, (result.camera_from_root, result.joints), (truth.camera_from_root, truth.joints)
                )
                assert error.tip_mm is not None
                right = error.rotation_deg < RIGHT_MODE_DEG
                yield Found(kind, float(hidden), error.tip_mm, right, result.status == "ok")
            print_progress(f"{session.folder.name} {arm}", count, len(files))


def _summary(kind: str, found: Sequence[Found]) -> dict[str, Any]:
    """Return shares and percentiles (50, 90, 100) of the errors of estimates of one kind."""
    return {
        "tool": kind,
        "estimates": len(found),
        "hidden, largest": round(max(one.hidden for one in found), 3),
        "right mode": sum(one.right_mode for one in found),
        "tip_mm": [round(float(np.percentile([one.tip_mm for one in found], p)), 3) for p in (50, 90, 100)],
        "ok": sum(one.ok for one in found),
    }
