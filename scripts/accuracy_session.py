"""Errors of session calibrations against the true camera_from_base, and check of their covariances.

The results of a session's frames are solved together, one session in each worker process. The intervals are computed
from the covariance in session.json: of the base's rotation and of its origin (the remote centre of motion), along and
about the base's own axes.
"""

from __future__ import annotations

import multiprocessing
from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
from accuracy_calibration import share_interval
from accuracy_cases import Case, Run, print_progress
from accuracy_errors import RIGHT_MODE_DEG
from numpy.typing import NDArray
from scipy.stats import chi2

from dvrk_cmaes.calibration.calibrate import SolvedSession, calibrate_session
from dvrk_cmaes.calibration.frame_task import SessionFrame
from dvrk_cmaes.calibration.model import BASE_AXES
from dvrk_cmaes.config import EstimateConfig
from dvrk_cmaes.errors import InputError
from dvrk_cmaes.evaluate.pose_error import PoseError, compare_poses
from dvrk_cmaes.frames.frame import FrameData
from dvrk_cmaes.frames.session_folder import read_session
from dvrk_cmaes.geometry import change_between, rotation_angle
from dvrk_cmaes.instrument import Instrument
from dvrk_cmaes.instrument.arm import Arm
from dvrk_cmaes.results.result import Result
from dvrk_cmaes.silhouette.prepare import prepare

Float64 = NDArray[np.float64]

INTERVAL: Final = 0.95


@dataclass(frozen=True, eq=False)
class Trial:
    """A session to calibrate: the results of its frames in order, and the truth.

    ``kind`` states what was falsified, see `accuracy_cases.Case`; ``base`` (4, 4) is the true camera_from_base.
    """

    session: str
    level: str
    kind: str
    runs: Sequence[Run]
    base: Float64
    arm: Arm = "classic"


@dataclass(frozen=True, eq=False)
class Outcome:
    """Outcome of a trial: the solved session, or the message with which it was refused."""

    trial: Trial
    solved: SolvedSession | None
    refusal: str = ""


def read_bases(folders: Sequence[str]) -> dict[str, Float64]:
    """Read the true camera_from_base of session folders, by name; InputError if one has none."""
    found = {}
    for folder in folders:
        session = read_session(folder)
        if session.truth.camera_from_base is None:
            raise InputError(f"{session.folder / 'golden.json'}: expected the truth of camera_from_base, got none")
        found[session.folder.resolve().name] = session.truth.camera_from_base
    return found


def original_trials(runs: Sequence[Run], bases: Mapping[str, Float64]) -> list[Trial]:
    """Make a trial of each session, without falsification."""
    grouped: dict[str, list[Run]] = {}
    for run in runs:
        grouped.setdefault(run.case.session, []).append(run)
    return [Trial(name, own[0].case.level, own[0].case.kind, own, bases[name]) for name, own in grouped.items()]


def run_trials(trials: Sequence[Trial], *, instrument: str, config: EstimateConfig, workers: int) -> list[Outcome]:
    """Calibrate all sessions in worker processes; the outcomes are in the order of the trials."""
    single = replace(config, threads=1)
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(workers, context) as pool:
        futures = [pool.submit(_calibrate, trial, instrument, single) for trial in trials]
        outcomes = []
        for count, (trial, future) in enumerate(zip(trials, futures, strict=True), start=1):
            outcomes.append(Outcome(trial, *future.result()))
            print_progress("sessions", count, len(trials))
        return outcomes


def _calibrate(trial: Trial, instrument: str, config: EstimateConfig) -> tuple[SolvedSession | None, str]:
    """Calibrate a session in a worker process; return the solved session, or None and the message of the error."""
    frames = [
        SessionFrame(f"{k:04d}", _data(run.case), replace(Result.from_dict(dict(run.result)), frame=f"{k:04d}"))
        for k, run in enumerate(trial.runs)
    ]
    try:
        return calibrate_session(frames, prepare(instrument), arm=trial.arm, config=config), ""
    except InputError as error:
        return None, str(error)


def _data(case: Case) -> FrameData:
    """Return the data of a case's frame."""
    return FrameData.of(case.mask, case.camera, case.ignore)


def base_error(outcome: Outcome) -> tuple[float, float]:
    """Return the error of camera_from_base: rotation, deg, and origin, mm."""
    assert outcome.solved is not None
    found, true = outcome.solved.calibration.camera_from_base, outcome.trial.base
    return (
        float(np.degrees(rotation_angle(found, true))),
        float(1e3 * np.linalg.norm(found[:3, 3] - true[:3, 3])),
    )


def frame_errors(instrument: Instrument, trial: Trial, results: Sequence[Result]) -> list[PoseError]:
    """Return the errors of a trial's frames in order, without those that have no pose or no truth."""
    pairs = zip(results, trial.runs, strict=True)
    return [
        compare_poses(instrument, (one.camera_from_root, one.joints), (truth.camera_from_root, truth.joints))
        for one, run in pairs
        if (truth := run.case.truth) is not None and one.camera_from_root is not None
    ]


def session_row(instrument: Instrument, outcome: Outcome) -> dict[str, Any]:
    """Return the errors of a session: of its base, and of its frames solved one by one and together."""
    trial, solved = outcome.trial, outcome.solved
    row: dict[str, Any] = {"session": trial.session, "kind": trial.kind, "frames": len(trial.runs)}
    if solved is None:
        return {**row, "refused": outcome.refusal}
    alone = frame_errors(instrument, trial, [Result.from_dict(dict(run.result)) for run in trial.runs])
    together = frame_errors(instrument, trial, list(solved.results.values()))
    left_out = np.array(list(solved.calibration.leave_one_out.values())).reshape(-1, 2)
    row["base_deg"], row["base_mm"] = base_error(outcome)
    row["right_mode"] = [sum(error.rotation_deg < RIGHT_MODE_DEG for error in errors) for errors in (alone, together)]
    row["tip_mm"] = [_median([error.tip_mm for error in errors]) for errors in (alone, together)]
    row["left_out_iou"], row["left_out_px"] = float(left_out[:, 0].mean()), float(np.median(left_out[:, 1]))
    row["left_out"] = " ".join(solved.calibration.left_out) or "-"
    row["seconds"] = solved.calibration.seconds
    return row


def _median(values: Sequence[float | None]) -> float | None:
    """Return the median of the values that are not None; None if there are none."""
    known = [value for value in values if value is not None]
    return float(np.median(known)) if known else None


def level_rows(rows: Sequence[Mapping[str, Any]], levels: Sequence[str]) -> list[dict[str, Any]]:
    """Return medians and maxima by level and over all sessions; ``tip_mm`` is solved one by one, then together."""
    found = []
    for level in dict.fromkeys([*levels, *(["all"] if len(set(levels)) > 1 else [])]):
        own = [row for row, is_of in zip(rows, levels, strict=True) if level in (is_of, "all") and "refused" not in row]
        if not own:
            continue
        one: dict[str, Any] = {"level": level, "sessions": len(own)}
        for name in ("base_deg", "base_mm"):
            one[name] = [float(np.median([row[name] for row in own])), float(max(row[name] for row in own))]
        frames = sum(row["frames"] for row in own)
        one["right_mode"] = [sum(row["right_mode"][k] for row in own) / frames for k in (0, 1)]
        one["tip_mm"] = [_median([row["tip_mm"][k] for row in own]) for k in (0, 1)]
        one["left_out_iou"] = float(np.mean([row["left_out_iou"] for row in own]))
        found.append(one)
    return found


def deviations(outcome: Outcome) -> Float64:
    """Return the deviations (8,) of the true base from the estimated one.

    The first six are along and about the base's axes, in standard deviations. The last two are the squared Mahalanobis
    distances of the origin and of the rotation, with three degrees of freedom each.
    """
    assert outcome.solved is not None
    calibration = outcome.solved.calibration
    off = change_between(calibration.camera_from_base, outcome.trial.base)
    covariance = calibration.covariance[:6, :6]
    whole = [off[part] @ np.linalg.solve(covariance[part, part], off[part]) for part in (slice(0, 3), slice(3, 6))]
    return np.array([*(off / np.sqrt(np.diag(covariance))), *whole])


def interval_rows(outcomes: Sequence[Outcome]) -> list[dict[str, Any]]:
    """Return the share of 95 % intervals that contain the truth, by level and quantity; see `accuracy_calibration`."""
    kept = [outcome for outcome in outcomes if outcome.solved is not None]
    levels = list(dict.fromkeys(outcome.trial.level for outcome in kept))
    rows = []
    for level in [*levels, *(["all"] if len(levels) > 1 else [])]:
        off = np.array([deviations(one) for one in kept if level in (one.trial.level, "all")])
        squared = np.concatenate([off[:, :6] ** 2, off[:, 6:]], axis=1)
        for k, name in enumerate((*BASE_AXES, "origin", "rotation")):
            freedom = 1 if k < 6 else 3
            held = int((squared[:, k] <= chi2.ppf(INTERVAL, freedom)).sum())
            low, high = share_interval(held, len(squared))
            rows.append(
                {
                    "level": level,
                    "quantity": name,
                    "sessions": len(squared),
                    "held": held / len(squared),
                    "from": low,
                    "to": high,
                    "rms_z": float(np.sqrt(squared[:, k].mean() / freedom)),
                    "median_z": float(np.sqrt(np.median(squared[:, k]) / chi2.median(freedom))),
                }
            )
    return rows


def session_report(instrument: Instrument, outcomes: Sequence[Outcome]) -> dict[str, list[dict[str, Any]]]:
    """Report the errors by session and by level, and the share of 95 % intervals that contain the truth."""
    rows = [session_row(instrument, outcome) for outcome in outcomes]
    return {
        "sessions": rows,
        "levels": level_rows(rows, [outcome.trial.level for outcome in outcomes]),
        "95 % intervals that hold the truth": interval_rows(outcomes),
    }
