"""Mistakes of users in whole sessions: of the camera file, the masks, the readings or the instrument.

Each is made alike in every frame. What counts is whether a frame is ok although its tips are far off, by itself and in
a session that is calibrated, and whether a remark or a doubt says what may be wrong.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any, Final

import cv2
import numpy as np

from dvrk_cmaes.camera.critical import remarks_on
from dvrk_cmaes.instrument import Instrument
from dvrk_cmaes.results.result import Result
from dvrk_cmaes.silhouette import Body, Renderer
from measure.accuracy.errors import error_of
from measure.cases import Case, Run, grouped

FAR_MM: Final = 3.0
"""Error of the tips, mm, beyond which an ok frame is wrong."""

OTHER_MESHES: Final = "another LND's meshes"
_CROPPED: Final = 0.75  # of width and height, the upper left corner
_WIDER: Final = 3  # px on each side

Mistake = Callable[[Case], Case]


def _with_file(
    case: Case,
    *,
    fx: float | None = None,
    fy: float | None = None,
    cx: float | None = None,
    cy: float | None = None,
) -> Case:
    """Return a case with other values in its camera file, which is read as critically as any."""
    camera = case.camera
    camera = replace(camera, fx=fx or camera.fx, fy=fy or camera.fy, cx=cx or camera.cx, cy=cy or camera.cy)
    read = remarks_on(camera.width, camera.height, camera.fx, camera.fy, camera.cx, camera.cy)
    return case.with_camera(replace(camera, remarks=read))


def _exchanged(case: Case) -> Case:
    return _with_file(case, cx=case.camera.cy, cy=case.camera.cx)


def _of_half_size(case: Case) -> Case:
    half = case.camera.scaled(case.camera.width // 2, case.camera.height // 2)
    return _with_file(case, fx=half.fx, fy=half.fy, cx=half.cx, cy=half.cy)


def _off_centre(case: Case) -> Case:
    return _with_file(case, cx=case.camera.cx + 50)


def _apart(case: Case) -> Case:
    return _with_file(case, fy=1.15 * case.camera.fy)


def _longer(case: Case) -> Case:
    return _with_file(case, fx=1.1 * case.camera.fx, fy=1.1 * case.camera.fy)


def _corner(case: Case) -> Case:
    height, width = case.mask.shape
    part = case.mask[: round(_CROPPED * height), : round(_CROPPED * width)].astype(np.float32)
    return case.with_mask(cv2.resize(part, (width, height), interpolation=cv2.INTER_LINEAR) > 0.5)


def _wider(case: Case) -> Case:
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * _WIDER + 1,) * 2)
    return case.with_mask(cv2.dilate(case.mask.astype(np.uint8), disc) > 0)


def _with_wrist(case: Case, pitch: str, yaw: str, sign: float) -> Case:
    wrist = {"wrist_pitch": sign * case.readings[pitch], "wrist_yaw": sign * case.readings[yaw]}
    return replace(case, readings={**case.readings, **wrist})


def _drawn_by(body: Body, case: Case) -> Case:
    at = case.true(body.instrument)
    return case.with_mask(Renderer(body, case.camera, threads=1).masks(at.pose[None], at.joints[None])[0])


MISTAKES: Final[Mapping[str, Mistake]] = {
    "cx and cy exchanged": _exchanged,
    "camera file of half the size": _of_half_size,
    "corner cropped, resized back": _corner,
    "centre 50 px off": _off_centre,
    "fx and fy 15 % apart": _apart,
    "focal length 10 % long": _longer,
    "mask 3 px wide": _wider,
    "both wrist signs wrong": partial(_with_wrist, pitch="wrist_pitch", yaw="wrist_yaw", sign=-1.0),
    "wrist columns exchanged": partial(_with_wrist, pitch="wrist_yaw", yaw="wrist_pitch", sign=1.0),
}


def mistaken_cases(cases: Sequence[Case], other: Body | None) -> list[Case]:
    """Return the cases with each mistake; without ``other``, another make of the instrument, no mask is drawn by it."""
    kinds: dict[str, Mistake] = {**MISTAKES, **({} if other is None else {OTHER_MESHES: partial(_drawn_by, other)})}
    return [replace(make(case), kind=kind) for kind, make in kinds.items() for case in cases if case.truth is not None]


def mistake_row(instrument: Instrument, kind: str, pairs: Iterable[tuple[Result, Case]]) -> dict[str, Any]:
    """Return how many frames with a mistake are ok, ok and far off, and have a remark or a doubt about the session."""
    found = [(result, error_of(instrument, result, case.truth)) for result, case in pairs]
    tips = [(result.status == "ok", error.tip_mm) for result, error in found if error is not None]
    far = [ok and mm is not None and mm > FAR_MM for ok, mm in tips]
    known = [mm for _, mm in tips if mm is not None]
    said = [bool(one.remarks) or any(text.startswith("session: ") for text in one.reasons) for one, _ in found]
    return {
        "kind": kind,
        "frames": len(found),
        "ok": sum(result.status == "ok" for result, _ in found),
        "ok_beyond_3_mm": sum(far),
        "tip_mm": float(np.median(known)) if known else None,
        "remarked": sum(said),
    }


def mistake_report(instrument: Instrument, runs: Sequence[Run]) -> list[dict[str, Any]]:
    """Return the rows of frames that were estimated by themselves, by kind."""
    groups = grouped(runs, lambda run: run.case.kind)
    return [mistake_row(instrument, kind, [(run.result, run.case) for run in own]) for kind, own in groups.items()]
