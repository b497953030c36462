"""Errors of the lag that is found between the images and the readings of recordings with a known lag.

The recordings are those of `dvrk-cmaes synth --motion video --lag LAG`; their true lag is in synth.json. A lag is
claimed if it would be taken out of the readings.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from dvrk_cmaes.calibration.calibrate import find_lag
from dvrk_cmaes.errors import InputError
from dvrk_cmaes.io.json_file import read_json_object
from dvrk_cmaes.joints.lag import Lag
from dvrk_cmaes.synth.session import PLAN_FILE
from measure.cases import Measurement, by_session, session_frames

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


def find_lags(given: Measurement) -> list[LagTrial]:
    """Find the lags of recordings from the results of their frames; InputError for a session that is no such video."""
    trials = []
    for name, own in by_session(given.runs()).items():
        session = own[0].case.recording.session
        path = session.folder / PLAN_FILE
        plan = read_json_object(path, expected="the parameters of a synthetic session")
        if plan.get("motion") != "video":
            raise InputError(f"{path}: motion: expected video, got {plan.get('motion')!r}")
        frames = session_frames([run.case for run in own], [run.result for run in own])
        lag, _ = find_lag(frames, given.body, series=session.reading_series(), config=given.config)
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
