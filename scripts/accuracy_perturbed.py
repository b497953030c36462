"""Real images without masks: how often a tracker brings a moved pose back to the one that the image's mask yields.

The tracker has the colours of the other images of the session, learned at the poses that their masks yield. It starts
from a pose that is moved by 3 mm, turned by 5 deg, and bent by 10 deg in every joint, in random directions, and is then
shown the image for three steps.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.config import EstimateConfig
from dvrk_cmaes.estimation import estimate
from dvrk_cmaes.frames.frame import FrameData, FrameFiles, read_frame
from dvrk_cmaes.frames.session_folder import read_session
from dvrk_cmaes.geometry import moved
from dvrk_cmaes.results.result import Result
from dvrk_cmaes.results.tracked import TrackResult
from dvrk_cmaes.silhouette import Body
from dvrk_cmaes.silhouette.prepare import prepare
from dvrk_cmaes.track import Tracker

Float64 = NDArray[np.float64]

TRIALS: Final = 10  # of an image
STEPS: Final = 3
_MOVED: Final = 3e-3  # m
_TURNED, _BENT = np.deg2rad(5.0), np.deg2rad(10.0)
_BACK_MM, _BACK_DEG = 1.0, 5.0
_INTERVAL: Final = 1 / 30  # s


@dataclass(frozen=True, eq=False)
class _Shown:
    """An image with its frame and the result of its mask."""

    files: FrameFiles
    data: FrameData
    result: Result


def perturbed_report(
    folders: Sequence[str], instrument: str, config: EstimateConfig, *, frames: int | None
) -> dict[str, list[dict[str, Any]]]:
    """Return a row of figures for each session."""
    body = prepare(instrument)
    return {"moved poses, followed by images": [_session_row(Path(one), body, config, frames) for one in folders]}


def _session_row(folder: Path, body: Body, config: EstimateConfig, frames: int | None) -> dict[str, Any]:
    session = read_session(folder, known=body.instrument.joint_names)
    shown = []
    for files in session.frames:
        data = read_frame(files, session.camera)
        result = estimate(data.mask, data.camera, files.readings, body, ignore=data.ignore, config=config)
        if result.camera_from_root is not None and data.image is not None:
            shown.append(_Shown(files, data, result))
    errors = []
    for k, one in enumerate(shown[:frames]):
        rng = np.random.default_rng(k)
        others = shown[:k] + shown[k + 1 :]
        errors += [_errors(one, _followed(one, others, body, config, rng)) for _ in range(TRIALS)]
        print(f"{folder.name}: {k + 1} of {len(shown[:frames])} images", file=sys.stderr, flush=True)
    table = np.array(errors)
    back = (table[:, 0] < _BACK_MM) & (table[:, 2] < _BACK_DEG)
    medians = np.median(table, axis=0)
    return {
        "session": folder.name,
        "images": len(shown[:frames]),
        "trials": len(table),
        "back": float(back.mean()),
        "root, mm": float(medians[0]),
        "across the view, mm": float(medians[1]),
        "axis, deg": float(medians[2]),
        "ok": float(table[:, 3].mean()),
    }


def _followed(
    one: _Shown, others: Sequence[_Shown], body: Body, config: EstimateConfig, rng: np.random.Generator
) -> TrackResult:
    """Follow an image from a moved pose."""
    tracker, time = Tracker(one.data.camera, body, config=config, lag=0.0, evidence="images"), 0.0
    for other in others:
        time += _INTERVAL
        tracker.start(time, other.result, image=other.data.image)
    time += 1.0
    tracker.add_readings(time, one.files.readings)
    tracker.start(time, _moved(one.result, rng))
    for _ in range(STEPS):
        time += _INTERVAL
        tracker.add_readings(time, one.files.readings)
        result = tracker.step(time, image=one.data.image)
    return result


def _moved(result: Result, rng: np.random.Generator) -> Result:
    """Return a result with a moved pose, the standard deviations of that motion, and no alternatives."""
    assert result.camera_from_root is not None
    shift, turn = (
        size * v / np.linalg.norm(v) for size, v in ((_MOVED, rng.normal(size=3)), (_TURNED, rng.normal(size=3)))
    )
    bend = _BENT * rng.choice([-1.0, 1.0], len(result.joints))
    sizes = np.concatenate([np.full(3, _MOVED / 3**0.5), np.full(3, _TURNED / 3**0.5), np.full(len(bend), _BENT)])
    return replace(
        result,
        camera_from_root=moved(result.camera_from_root, np.concatenate([shift, turn])),
        joints={name: value + off for (name, value), off in zip(result.joints.items(), bend.tolist(), strict=True)},
        covariance=np.diag(sizes**2),
        alternatives=(),
    )


def _errors(one: _Shown, result: TrackResult) -> list[float]:
    """Return the root's distance from the mask's pose, mm, in all and across the view; the axis' angle, deg; and ok."""
    pose, found = one.result.camera_from_root, result.camera_from_root
    assert pose is not None
    assert found is not None
    off = 1e3 * (found[:3, 3] - pose[:3, 3])
    along = pose[:3, 3] / np.linalg.norm(pose[:3, 3])
    angle = np.degrees(np.arccos(np.clip(found[:3, 2] @ pose[:3, 2], -1.0, 1.0)))
    across = np.linalg.norm(off - (off @ along) * along)
    return [float(np.linalg.norm(off)), float(across), float(angle), float(result.status == "ok")]
