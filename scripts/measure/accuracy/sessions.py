"""Errors of session calibrations against the true camera_from_base, and check of their covariances.

The results of a session's frames are solved together, one session in each worker process. The intervals are computed
from the covariance in session.json: of the base's rotation and of its origin (the remote centre of motion), along and
about the base's own axes.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.calibration.calibrate import SolvedSession, calibrate_session
from dvrk_cmaes.calibration.model import BASE_AXES
from dvrk_cmaes.config import EstimateConfig
from dvrk_cmaes.errors import InputError
from dvrk_cmaes.evaluate.pose_error import PoseError
from dvrk_cmaes.geometry import change_between
from dvrk_cmaes.instrument import Instrument
from dvrk_cmaes.instrument.arm import Arm
from dvrk_cmaes.results.result import Result
from dvrk_cmaes.silhouette.prepare import prepare
from measure.accuracy.errors import error_of
from measure.accuracy.figures import RIGHT_MODE_DEG, base_errors, interval_figures
from measure.cases import Measurement, Run, by_level, by_session, session_frames
from measure.processes import in_processes

Float64 = NDArray[np.float64]

INTERVAL: Final = 0.95


@dataclass(frozen=True, eq=False)
class Trial:
    """A session to calibrate: the results of its frames in order, and the truth.

    ``kind`` states what was falsified, see `measure.cases.Case`; ``base`` (4, 4) is the true camera_from_base, None if
    it is not known.
    """

    session: str
    level: str
    kind: str
    runs: Sequence[Run]
    base: Float64 | None
    arm: Arm = "classic"


@dataclass(frozen=True, eq=False)
class Outcome:
    """Outcome of a trial: the solved session, or the message with which it was refused."""

    trial: Trial
    solved: SolvedSession | None
    refusal: str = ""


def original_trials(runs: Sequence[Run]) -> list[Trial]:
    """Make a trial of each session, without falsification."""
    groups = by_session(runs).items()
    return [
        Trial(name, own[0].case.level, own[0].case.kind, own, own[0].case.recording.session.truth.camera_from_base)
        for name, own in groups
    ]


def solve(
    given: Measurement, trials: Sequence[Trial], *, timed: bool = False, refine_camera: bool = False
) -> list[Outcome]:
    """Calibrate all sessions in worker processes; the outcomes are in the order of the trials.

    With ``timed``, all readings of the recordings and the times of their images count, as in the command `calibrate`;
    ``refine_camera`` is that of `calibrate_session`.
    """
    found: dict[int, tuple[SolvedSession | None, str]] = {}
    tasks = [(trial.runs, trial.arm, given.source, given.config, timed, refine_camera) for trial in trials]
    in_processes(_calibrate, tasks, given.workers, "sessions", found.__setitem__)
    return [Outcome(trial, *found[number]) for number, trial in enumerate(trials)]


def _calibrate(
    runs: Sequence[Run], arm: Arm, source: str, config: EstimateConfig, timed: bool, refine_camera: bool
) -> tuple[SolvedSession | None, str]:
    """Calibrate a session in a worker process; return the solved session, or None and the message of the error."""
    names = [run.case.frame if timed else f"{k:04d}" for k, run in enumerate(runs)]
    session = runs[0].case.recording.session
    times = {one.name: one.time for one in session.frames if one.time is not None} if timed else None
    series = session.reading_series() if timed else None
    frames = session_frames([run.case for run in runs], [run.result for run in runs], names=names, times=times)
    single = replace(config, threads=1)
    try:
        return calibrate_session(
            frames, prepare(source), series=series, arm=arm, refine_camera=refine_camera, config=single
        ), ""
    except InputError as error:
        return None, str(error)


def base_error(outcome: Outcome) -> tuple[float, float]:
    """Return the error of camera_from_base: rotation, deg, and origin, mm."""
    assert outcome.solved is not None
    assert outcome.trial.base is not None
    return base_errors(outcome.solved.calibration.camera_from_base, outcome.trial.base)


def frame_errors(instrument: Instrument, trial: Trial, results: Sequence[Result]) -> list[PoseError]:
    """Return the errors of a trial's frames in order, without those that have no pose or no truth."""
    pairs = zip(results, trial.runs, strict=True)
    return [error for one, run in pairs if (error := error_of(instrument, one, run.case.truth)) is not None]


def session_row(instrument: Instrument, outcome: Outcome) -> dict[str, Any]:
    """Return the errors of a session: of its base, and of its frames solved one by one and together."""
    trial, solved = outcome.trial, outcome.solved
    row: dict[str, Any] = {"session": trial.session, "kind": trial.kind, "frames": len(trial.runs)}
    if solved is None:
        return {**row, "refused": outcome.refusal}
    alone = frame_errors(instrument, trial, [run.result for run in trial.runs])
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
    groups = by_level([*zip(rows, levels, strict=True)], lambda pair: pair[1])
    for level, pairs in groups.items():
        own = [row for row, _ in pairs if "refused" not in row]
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
    assert outcome.trial.base is not None
    calibration = outcome.solved.calibration
    off = change_between(calibration.camera_from_base, outcome.trial.base)
    covariance = calibration.covariance[:6, :6]
    whole = [off[part] @ np.linalg.solve(covariance[part, part], off[part]) for part in (slice(0, 3), slice(3, 6))]
    return np.array([*(off / np.sqrt(np.diag(covariance))), *whole])


def interval_rows(outcomes: Sequence[Outcome]) -> list[dict[str, Any]]:
    """Return the share of 95 % intervals that contain the truth, by level and quantity."""
    kept = [outcome for outcome in outcomes if outcome.solved is not None]
    rows = []
    for level, group in by_level(kept, lambda outcome: outcome.trial.level).items():
        off = np.array([deviations(one) for one in group])
        squared = np.concatenate([off[:, :6] ** 2, off[:, 6:]], axis=1)
        for column, name in zip(squared.T, (*BASE_AXES, "origin", "rotation"), strict=True):
            freedom = 1 if name in BASE_AXES else 3
            rows.append(
                {"level": level, "quantity": name, "sessions": len(column)}
                | interval_figures(column, freedom, INTERVAL)
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
