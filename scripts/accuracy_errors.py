"""How far estimates are from the truth, and, without any truth, how well the frames of a session agree.

The spreads use what must be one and the same in all frames of an arm that moves about its remote centre of motion: the
point in which the shafts' axes meet, and the centre that each axis and the insertion's reading give.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np
from accuracy_cases import Run, by_level

from dvrk_cmaes.evaluate.consistency import converge_shafts, rcm_spread
from dvrk_cmaes.evaluate.pose_error import compare_poses
from dvrk_cmaes.instrument import Instrument

RIGHT_MODE_DEG: Final = 30.0


def frame_errors(instrument: Instrument, run: Run) -> dict[str, Any]:
    """Errors of one run: mm and degrees, and whether it is in the right mode; nothing without pose or truth."""
    if run.failed or run.case.truth is None:
        return {}
    truth = (run.case.truth.camera_from_root, run.case.truth.joints)
    error = compare_poses(instrument, (run.pose, run.joints), truth)
    return {
        "right_mode": error.rotation_deg < RIGHT_MODE_DEG,
        "tip_mm": error.tip_mm,
        "root_mm": error.root_mm,
        "axis_deg": error.shaft_deg,
        "roll_deg": error.roll_deg,
        "joint_deg": max((abs(v) for v in error.joints_deg.values()), default=None),
        **{f"{name}_deg": value for name, value in error.joints_deg.items()},
    }


def summary(instrument: Instrument, runs: Sequence[Run]) -> dict[str, Any]:
    """Shares, and percentiles (50, 90, 100) of the errors of some runs."""
    errors = [found for run in runs if (found := frame_errors(instrument, run))]
    posed = [run for run in runs if not run.failed]
    row: dict[str, Any] = {"frames": len(runs)}
    if errors:
        row["right_mode"] = sum(e["right_mode"] for e in errors) / len(runs)
        for name in ("tip_mm", "axis_deg", "joint_deg"):
            values = [e[name] for e in errors if e[name] is not None]
            row[name] = [round(float(np.percentile(values, p)), 3) for p in (50, 90, 100)] if values else None
    if posed:
        row["iou"] = round(float(np.mean([run.result["quality"]["iou"] for run in posed])), 4)
    row["ok"] = sum(run.trusted for run in runs) / len(runs)
    row["seconds"] = float(np.median([run.result["seconds"] for run in runs]))
    return row


def session_spread(runs: Sequence[Run]) -> dict[str, float]:
    """Spread over the frames of one session, mm.

    ``sigma_mm`` and ``sigma_rms_mm``: standard deviation and root mean square of the distances from the shafts' axes
    to the point nearest to all of them. ``rcm_mm``: root mean square distance of the centre of motion in each frame
    from their mean; only where the insertion was read.
    """
    runs = [run for run in runs if not run.failed]
    if len(runs) < 3:
        return {}
    poses = np.stack([run.pose for run in runs])
    axes = converge_shafts(poses)
    spread = {"sigma_mm": 1e3 * axes.sigma, "sigma_rms_mm": 1e3 * axes.rms}
    insertion = [run.case.readings.get("insertion") for run in runs]
    if all(value is not None for value in insertion):
        spread["rcm_mm"] = 1e3 * rcm_spread(poses, np.array(insertion, dtype=np.float64)).rms
    return spread


def error_report(instrument: Instrument, runs: Sequence[Run]) -> dict[str, list[Mapping[str, Any]]]:
    """Summaries of each session, of each level, and why results are doubtful."""
    sessions: dict[str, list[Run]] = {}
    for run in runs:
        sessions.setdefault(run.case.session, []).append(run)
    reports: dict[str, list[Mapping[str, Any]]] = {
        "sessions": [
            {"session": name, **summary(instrument, group)}
            # without outer joints the frames of a session are not of one arm
            | (session_spread(group) if "insertion" in group[0].case.readings else {})
            for name, group in sessions.items()
        ],
        "levels": [{"level": name, **summary(instrument, group)} for name, group in by_level(runs).items()],
        "reasons": [
            {"level": name, "reason": reason, "share": share}
            for name, group in by_level(runs).items()
            for reason, share in reason_shares(group).items()
        ],
    }
    return reports


def reason_shares(runs: Sequence[Run]) -> dict[str, float]:
    """Share of runs that have each reason for doubt, without its figures; the most frequent first."""
    counts: dict[str, int] = {}
    for run in runs:
        for reason in {reason_kind(text) for text in run.result["reasons"]}:
            counts[reason] = counts.get(reason, 0) + 1
    return {name: count / len(runs) for name, count in sorted(counts.items(), key=lambda item: -item[1])}


def reason_kind(text: str) -> str:
    """Return what a reason is about: its words before the first colon."""
    return text.split(":")[0]


def frame_rows(instrument: Instrument, runs: Sequence[Run]) -> list[dict[str, Any]]:
    """One row a frame."""
    return [
        {
            "session": run.case.session,
            "frame": run.case.frame,
            **frame_errors(instrument, run),
            "iou": None if run.failed else run.result["quality"]["iou"],
            "seconds": run.result["seconds"],
            "status": run.result["status"],
            "reasons": "; ".join(reason_kind(text) for text in run.result["reasons"]) or "-",
        }
        for run in runs
    ]
