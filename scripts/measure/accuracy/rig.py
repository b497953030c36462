"""Both eyes of stereo sessions against one: errors, modes, cost, and rigs whose calibration is wrong.

Each frame is estimated from each eye alone, from both eyes, and from both with a rig whose baseline is 2 % off and
whose rotation 0.3 deg, in a direction that the session's place in the list determines. Without readings, only the modes
of the left eye and of both eyes are compared. The cost is the time of the process's CPU, so that other programs on the
machine count little.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any, Final

import numpy as np

from dvrk_cmaes.camera import Rig
from dvrk_cmaes.errors import InputError
from dvrk_cmaes.frames.frame import FrameData
from dvrk_cmaes.geometry import exp_rotation, transform
from dvrk_cmaes.runs.summary import rig_doubts
from measure.accuracy.errors import Compared, compared
from measure.accuracy.figures import percentiles
from measure.cases import Case, Measurement, grouped

LEFT: Final = "left eye"
RIGHT: Final = "right eye"
BOTH: Final = "both eyes"
OFF: Final = "both, rig off"
_BASELINE_OFF: Final = 0.02
_ROTATION_OFF_DEG: Final = 0.3


def rig_report(given: Measurement, *, use_joints: bool) -> dict[str, list[dict[str, Any]]]:
    """Estimate the frames of stereo sessions and return tables of what one eye, both, and a wrong rig bring.

    Raises
    ------
    InputError
        A session has one view, a frame no truth, or an estimate no pose.
    """
    for one in given.recordings():
        if len(one.session.rig.views) == 1:
            raise InputError(f"{one.session.folder}: expected a stereo session (masks/left, masks/right), got one view")
    sessions = grouped(given.cases(every_view=True), lambda case: case.session)
    kinds = (LEFT, RIGHT, BOTH, OFF) if use_joints else (LEFT, BOTH)
    cases = [
        eyes[kind] if use_joints else replace(eyes[kind], readings={})
        for number, own in enumerate(sessions.values())
        for eyes in (_by_eyes(case, number) for case in own)
        for kind in kinds
    ]
    runs = replace(given, keep=None).runs(cases)  # results that are kept have no times
    found = grouped(compared(given.instrument, runs), lambda one: one.run.case.kind)
    eyes = [kind for kind in kinds if kind in (LEFT, RIGHT)]
    report = {
        "estimates": [_summary(kind, found[kind]) for kind in kinds],
        "both eyes against one": [_against(eye, found[eye], found[BOTH]) for eye in eyes],
        "stated mode probability": [_probability(kind, found[kind]) for kind in (*eyes, BOTH)],
    }
    return report | ({"wrong rigs": list(_wrong_rigs(found[BOTH], found[OFF]))} if use_joints else {})


def wrong_rig(rig: Rig, number: int) -> Rig:
    """Return a stereo rig with a baseline that is 2 % and a rotation that is 0.3 deg off; ``number`` is the seed."""
    rng = np.random.default_rng(number)
    axis = rng.standard_normal(3)
    pose = rig.views[1].view_from_camera.copy()
    pose[:3, 3] *= 1 + _BASELINE_OFF * rng.choice([-1, 1])
    turn = exp_rotation(np.deg2rad(_ROTATION_OFF_DEG) * axis / np.linalg.norm(axis))
    return Rig.stereo(rig.camera, rig.views[1].camera, transform(turn, np.zeros(3)) @ pose)


def _by_eyes(case: Case, number: int) -> Mapping[str, Case]:
    """Return a stereo frame as each eye sees it, as both do, and with the wrong rig of the session's ``number``."""
    rig = case.recording.session.rig
    masks = {view.name: view.mask for view in case.data.views}
    seen = {
        LEFT: FrameData.of({"left": masks["left"]}, rig),
        RIGHT: FrameData.of({"right": masks["right"]}, rig),
        BOTH: FrameData.of(masks, rig),
        OFF: FrameData.of(masks, wrong_rig(rig, number)),
    }
    return {kind: replace(case, kind=kind, data=data) for kind, data in seen.items()}


def _disagree(one: Compared) -> bool:
    """Whether a result says that the views disagree."""
    return any(reason.startswith("views disagree") for reason in one.run.result.reasons)


def _within(one: Compared) -> bool:
    """Whether the error of the tips is within the stated 90 %."""
    assert one.run.result.expected_error is not None
    return one.tip_mm <= one.run.result.expected_error.tip_90_mm


def _summary(kind: str, found: Sequence[Compared]) -> dict[str, Any]:
    """Return shares and percentiles (50, 90, 100) of the errors of estimates of one kind."""
    return {
        "estimated from": kind,
        "frames": len(found),
        "right mode": sum(one.right_mode for one in found),
        "tip_mm": percentiles([one.tip_mm for one in found]),
        "axis_deg": percentiles([one.error.shaft_deg for one in found]),
        "within 90 %": round(float(np.mean([_within(one) for one in found])), 3),
        "views disagree": sum(_disagree(one) for one in found),
        "cpu seconds": round(float(np.median([one.run.cpu_seconds for one in found])), 3),
    }


def _against(eye: str, one: Sequence[Compared], both: Sequence[Compared]) -> dict[str, Any]:
    """Return the ratios of errors and CPU time of both eyes to those of one."""
    median, mean = (
        of([each.tip_mm for each in both]) / of([each.tip_mm for each in one]) for of in (np.median, np.mean)
    )
    cost = [b.run.cpu_seconds / a.run.cpu_seconds for a, b in zip(one, both, strict=True)]
    ratios = {"tips median": median, "tips mean": mean, "cpu time": float(np.median(cost))}
    return {"against": eye, **{name: round(float(ratio), 3) for name, ratio in ratios.items()}}


def _probability(kind: str, found: Sequence[Compared]) -> dict[str, Any]:
    """Return the mean stated probability of the mode beside the share that is right, in all and in sure results."""
    stated = [one.run.result.mode_probability or 0.0 for one in found]
    right = [one.right_mode for one in found]
    sure = [k for k, probability in enumerate(stated) if probability >= 0.8]
    return {
        "estimated from": kind,
        "stated": round(float(np.mean(stated)), 3),
        "right": round(float(np.mean(right)), 3),
        "sure (0.8 or more)": len(sure),
        "stated of sure": round(float(np.mean([stated[k] for k in sure])), 3) if sure else None,
        "right of sure": round(float(np.mean([right[k] for k in sure])), 3) if sure else None,
    }


def _wrong_rigs(right: Sequence[Compared], wrong: Sequence[Compared]) -> Iterator[dict[str, Any]]:
    """Yield for each session in how many frames a right and a wrong rig are named, and what the wrong one moves.

    All frames together, as a batch compares them, name a rig, too.
    """
    pairs = grouped(zip(right, wrong, strict=True), lambda pair: pair[0].run.case.session)
    for session, own in pairs.items():
        moved = [
            1e3 * np.linalg.norm(np.mean(a.run.result.tips, axis=0) - np.mean(b.run.result.tips, axis=0))
            for a, b in own
        ]
        named = ["yes" if rig_doubts([one.run.result for one in each]) else "no" for each in zip(*own, strict=True)]
        yield {
            "session": session,
            "frames": len(own),
            "right rig named": sum(_disagree(a) for a, _ in own),
            "wrong rig named": sum(_disagree(b) for _, b in own),
            "named by all frames": f"right {named[0]}, wrong {named[1]}",
            "tips moved, median mm": round(float(np.median(moved)), 3),
        }
