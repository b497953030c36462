"""Errors of the lag that is found between the images and the readings of recordings with a known lag.

The recordings are those of `dvrk-cmaes synth --motion video --lag LAG`; their true lag is in synth.json. A lag is
claimed if it would be taken out of the readings.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np
from accuracy_cases import Run

from dvrk_cmaes.calibration.calibrate import find_lag
from dvrk_cmaes.calibration.frame_task import SessionFrame
from dvrk_cmaes.config import EstimateConfig
from dvrk_cmaes.errors import InputError
from dvrk_cmaes.frames.frame import FrameData
from dvrk_cmaes.frames.session_folder import read_session
from dvrk_cmaes.io.json_file import read_json_object
from dvrk_cmaes.joints.lag import Lag
from dvrk_cmaes.results.result import Result
from dvrk_cmaes.silhouette.prepare import prepare
from dvrk_cmaes.synth.session import PLAN_FILE

NEAR: Final = 0.3  # frames
INTERVAL: Final = 1.96  # standard deviations, of 95 %


@dataclass(frozen=True)
class LagTrial:
    """A recording's true lag, frames, and the lag found, None where it is not determined."""

    session: str
    level: str
    true: float
    found: Lag | None

    @property
    def error(self) -> float | None:
        """Found less true lag, frames; None where it is not determined."""
        return None if self.found is None or self.found.frames is None else self.found.frames - self.true


def find_lags(
    folders: Sequence[str], runs: Sequence[Run], *, instrument: str, config: EstimateConfig
) -> list[LagTrial]:
    """Find the lags of recordings from the results of their frames; InputError for a session that is no such video."""
    body, trials = prepare(instrument), []
    for folder in folders:
        session = read_session(folder, known=body.instrument.joint_names)
        plan = read_json_object(Path(folder) / PLAN_FILE, expected="the parameters of a synthetic session")
        if plan.get("motion") != "video":
            raise InputError(f"{Path(folder) / PLAN_FILE}: motion: expected video, got {plan.get('motion')!r}")
        name = session.folder.resolve().name
        own = [run for run in runs if run.case.session == name]
        frames = [
            SessionFrame(
                run.case.frame,
                FrameData.of(run.case.mask, run.case.camera, run.case.ignore),
                replace(Result.from_dict(dict(run.result)), frame=run.case.frame),
            )
            for run in own
        ]
        lag, _ = find_lag(frames, body, series=session.reading_series(), config=config)
        trials.append(LagTrial(name, own[0].case.level, float(plan["motion_level"]["lag"]), lag))
    return trials


def lag_report(trials: Sequence[LagTrial]) -> dict[str, list[Mapping[str, Any]]]:
    """Report each recording, and by level the shares of lags that are found, told, and claimed where there is none."""
    return {"recordings": list(_rows(trials)), "lags found": list(_levels(trials))}


def _rows(trials: Sequence[LagTrial]) -> Iterator[Mapping[str, Any]]:
    for trial in trials:
        found, error = trial.found, trial.error
        row: dict[str, Any] = {"session": trial.session, "lag": trial.true}
        if found is not None and error is not None:
            std = found.std_frames or np.nan
            row |= {"found": found.frames, "std": std, "error": error, "in std": error / std, "claimed": found.applied}
        yield row


def _levels(trials: Sequence[LagTrial]) -> Iterator[Mapping[str, Any]]:
    for level in dict.fromkeys(trial.level for trial in trials):
        own = [trial for trial in trials if trial.level == level]
        late = [trial for trial in own if trial.true != 0]
        told = [trial for trial in own if trial.error is not None]
        inside = [
            abs(trial.error or 0.0) <= INTERVAL * (trial.found.std_frames or 0.0) for trial in told if trial.found
        ]
        right = [trial for trial in late if trial.error is None or abs(trial.error) <= NEAR]
        claimed = [t for t in own if t.true == 0 and t.found is not None and t.found.applied]
        yield {
            "level": level,
            "late": len(late),
            f"within {NEAR:g} frame or untold": len(right),
            "untold": len(own) - len(told),
            "95 % interval holds": f"{sum(inside)} of {len(inside)}",
            "without lag": len(own) - len(late),
            "claimed there": len(claimed),
        }
