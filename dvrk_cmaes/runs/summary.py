"""``summary.json``: counts, medians and times of a session's results. Only ``timing`` differs between equal runs."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Final, get_args

import numpy as np

from dvrk_cmaes.calibration.session_camera import rotations_of_views
from dvrk_cmaes.config import TrustConfig
from dvrk_cmaes.joints.prior import commanded_in
from dvrk_cmaes.pose.doubts import reasons, rig_turned
from dvrk_cmaes.results.result import Result, Status

SCHEMA: Final = 1
Document = Mapping[str, Any]
_OF_QUALITY: Final = ("iou", "contour_px_median", "contour_px_95")
_DIGITS: Final = 6


def summarize(
    results: Mapping[str, Result], manifest: Document, ran: tuple[int, float], calibration: Document | None
) -> dict[str, Any]:
    """Return the content of summary.json.

    Parameters
    ----------
    results
        The results by name of the frame.
    manifest
        The manifest, with all frames of the session.
    ran
        Number of frames that the run that has just ended has estimated, if any, and its duration, s.
    calibration
        The content of session.json if the frames were solved together; its lag is repeated.
    """
    missing = sorted(set(manifest["frames"]) - set(results))
    values, (done, seconds) = list(results.values()), ran
    timing = {"frames": done, "seconds": round(seconds, 3), "frames_per_second": round(done / (seconds or 1.0), 4)}
    statuses = Counter(result.status for result in values)
    counts = {status: statuses[status] for status in get_args(Status)}
    names = tuple(dict.fromkeys(name for result in values for name in result.joints))
    return {
        "schema": SCHEMA,
        "session": manifest["session"],
        "warnings": manifest.get("warnings", []),
        "version": manifest["version"],
        "instrument": manifest["instrument"]["name"],
        "counts": {"frames": len(values) + len(missing), **counts, "missing": len(missing)},
        "medians": _medians(values),
        "frames": {name: {"status": r.status, "reasons": list(r.reasons)} for name, r in results.items()},
        "missing": missing,
        "lag": None if calibration is None else calibration.get("lag"),
        "commanded": commanded_in([result.readings for result in values], names),
        "timing": {"run": timing if done else None},
        "config": manifest["config"],
        **({"rig_doubts": rig_doubts(values)} if any(result.view_fits for result in values) else {}),
    }


def _medians(results: Sequence[Result]) -> dict[str, Any]:
    """Compute medians over the frames that have a pose."""
    quality = [result.quality for result in results if result.quality is not None]
    errors = [result.expected_error.tip_90_mm for result in results if result.expected_error is not None]
    modes = [result.mode_probability for result in results if result.mode_probability is not None]
    return {
        **{name: _median([getattr(one, name) for one in quality]) for name in _OF_QUALITY},
        "tips_90_mm": _median(errors),
        "mode_probability": _median(modes),
    }


def _median(values: Sequence[Any]) -> Any:
    """Return the median over the first axis, rounded; None if there are no values."""
    return np.round(np.median(values, axis=0), _DIGITS).tolist() if len(values) else None


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
