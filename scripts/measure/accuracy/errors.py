"""Errors of estimates against the truth, and agreement of the frames of a session without truth.

Agreement is measured by two points that are the same in all frames of an arm that moves about its remote centre of
motion (RCM): the point in which the shafts' axes meet, and the RCM computed from each axis and the insertion's reading.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from dvrk_cmaes.errors import InputError
from dvrk_cmaes.evaluate.consistency import converge_shafts, rcm_spread
from dvrk_cmaes.evaluate.pose_error import PoseError, compare_poses
from dvrk_cmaes.frames.truth import FrameTruth
from dvrk_cmaes.instrument import Instrument
from dvrk_cmaes.results.result import Result
from measure.accuracy.figures import RIGHT_MODE_DEG, percentiles
from measure.cases import Run, by_session, runs_by_level


@dataclass(frozen=True, eq=False)
class Compared:
    """A run with a pose, and its errors."""

    run: Run
    error: PoseError
    tip_mm: float

    @property
    def right_mode(self) -> bool:
        """Whether the pose is in the right mode."""
        return self.error.rotation_deg < RIGHT_MODE_DEG


def error_of(instrument: Instrument, result: Result, truth: FrameTruth | None) -> PoseError | None:
    """Return the error of a result; None without pose or truth."""
    if result.camera_from_root is None or truth is None:
        return None
    true = (truth.camera_from_root, truth.joints)
    return compare_poses(instrument, (result.camera_from_root, result.joints), true)


def compared(instrument: Instrument, runs: Iterable[Run]) -> Iterator[Compared]:
    """Compare runs with the truth; InputError for a run without a pose, or without the truth of tips."""
    for run in runs:
        if run.failed:
            raise InputError(f"{run.case.session}: frame {run.case.frame}: no pose: {'; '.join(run.result.reasons)}")
        error = error_of(instrument, run.result, run.case.truth)
        if error is None or error.tip_mm is None:
            raise InputError(f"{run.case.recording.golden}: expected the truth of frame {run.case.frame}, got none")
        yield Compared(run, error, error.tip_mm)


def frame_errors(instrument: Instrument, run: Run) -> dict[str, Any]:
    """Return the errors of a run, mm and degrees, and whether it is in the right mode; empty without pose or truth."""
    error = error_of(instrument, run.result, run.case.truth)
    if error is None:
        return {}
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
    """Return shares of runs, and percentiles (50, 90, 100) of their errors."""
    errors = [found for run in runs if (found := frame_errors(instrument, run))]
    posed = [run for run in runs if not run.failed]
    row: dict[str, Any] = {"frames": len(runs)}
    if errors:
        row["right_mode"] = sum(e["right_mode"] for e in errors) / len(runs)
        for name in ("tip_mm", "axis_deg", "joint_deg"):
            values = [e[name] for e in errors if e[name] is not None]
            row[name] = percentiles(values) if values else None
    if posed:
        row["iou"] = round(float(np.mean([_iou(run) for run in posed])), 4)
    row["ok"] = sum(run.trusted for run in runs) / len(runs)
    row["seconds"] = float(np.median([run.result.seconds for run in runs]))
    return row


def _iou(run: Run) -> float | None:
    """Return the overlap of a run's pose and mask; None without a pose."""
    return None if run.result.quality is None else run.result.quality.iou


def session_spread(runs: Sequence[Run]) -> dict[str, float]:
    """Return the scatter over the frames of one session, mm; empty with fewer than three poses.

    ``sigma_mm`` and ``sigma_rms_mm`` are the standard deviation and the root mean square of the distances of the
    shafts' axes from the point nearest to all of them. ``rcm_mm`` is the root mean square distance of the frames' RCMs
    from their mean, if all insertions were read.
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
    """Summarise each session and each level, and count the reasons of doubtful and failed results."""
    return {
        "sessions": [
            {"session": name, **summary(instrument, group)}
            # without outer joints the frames of a session are independent
            | (session_spread(group) if "insertion" in group[0].case.readings else {})
            for name, group in by_session(runs).items()
        ],
        "levels": [{"level": name, **summary(instrument, group)} for name, group in runs_by_level(runs).items()],
        "reasons": [
            {"level": name, "reason": reason, "share": share}
            for name, group in runs_by_level(runs).items()
            for reason, share in reason_shares(group).items()
        ],
    }


def reason_shares(runs: Sequence[Run]) -> dict[str, float]:
    """Return the share of runs that have each kind of reason, the most frequent first."""
    counts = Counter(kind for run in runs for kind in dict.fromkeys(map(reason_kind, run.result.reasons)))
    return {name: count / len(runs) for name, count in counts.most_common()}


def reason_kind(text: str) -> str:
    """Return the kind of a reason: its text before the first colon."""
    return text.split(":")[0]


def frame_rows(instrument: Instrument, runs: Sequence[Run]) -> list[dict[str, Any]]:
    """Return one row of errors, fit and status for each run."""
    return [
        {
            "session": run.case.session,
            "frame": run.case.frame,
            **frame_errors(instrument, run),
            "iou": _iou(run),
            "seconds": run.result.seconds,
            "status": run.status,
            "reasons": "; ".join(reason_kind(text) for text in run.result.reasons) or "-",
        }
        for run in runs
    ]


def feature_rows(instrument: Instrument, runs: Sequence[Run]) -> list[dict[str, Any]]:
    """Return one row for each run: case, status, reasons, features, and errors if the truth is known."""
    return [
        {
            "session": run.case.session,
            "frame": run.case.frame,
            "level": run.case.level,
            "kind": run.case.kind,
            "status": run.status,
            "reasons": " | ".join(run.result.reasons),
            "seconds": run.result.seconds,
            **run.features,
            **frame_errors(instrument, run),
        }
        for run in runs
    ]
