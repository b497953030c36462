"""Recordings with known truth, each calibrated from a share of its frames: tips, base, lag, and what is stated.

The true lag is the one at which the readings place the instrument's root nearest to where it was.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.calibration.calibrate import SolvedSession, calibrate_session
from dvrk_cmaes.calibration.document import SessionCalibration
from dvrk_cmaes.calibration.frame_task import SessionFrame
from dvrk_cmaes.calibration.session_camera import HINT
from dvrk_cmaes.camera import Rig
from dvrk_cmaes.config import EstimateConfig
from dvrk_cmaes.errors import InputError
from dvrk_cmaes.frames.frame import FrameFiles, read_frame
from dvrk_cmaes.frames.session_folder import Session
from dvrk_cmaes.geometry import change_between, inverse
from dvrk_cmaes.instrument.arm import OUTER_JOINTS, base_from_root
from dvrk_cmaes.joints.series import ReadingSeries
from dvrk_cmaes.runs.inputs import instrument_digest
from dvrk_cmaes.runs.instrument_processes import instrument_processes, run_with_body
from dvrk_cmaes.runs.recorded_keyframes import RecordedKeyframe, alone_task, read_shown
from dvrk_cmaes.silhouette import Body
from measure.accuracy.figures import base_errors

Float64 = NDArray[np.float64]

_VISIBLE: Final = 0.5
_NEAR: Final = 0.3  # frames, between a lag and the true one
MOST_STD: Final = 3.0
"""Standard deviations within which each of the six directions of a base is to be."""

_FOCAL: Final = 1.1  # factor on a focal length that is wrong
_INTERVAL: Final = 1.96  # standard deviations, of 95 %
_WRONG_MM: Final = 1.2  # median of the tips, from which on a calibration is bad
_LAGS: Final = np.arange(-5.0, 15.0, 0.02)  # frames


@dataclass(frozen=True, eq=False)
class CalibratedRecording:
    """Figures of one recording, and the errors of its tips, mm, (F,)."""

    row: dict[str, Any]
    errors: Float64


def calibrated(
    name: str, session: Session, golden: Mapping[str, Any], body: Body, config: EstimateConfig, workers: int, every: int
) -> CalibratedRecording:
    """Calibrate every N-th frame of a recording, and compare with the truth in golden.json."""
    print(f"{name}: calibrating", file=sys.stderr, flush=True)
    series = session.reading_series()
    truths, true_base = golden["frames"], np.array(golden["camera_from_base"])
    lag = None if series is None else true_lag(truths, true_base, series)
    empty = {"recording": name, "tips, mm": None, "95 %": None, "worst": None, "ok": None, "ok beyond 2 mm": None}
    row: dict[str, Any] = {**empty, "base, deg": None, "base, mm": None, "base / std": None, "lag": None, "std": None}
    row |= {"true lag": lag, "doubt": "yes"}
    try:
        solved = calibrate_share(session, body, config, workers, every)
    except InputError as error:
        return CalibratedRecording(row | {"doubt": str(error)}, np.zeros(0))
    errors, ok = _tip_errors(solved, truths)
    found = solved.calibration
    row["tips, mm"], row["95 %"], row["worst"] = np.percentile(errors, [50, 95, 100]).tolist()
    row["ok"], row["ok beyond 2 mm"] = float(ok.mean()), float((errors[ok] > 2.0).mean()) if ok.any() else None
    row["base, deg"], row["base, mm"] = base_errors(found.camera_from_base, true_base)
    row["base / std"] = base_in_std(found, true_base)
    if found.lag is not None:
        row["lag"], row["std"] = found.lag.frames, found.lag.std_frames
    row["doubt"] = "yes" if found.doubts else "no"
    return CalibratedRecording(row, errors)


def base_in_std(found: SessionCalibration, true: Float64) -> float:
    """Return the error of a camera_from_base in the worst of its six directions, in stated standard deviations."""
    off = change_between(found.camera_from_base, true)
    return float(np.abs(off / np.sqrt(np.diag(found.covariance[:6, :6]))).max())


def wrong_focal_length(
    session: Session, body: Body, config: EstimateConfig, workers: int, every: int, *, longer: bool
) -> bool | str:
    """Return whether every N-th frame of a recording names a focal length that is 10 % off, or why it is refused.

    A remark that it may be off names it, too.
    """
    scale = _FOCAL if longer else 1 / _FOCAL
    changed = {view.name: view.camera.changed(scale, (0.0, 0.0)) for view in session.rig.views}
    wrong = replace(session, rig=session.rig.with_cameras(changed))
    try:
        solved = calibrate_share(wrong, body, config, workers, every)
    except InputError as error:
        return str(error)
    return names_focal_length(solved.calibration)


def names_focal_length(found: SessionCalibration) -> bool:
    """Return whether a calibration says that the camera's focal length is wrong, or may be."""
    contradicted = found.camera is not None and found.camera.contradicts
    return contradicted or any(text.startswith(HINT) for text in found.remarks)


def calibrate_share(session: Session, body: Body, config: EstimateConfig, workers: int, every: int) -> SolvedSession:
    """Estimate every N-th frame that shows something, and solve these together, as `calibrate --every` does."""
    series = session.reading_series()
    files = [own for own in session.frames[::every] if _shows_something(own, session.rig)]
    with instrument_processes(body.instrument, workers, files) as processes:
        run = partial(run_with_body, processes, instrument_digest(body.instrument), config)
        keyframes = [
            RecordedKeyframe(number, own, partial(read_frame, own.changed(image=None), session.rig))
            for number, own in enumerate(files)
        ]
        results = run(partial(alone_task, arm="classic"), keyframes)
        frames = [
            SessionFrame(one.files.name, one.read, result, one.files.keypoints)
            for one, result in zip(keyframes, results, strict=True)
        ]
        return calibrate_session(frames, body, series=series, config=config, run=run)


def _shows_something(files: FrameFiles, rig: Rig) -> bool:
    """Whether any mask of a frame shows something; an instrument that leaves the view has an empty one."""
    data = read_shown(files, rig)
    return data is not None and any(view.shows for view in data.views)


def true_lag(truths: Mapping[str, Any], camera_from_base: Float64, series: ReadingSeries) -> float | None:
    """Return the lag, frames, at which the readings place the root nearest to the truth; None where it is not told."""
    named = [name for name in truths if name in series.frames]
    times = np.array([series.frames[name] for name in named])
    poses = np.array([truths[name]["T_camera_roll_link"] for name in named])
    true = (inverse(camera_from_base) @ poses)[:, :3, 3]
    costs = []
    for lag in _LAGS:
        outer = series.at(OUTER_JOINTS, times - lag * series.interval)
        known = ~np.isnan(outer).any(axis=1)
        placed = base_from_root(outer[known])[:, :3, 3]
        costs.append(float(np.median(np.linalg.norm(placed - true[known], axis=1))) if known.any() else np.inf)
    return float(_LAGS[int(np.argmin(costs))]) if np.isfinite(costs).any() else None


def _tip_errors(solved: SolvedSession, truths: Mapping[str, Any]) -> tuple[Float64, NDArray[np.bool_]]:
    """Return the errors of the tips, mm, of frames in which the jaws are seen, and which of these are ok."""
    errors, ok = [], []
    for name, result in solved.results.items():
        truth = truths[name]
        if truth.get("visible", 1.0) >= _VISIBLE and result.tips:
            off = np.array(result.tips) - np.array(truth["tips_camera_m"])
            errors.append(1e3 * float(np.linalg.norm(off, axis=1).mean()))
            ok.append(result.status == "ok")
    return np.array(errors), np.array(ok, dtype=np.bool_)


def pooled(each: Sequence[CalibratedRecording]) -> dict[str, Any]:
    """Return the figures of all recordings together."""
    rows = [one.row for one in each]
    solved = [row for row in rows if row["tips, mm"] is not None]
    told = [row for row in solved if row["lag"] is not None and row["true lag"] is not None]
    off = [abs(row["lag"] - row["true lag"]) for row in told]
    bad = [row for row in rows if row["tips, mm"] is None or row["tips, mm"] > _WRONG_MM]
    return {
        "recordings": len(rows),
        "tips, mm": float(np.median(np.concatenate([one.errors for one in each]))),
        "worst median": max((row["tips, mm"] for row in solved), default=None),
        f"base within {MOST_STD:g} std": sum(row["base / std"] <= MOST_STD for row in solved),
        "bad": len(bad),
        "bad that say so": sum(row["doubt"] != "no" for row in bad),
        "lag told": len(told),
        f"within {_NEAR} frames or untold": len(rows) - sum(error > _NEAR for error in off),
        "95 % holds": sum(error <= _INTERVAL * (row["std"] or 0.0) for error, row in zip(off, told, strict=True)),
    }
