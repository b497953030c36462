"""Both eyes of stereo sessions against one: errors, modes, cost, and rigs whose calibration is wrong.

Each frame is estimated from each eye alone, from both eyes, and from both with a rig whose baseline is 2 % off and
whose rotation 0.3 deg, in a direction that the session's place in the list determines. Without readings, only the modes
of the left eye and of both eyes are compared. The cost is the time of the process's CPU, so that other programs on the
machine count little.
"""

from __future__ import annotations

import os
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
from accuracy_cases import print_progress
from accuracy_errors import RIGHT_MODE_DEG

from dvrk_cmaes.camera import Rig
from dvrk_cmaes.config import EstimateConfig
from dvrk_cmaes.errors import InputError
from dvrk_cmaes.estimation import estimate
from dvrk_cmaes.evaluate.pose_error import compare_poses
from dvrk_cmaes.frames.frame import read_frame
from dvrk_cmaes.frames.session_folder import Session, read_session
from dvrk_cmaes.geometry import exp_rotation, transform
from dvrk_cmaes.results.result import Result
from dvrk_cmaes.runs.rig_check import rig_doubts
from dvrk_cmaes.silhouette import Body
from dvrk_cmaes.silhouette.prepare import prepare

LEFT: Final = "left eye"
RIGHT: Final = "right eye"
BOTH: Final = "both eyes"
OFF: Final = "both, rig off"
_BASELINE_OFF: Final = 0.02
_ROTATION_OFF_DEG: Final = 0.3


@dataclass(frozen=True)
class Found:
    """One estimate: errors of tips, mm, and axis, deg, what the result says of itself, and seconds of CPU."""

    session: str
    kind: str
    tip_mm: float
    axis_deg: float
    right_mode: bool
    probability: float
    within: bool
    disagree: bool
    tips: tuple[tuple[float, ...], ...]
    seconds: float
    result: Result


def rig_report(
    folders: Sequence[str], instrument: str, config: EstimateConfig, *, frames: int | None, use_joints: bool
) -> dict[str, list[dict[str, Any]]]:
    """Estimate the frames of stereo sessions and return tables of what one eye, both, and a wrong rig bring.

    Raises
    ------
    InputError
        A session has one view, or a frame no truth.
    """
    _use_one_thread()
    body, single = prepare(instrument), replace(config, threads=1)
    found: list[Found] = []
    for number, folder in enumerate(folders):
        session = read_session(folder, known=body.instrument.joint_names)
        found += _session(session, number, body, single, frames, use_joints)
    if not use_joints:
        return {
            "estimates": [_summary(kind, _of(found, kind)) for kind in (LEFT, BOTH)],
            "both eyes against one": [_against(LEFT, _of(found, LEFT), _of(found, BOTH))],
            "stated mode probability": [_probability(kind, _of(found, kind)) for kind in (LEFT, BOTH)],
        }
    return {
        "estimates": [_summary(kind, _of(found, kind)) for kind in (LEFT, RIGHT, BOTH, OFF)],
        "both eyes against one": [_against(eye, _of(found, eye), _of(found, BOTH)) for eye in (LEFT, RIGHT)],
        "stated mode probability": [_probability(kind, _of(found, kind)) for kind in (LEFT, RIGHT, BOTH)],
        "wrong rigs": list(_wrong_rigs(found)),
    }


def _use_one_thread() -> None:
    """Keep the libraries from using several cores, whose time would count as the process's."""
    import cv2

    cv2.setNumThreads(1)
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ[name] = "1"


def wrong_rig(rig: Rig, number: int) -> Rig:
    """Return a stereo rig with a baseline that is 2 % and a rotation that is 0.3 deg off; ``number`` is the seed."""
    rng = np.random.default_rng(number)
    axis = rng.standard_normal(3)
    pose = rig.views[1].view_from_camera.copy()
    pose[:3, 3] *= 1 + _BASELINE_OFF * rng.choice([-1, 1])
    turn = exp_rotation(np.deg2rad(_ROTATION_OFF_DEG) * axis / np.linalg.norm(axis))
    return Rig.stereo(rig.camera, rig.views[1].camera, transform(turn, np.zeros(3)) @ pose)


def _session(
    session: Session, number: int, body: Body, config: EstimateConfig, frames: int | None, use_joints: bool
) -> Iterator[Found]:
    """Yield the estimates of the frames of a session."""
    if len(session.rig.views) == 1:
        raise InputError(f"{session.folder}: expected a stereo session (masks/left, masks/right), got one view")
    name = session.folder.resolve().name
    files = session.frames[:frames]
    for count, one in enumerate(files, start=1):
        truth = session.truth.frames.get(one.name)
        if truth is None:
            raise InputError(f"{session.folder / 'golden.json'}: expected the truth of frame {one.name}, got none")
        masks = {view.name: view.mask for view in read_frame(one, session.rig).views}
        off = wrong_rig(session.rig, number)
        for kind, given, rig in (
            (LEFT, {"left": masks["left"]}, session.rig),
            (RIGHT, {"right": masks["right"]}, session.rig),
            (BOTH, masks, session.rig),
            (OFF, masks, off),
        ):
            if not use_joints and kind in (RIGHT, OFF):
                continue
            started = time.process_time()
            result = estimate(given, rig, one.readings if use_joints else {}, body, frame=one.name, config=config)
            seconds = time.process_time() - started
            yield _found(body, name, kind, result, (truth.camera_from_root, truth.joints), seconds)
        print_progress(name, count, len(files))


def _found(
    body: Body, session: str, kind: str, result: Result, truth: tuple[Any, Mapping[str, float]], seconds: float
) -> Found:
    """Compare a result with the truth."""
    assert result.camera_from_root is not None
    assert result.expected_error is not None
    error = compare_poses(body.instrument, (result.camera_from_root, result.joints), truth)
    assert error.tip_mm is not None
    return Found(
        session=session,
        kind=kind,
        tip_mm=error.tip_mm,
        axis_deg=error.shaft_deg,
        right_mode=error.rotation_deg < RIGHT_MODE_DEG,
        probability=result.mode_probability or 0.0,
        within=error.tip_mm <= result.expected_error.tip_90_mm,
        disagree=any(reason.startswith("views disagree") for reason in result.reasons),
        tips=tuple(tuple(tip.tolist()) for tip in result.tips),
        seconds=seconds,
        result=result,
    )


def _of(found: Sequence[Found], kind: str) -> list[Found]:
    return [one for one in found if one.kind == kind]


def _summary(kind: str, found: Sequence[Found]) -> dict[str, Any]:
    """Return shares and percentiles (50, 90, 100) of the errors of estimates of one kind."""
    return {
        "estimated from": kind,
        "frames": len(found),
        "right mode": sum(one.right_mode for one in found),
        "tip_mm": [round(float(np.percentile([one.tip_mm for one in found], p)), 3) for p in (50, 90, 100)],
        "axis_deg": [round(float(np.percentile([one.axis_deg for one in found], p)), 3) for p in (50, 90, 100)],
        "within 90 %": round(float(np.mean([one.within for one in found])), 3),
        "views disagree": sum(one.disagree for one in found),
        "cpu seconds": round(float(np.median([one.seconds for one in found])), 3),
    }


def _against(eye: str, one: Sequence[Found], both: Sequence[Found]) -> dict[str, Any]:
    """Return the ratios of errors and CPU time of both eyes to those of one."""
    median, mean = (
        of([each.tip_mm for each in both]) / of([each.tip_mm for each in one]) for of in (np.median, np.mean)
    )
    cost = [b.seconds / a.seconds for a, b in zip(one, both, strict=True)]
    ratios = {"tips median": median, "tips mean": mean, "cpu time": float(np.median(cost))}
    return {"against": eye, **{name: round(float(ratio), 3) for name, ratio in ratios.items()}}


def _probability(kind: str, found: Sequence[Found]) -> dict[str, Any]:
    """Return the mean stated probability of the mode beside the share that is right, in all and in sure results."""
    sure = [one for one in found if one.probability >= 0.8]
    return {
        "estimated from": kind,
        "stated": round(float(np.mean([one.probability for one in found])), 3),
        "right": round(float(np.mean([one.right_mode for one in found])), 3),
        "sure (0.8 or more)": len(sure),
        "stated of sure": round(float(np.mean([one.probability for one in sure])), 3) if sure else None,
        "right of sure": round(float(np.mean([one.right_mode for one in sure])), 3) if sure else None,
    }


def _named(found: Sequence[Found], kind: str) -> str:
    """Say whether the frames together, as a batch compares them, name the rig."""
    return "yes" if rig_doubts([one.result for one in _of(found, kind)]) else "no"


def _wrong_rigs(found: Sequence[Found]) -> Iterator[dict[str, Any]]:
    """Yield for each session in how many frames a right and a wrong rig are named, and what the wrong one moves."""
    for session in dict.fromkeys(one.session for one in found):
        own = [one for one in found if one.session == session]
        pairs = list(zip(_of(own, BOTH), _of(own, OFF), strict=True))
        moved = [1e3 * float(np.linalg.norm(np.mean(a.tips, axis=0) - np.mean(b.tips, axis=0))) for a, b in pairs]
        yield {
            "session": session,
            "frames": len(pairs),
            "right rig named": sum(a.disagree for a, _ in pairs),
            "wrong rig named": sum(b.disagree for _, b in pairs),
            "named by all frames": f"right {_named(own, BOTH)}, wrong {_named(own, OFF)}",
            "tips moved, median mm": round(float(np.median(moved)), 3),
        }
