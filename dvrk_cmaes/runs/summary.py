"""``summary.json``: counts, medians and times of a session's results. Only ``timing`` differs between equal runs."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Final, get_args

import numpy as np

from dvrk_cmaes.calibration.session_rig import rotations_of_views
from dvrk_cmaes.config import TrustConfig
from dvrk_cmaes.joints.commanded import commanded_in
from dvrk_cmaes.pose.doubts import reasons, rig_turned
from dvrk_cmaes.results.result import Result, Status

SCHEMA: Final = 1
_OF_QUALITY: Final = ("iou", "contour_px_median", "contour_px_95", "steady_share")
_OF_RESULTS: Final = ("mode_probability", "std_translation_mm", "std_rotation_deg")
_DIGITS: Final = 6


def timing_of(frames: int, seconds: float) -> dict[str, float] | None:
    """Return the duration of a run for summary.json; None if it estimated no frame."""
    if not frames:
        return None
    return {"frames": frames, "seconds": round(seconds, 3), "frames_per_second": round(frames / seconds, 4)}


def count_frames(statuses: Sequence[Status], missing: int) -> dict[str, int]:
    """Count frames by status; ``missing`` is the number of those without a result."""
    counter = Counter(statuses)
    return {
        "frames": len(statuses) + missing,
        **{status: counter[status] for status in get_args(Status)},
        "missing": missing,
    }


def summarize(
    results: Mapping[str, Result],
    manifest: Mapping[str, Any],
    timing: Mapping[str, float] | None = None,
    *,
    calibration: Mapping[str, Any] | None = None,
) -> dict[str, Any]:
    """Return the content of summary.json.

    Parameters
    ----------
    results
        The results by name of the frame.
    manifest
        The manifest, with all frames of the session.
    timing
        Duration of the run that has just ended, if any, as of `timing_of`.
    calibration
        The content of session.json if the frames were solved together; its lag is repeated.
    """
    missing = sorted(set(manifest["frames"]) - set(results))
    values = list(results.values())
    return {
        "schema": SCHEMA,
        "session": manifest["session"],
        "version": manifest["version"],
        "instrument": manifest["instrument"]["name"],
        "counts": count_frames([result.status for result in values], len(missing)),
        "medians": _medians(values),
        "frames": {name: {"status": r.status, "reasons": list(r.reasons)} for name, r in results.items()},
        "missing": missing,
        "lag": None if calibration is None else calibration.get("lag"),
        "commanded": commanded_in([result.readings for result in values], _joints(values)),
        "timing": {"frame_seconds": _seconds(values), "run": timing},
        "config": manifest["config"],
        **({"rig_doubts": rig_doubts(values)} if any(result.view_fits for result in values) else {}),
    }


def _medians(results: Sequence[Result]) -> dict[str, Any]:
    """Compute medians over the frames that have a pose.

    Medians of joints are by name, in degrees; ``found_less_read_deg`` is that of estimate minus reading, over the
    frames with a reading.
    """
    quality = [result.quality for result in results if result.quality is not None]
    joints = _joints(results)
    changes = {
        name: [np.degrees(r.joints[name] - r.readings[name]) for r in results if {name} <= {*r.joints} & {*r.readings}]
        for name in joints
    }
    stds = {
        name: [std[name] for r in results if (std := r.std_joints_deg) is not None and name in std] for name in joints
    }
    errors = [result.expected_error for result in results if result.expected_error is not None]
    own = {name: [getattr(r, name) for r in results] for name in _OF_RESULTS}
    return {
        **{name: _median([getattr(q, name) for q in quality]) for name in _OF_QUALITY},
        "tips_90_mm": _median([error.tip_90_mm for error in errors]),
        "std_shaft_deg": _median([error.shaft_deg for error in errors]),
        **{name: _median([value for value in values if value is not None]) for name, values in own.items()},
        "std_joints_deg": {name: _median(values) for name, values in stds.items()},
        "found_less_read_deg": {name: _median(values) for name, values in changes.items()},
    }


def _joints(results: Sequence[Result]) -> list[str]:
    """Return the names of the joints that were found."""
    return list(dict.fromkeys(name for result in results for name in result.joints))


def _median(values: Sequence[Any]) -> Any:
    """Return the median over the first axis, rounded; None if there are no values."""
    return np.round(np.median(values, axis=0), _DIGITS).tolist() if len(values) else None


def _seconds(results: Sequence[Result]) -> dict[str, float] | None:
    """Return statistics of the seconds per frame, without failed frames; None if there are no others."""
    seconds = [result.seconds for result in results if result.status != "failed"]
    if not seconds:
        return None
    return {
        "median": round(float(np.median(seconds)), 4),
        "percentile_95": round(float(np.percentile(seconds, 95)), 4),
        "slowest": max(seconds),
        "total": round(sum(seconds), 4),
    }


def rig_doubts(results: Iterable[Result]) -> list[str]:
    """Say which views of a session contradict the first one, given the results of its frames; empty without any.

    The limits are those of a frame by default.
    """
    limits, found = TrustConfig(), list[str]()
    for name, count, rotation, covariance in rotations_of_views(results):
        angle = float(np.linalg.norm(rotation))
        sigmas = float(np.sqrt(rotation @ np.linalg.solve(covariance, rotation)))
        found += reasons(rig_turned(name, count, angle, sigmas, limits))
    return found
