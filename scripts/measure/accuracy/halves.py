"""Check of the standard deviations of camera_from_base: the two halves of each session, solved apart.

The base does not move during a session, so the two bases should differ by no more than their covariances say. Those
are taken without what errors of the camera file do to the base, which both halves share.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from dvrk_cmaes.geometry import change_between
from measure.accuracy.sessions import Outcome, Trial


def halved(trials: Sequence[Trial]) -> list[Trial]:
    """Return the first and the second half of each session in turn."""
    found = []
    for trial in trials:
        middle = len(trial.runs) // 2
        found += [replace(trial, runs=trial.runs[:middle]), replace(trial, runs=trial.runs[middle:])]
    return found


def halves_report(outcomes: Sequence[Outcome]) -> dict[str, list[dict[str, Any]]]:
    """Compare the bases of each two halves; the summary has all axes of all sessions by level.

    ``deviation`` is the difference along or about an axis of the base in standard deviations of the difference.
    """
    rows, levels = [], []
    for first, second in zip(outcomes[::2], outcomes[1::2], strict=True):
        levels.append(first.trial.level)
        rows.append({"session": first.trial.session, **_difference(first, second)})
    summary = []
    for level in dict.fromkeys(levels):
        own = [row["axes"] for row, of in zip(rows, levels, strict=True) if of == level and "axes" in row]
        if own:
            off = np.abs(np.concatenate(own))
            rms, most, largest = float(np.sqrt(np.mean(off**2))), float(np.percentile(off, 95)), float(off.max())
            summary.append({"level": level, "sessions": len(own), "rms": rms, "95 %": most, "largest": largest})
    for row in rows:
        if "axes" in row:
            row["axes"] = " ".join(f"{value:.1f}" for value in row["axes"])
    return {"difference of the halves' bases, in standard deviations of an axis": summary, "sessions": rows}


def _difference(first: Outcome, second: Outcome) -> dict[str, Any]:
    """Return the difference of the bases of two halves."""
    refused = [one.refusal for one in (first, second) if one.solved is None]
    if first.solved is None or second.solved is None:
        return {"refused": "; ".join(refused)}
    one, other = first.solved.calibration, second.solved.calibration
    off = change_between(one.camera_from_base, other.camera_from_base)
    std = np.sqrt(np.diag(one.covariance_given_camera[:6, :6] + other.covariance_given_camera[:6, :6]))
    lags = [calibration.lag for calibration in (one, other)]
    return {
        "frames": len(first.trial.runs) + len(second.trial.runs),
        "deg": float(np.degrees(np.linalg.norm(off[3:]))),
        "mm": float(1e3 * np.linalg.norm(off[:3])),
        "axes": off / std,
        "lags, frames": " and ".join("untold" if lag is None else f"{lag.frames:.2f}" for lag in lags),
    }
