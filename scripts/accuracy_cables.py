"""Errors of wrist and jaw that the other frames of a recording predict, with and without a model of the cables.

Each recording is calibrated twice, with ``session.cables`` and with offsets only. A frame's joints are predicted from
its readings and all other frames, without its image, and compared with the truth. Where the frames are not estimated by
themselves, their results are drawn about the truth, which saves most of the time: the calibration fits their masks all
the same.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
from accuracy_cases import Case, Run, print_progress
from numpy.typing import NDArray

from dvrk_cmaes.calibration.calibrate import SolvedSession, calibrate_session
from dvrk_cmaes.calibration.frame_task import SessionFrame
from dvrk_cmaes.config import EstimateConfig
from dvrk_cmaes.frames.frame import FrameData
from dvrk_cmaes.frames.session_folder import Session, read_session
from dvrk_cmaes.geometry import moved
from dvrk_cmaes.results.result import Result
from dvrk_cmaes.silhouette import Body
from dvrk_cmaes.silhouette.prepare import prepare

Float64 = NDArray[np.float64]

_STD: Final = (2e-4, 2e-4, 6e-4, *np.deg2rad([0.3, 0.3, 2.0]))
"""Standard deviations of drawn results, of the pose in the root's axes, m and rad,"""
_JOINT_STD: Final = np.deg2rad(2.0)  # and of each joint
_INTERVAL: Final = 1.645  # standard deviations on both sides of a 90 % interval


@dataclass(frozen=True, eq=False)
class Predictions:
    """Errors and standard deviations (N, J), rad, of the predicted joints of a recording's frames."""

    errors: Float64
    stds: Float64


def cables_report(
    folders: Sequence[str], instrument: str, config: EstimateConfig, runs: Sequence[Run], cases: Sequence[Case]
) -> dict[str, list[dict[str, Any]]]:
    """Report the errors of each recording and of all together; without ``runs``, results are drawn about the truth."""
    body = prepare(instrument)
    rows: list[dict[str, Any]] = []
    every: dict[bool, list[Predictions]] = {True: [], False: []}
    for count, folder in enumerate(folders, start=1):
        session = read_session(folder, known=body.instrument.joint_names)
        name = session.folder.resolve().name
        own = [case for case in cases if case.session == name]
        results = [Result.from_dict(dict(run.result)) for run in runs if run.case.session == name]
        frames = session_frames(session, own, results or drawn_results(body, own, seed=count))
        for with_cables in (False, True):
            solved = _solve(frames, session, body, config, with_cables=with_cables)
            found = predictions(solved, own, body.instrument.joint_names)
            every[with_cables].append(found)
            rows.append({"session": name} | _row(found, body, with_cables=with_cables) | _parts(solved))
        print_progress("recordings", count, len(folders))
    for with_cables, all_found in every.items():
        joined = Predictions(
            np.concatenate([one.errors for one in all_found]), np.concatenate([one.stds for one in all_found])
        )
        rows.append({"session": "all"} | _row(joined, body, with_cables=with_cables))
    return {"joints predicted by the other frames, rms, deg, and share of 90 % intervals that hold the truth": rows}


def session_frames(session: Session, cases: Sequence[Case], results: Sequence[Result]) -> list[SessionFrame]:
    """Return the frames of a calibration."""
    series = session.reading_series()
    times: Mapping[str, float] = {} if series is None else series.frames
    return [
        SessionFrame(
            case.frame,
            FrameData.of(case.mask, case.camera, case.ignore),
            replace(result, frame=case.frame),
            time=times.get(case.frame),
        )
        for case, result in zip(cases, results, strict=True)
    ]


def drawn_results(body: Body, cases: Sequence[Case], *, seed: int) -> list[Result]:
    """Draw results about the truth, with their covariance stated."""
    names, rng = body.instrument.joint_names, np.random.default_rng(seed)
    std = np.array([*_STD, *[_JOINT_STD] * len(names)])
    found = []
    for case in cases:
        assert case.truth is not None
        off = std * rng.standard_normal(len(std))
        joints = {name: case.truth.joints[name] + off[6 + k] for k, name in enumerate(names)}
        found.append(
            Result(
                frame=case.frame,
                status="ok",
                reasons=(),
                instrument=body.instrument.name,
                root_link=body.instrument.root_link,
                camera_from_root=moved(case.truth.camera_from_root, off[:6]),
                joints=joints,
                readings=dict(case.readings),
                covariance=np.diag(std**2),
            )
        )
    return found


def _solve(
    frames: Sequence[SessionFrame], session: Session, body: Body, config: EstimateConfig, *, with_cables: bool
) -> SolvedSession:
    settings = replace(config, session=replace(config.session, cables=with_cables))
    return calibrate_session(frames, body, series=session.reading_series(), config=settings)


def predictions(solved: SolvedSession, cases: Sequence[Case], names: Sequence[str]) -> Predictions:
    """Return the errors of the predicted joints of all frames that were fitted."""
    errors, stds = [], []
    for case in cases:
        found = solved.leave_one_out.get(case.frame)
        if found is not None and case.truth is not None:
            errors.append(found.joints - np.array([case.truth.joints[name] for name in names]))
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
