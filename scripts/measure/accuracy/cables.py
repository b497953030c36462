"""Errors of wrist and jaw that the other frames of a recording predict, with and without a model of the cables.

Each recording is calibrated twice, with ``session.cables`` and with offsets only. A frame's joints are predicted from
its readings and all other frames, without its image, and compared with the truth. Where the frames are not estimated by
themselves, their results are drawn about the truth, which saves most of the time: the calibration fits their masks all
the same.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.calibration.calibrate import SolvedSession, calibrate_session
from dvrk_cmaes.instrument import Instrument
from dvrk_cmaes.results.result import Result
from dvrk_cmaes.silhouette import Body
from measure.cases import Case, Measurement, grouped, session_frames
from measure.processes import print_progress

Float64 = NDArray[np.float64]

_STD: Final = (2e-4, 2e-4, 6e-4, *np.deg2rad([0.3, 0.3, 2.0]))
"""Standard deviations of drawn results, of the pose in the root's axes, m and rad,"""
_JOINT_STD: Final = np.deg2rad(2.0)  # and of each joint
_INTERVAL: Final = 1.645  # standard deviations on both sides of a 90 % interval


class Predictions(NamedTuple):
    """Errors and standard deviations (N, J), rad, of the predicted joints of a recording's frames."""

    errors: Float64
    stds: Float64


def cables_report(given: Measurement, *, estimated: bool) -> dict[str, list[dict[str, Any]]]:
    """Report the errors of each recording and of all together; unless ``estimated``, results are about the truth."""
    body, cases = given.body, given.cases()
    results = {run.case: run.result for run in given.runs(cases)} if estimated else {}
    rows: list[dict[str, Any]] = []
    every: dict[bool, list[Predictions]] = {True: [], False: []}
    groups = grouped(cases, lambda case: case.session)
    for count, (name, own) in enumerate(groups.items(), start=1):
        found = [results[case] for case in own] if estimated else drawn_results(body, own, seed=count)
        for with_cables in (False, True):
            solved = _solve(given, own, found, with_cables=with_cables)
            predicted = predictions(solved, own, given.instrument)
            every[with_cables].append(predicted)
            rows.append({"session": name} | _row(predicted, body, with_cables=with_cables) | _parts(solved))
        print_progress("recordings", count, len(groups))
    for with_cables, several in every.items():
        joined = Predictions(*(np.concatenate(values) for values in zip(*several, strict=True)))
        rows.append({"session": "all"} | _row(joined, body, with_cables=with_cables))
    return {"joints predicted by the other frames, rms, deg, and share of 90 % intervals that hold the truth": rows}


def drawn_results(body: Body, cases: Sequence[Case], *, seed: int) -> list[Result]:
    """Draw results about the truth, with their covariance stated."""
    names, rng = body.instrument.joint_names, np.random.default_rng(seed)
    std = np.array([*_STD, *[_JOINT_STD] * len(names)])
    found = []
    for case in cases:
        off = std * rng.standard_normal(len(std))
        at = case.true(body.instrument).moved(off)
        found.append(
            Result(
                frame=case.frame,
                status="ok",
                reasons=(),
                instrument=body.instrument.name,
                root_link=body.instrument.root_link,
                camera_from_root=at.pose,
                joints=dict(zip(names, at.joints.tolist(), strict=True)),
                readings=dict(case.readings),
                covariance=np.diag(std**2),
            )
        )
    return found


def _solve(given: Measurement, cases: Sequence[Case], results: Sequence[Result], *, with_cables: bool) -> SolvedSession:
    """Calibrate a recording with a model of the cables, or with offsets only."""
    series = cases[0].recording.session.reading_series()
    frames = session_frames(cases, results, times=None if series is None else series.frames)
    settings = replace(given.config, session=replace(given.config.session, cables=with_cables))
    return calibrate_session(frames, given.body, series=series, config=settings)


def predictions(solved: SolvedSession, cases: Sequence[Case], instrument: Instrument) -> Predictions:
    """Return the errors of the predicted joints of all frames that were fitted."""
    errors, stds = [], []
    for case in cases:
        found = solved.leave_one_out.get(case.frame)
        if found is not None:
            errors.append(found.joints - case.true(instrument).joints)
            stds.append(found.joint_std)
    return Predictions(np.array(errors), np.array(stds))


def _row(found: Predictions, body: Body, *, with_cables: bool) -> dict[str, Any]:
    """Return the root mean square error by joint and of all, deg, and the share of intervals that hold the truth."""
    rms = np.degrees(np.sqrt(np.mean(found.errors**2, axis=0)))
    return {
        "model": "cables" if with_cables else "offsets",
        **dict(zip(body.instrument.joint_names, rms.tolist(), strict=True)),
        "all joints": float(np.degrees(np.sqrt(np.mean(found.errors**2)))),
        "held": float(np.mean(np.abs(found.errors) <= _INTERVAL * found.stds)),
    }


def _parts(solved: SolvedSession) -> dict[str, Any]:
    """Return which parts of the model a calibration used."""
    cables = solved.calibration.cables
    return {"parts": "-" if cables is None else " ".join(cables.parts)}
