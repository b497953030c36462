"""Errors of followed recordings: against the truth, or against the masks where there is none; of each arm.

Tips are compared in their order, and the mirror twin is never forgiven. Errors of tips are those of the frames in which
at least half of the jaws can be seen (``visible`` in golden.json); a frame without a pose counts as a metre off.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.frames.frame import FrameFiles, read_frame
from dvrk_cmaes.frames.session_video import SessionVideo, own_video
from dvrk_cmaes.geometry import rotation_angle
from dvrk_cmaes.instrument import Instrument
from dvrk_cmaes.results.tracked import TrackResult
from dvrk_cmaes.runs.track_clock import TrackClock
from dvrk_cmaes.runs.track_frames import TrackSettings, followed, used_session
from dvrk_cmaes.silhouette import Body, Renderer
from dvrk_cmaes.track import Tracker
from dvrk_cmaes.track.solution_schedule import SolutionSchedule
from measure.accuracy.figures import RIGHT_MODE_DEG, base_errors
from measure.cases import Measurement
from measure.recordings import Recording, read_recordings
from measure.solver import SolverHere

Float64 = NDArray[np.float64]

WRONG_MM: Final = 3.0  # error of the tips of a pose that should not be ok
_VISIBLE, _WELL_VISIBLE, _GONE = 0.5, 0.8, 0.1
_LEAST_GONE: Final = 5  # frames
_WITHOUT_POSE_MM: Final = 1000.0
_PROGRESS: Final = 50  # frames


@dataclass(frozen=True, eq=False)
class Followed:
    """A recording, the frames that were followed, their results, and the tracker after the last of them."""

    recording: Recording
    frames: tuple[FrameFiles, ...]
    results: list[TrackResult]
    tracker: Tracker


def recordings_to_follow(
    folder: str | Path, instrument: Instrument, settings: TrackSettings
) -> list[tuple[Recording, TrackSettings]]:
    """Read a session, or each of its arms, with the masks and images used, and settings that say which these are."""
    path = None if settings.evidence in (None, "masks") else own_video(Path(folder))
    found = []
    for one in read_recordings(folder, instrument, None if path is None else SessionVideo.open(path)):
        session, evidence = used_session(one.session, settings.evidence)
        found.append((replace(one, session=session), replace(settings, evidence=evidence)))
    return found


def follow(recording: Recording, body: Body, settings: TrackSettings, *, frames: int | None = None) -> Followed:
    """Follow the first ``frames`` frames of a recording, or all."""
    session = recording.session
    chosen = session.frames[:: settings.every][:frames]
    clock = TrackClock.of(session, chosen, settings.frames_a_second, use_joints=settings.use_joints)
    tracker, results = settings.tracker(session.rig, body), []
    schedule = SolutionSchedule(tracker, SolverHere(body)) if settings.keeps_keyframes and clock.outer_read else None
    shown = settings.evidence != "masks"
    for _, result in followed(tracker, chosen, clock, session.rig, with_images=shown, schedule=schedule):
        results.append(result)
        if len(results) % _PROGRESS == 0:
            print(f"{recording.name}: {len(results)} of {len(chosen)} frames", file=sys.stderr, flush=True)
    return Followed(recording, chosen, results, tracker)


def track_report(given: Measurement, **options: Any) -> dict[str, list[dict[str, Any]]]:
    """Follow recordings and return a row of figures for each; ``options`` are those of `TrackSettings`."""
    body, asked = given.body, TrackSettings(given.config, **options)
    with_truth, without = [], []
    for folder in given.folders:
        for recording, settings in recordings_to_follow(folder, body.instrument, asked):
            done = follow(recording, body, settings, frames=given.frames)
            row: dict[str, Any] = {"session": recording.name, "frames": len(done.results), **_statuses(done.results)}
            if recording.golden.exists():
                golden = json.loads(recording.golden.read_text(encoding="utf-8"))
                with_truth.append(row | truth_figures(done, golden))
            else:
                without.append(row | mask_figures(done, body))
    titles = {"followed, against the truth": with_truth, "followed, against the masks": without}
    return {title: rows for title, rows in titles.items() if rows}


def _statuses(results: Sequence[TrackResult]) -> dict[str, Any]:
    """Return the number of frames of each status."""
    return {status: sum(result.status == status for result in results) for status in ("ok", "doubtful", "lost")}


def truth_figures(done: Followed, golden: Mapping[str, Any]) -> dict[str, Any]:
    """Return errors, wrong statuses, times to notice and to come back, and the base's error."""
    truths = [golden["frames"][files.name] for files in done.frames]
    visible = np.array([truth.get("visible", 1.0) for truth in truths])
    table = np.array([_errors(result, truth) for result, truth in zip(done.results, truths, strict=True)])
    errors, turned, bent = table.T
    ok = np.array([result.status == "ok" for result in done.results])
    seen, well = visible >= _VISIBLE, visible >= _WELL_VISIBLE
    median, most, worst = np.percentile(errors[seen], [50, 95, 100])
    wrong = seen & (turned > RIGHT_MODE_DEG)
    said, back = _gone_and_back(visible, ok, errors)
    figures = {
        "joints, deg": float(np.median(bent[seen])),
        "tips, mm": float(median),
        "95 %": float(most),
        "worst": float(worst),
        "ok, well visible": float(ok[well].mean()),
        "ok and wrong": int((ok & (errors > WRONG_MM)).sum()),
        "false alarms": int((~ok & well & (errors < 1)).sum()),
        "wrong mode": int(wrong.sum()),
        "switches": int((np.diff(wrong.astype(int)) != 0).sum()),
        "until said gone": said,
        "until back": back,
        "lag, ms": None if done.tracker.lag is None else 1e3 * done.tracker.lag.seconds,
    }
    base, true = done.tracker.camera_from_base, golden.get("camera_from_base")
    if base is not None and true is not None:
        figures["base, deg"], figures["base, mm"] = base_errors(base, np.array(true))
    return figures


def _errors(result: TrackResult, truth: Mapping[str, Any]) -> tuple[float, float, float]:
    """Return a pose's errors: mean distance of the tips, mm, the rotation, deg, and the mean of the joints, deg.

    Without a pose, it is a metre off and half a turn bent, and in no wrong mode.
    """
    if result.camera_from_root is None or result.tips is None:
        return _WITHOUT_POSE_MM, 0.0, 180.0
    tips = np.linalg.norm(result.tips - np.array(truth["tips_camera_m"]), axis=1)
    turned = rotation_angle(result.camera_from_root, np.array(truth["T_camera_roll_link"]))
    bent = [abs(value - truth["joints"][name]) for name, value in result.joints.items()]
    return 1e3 * float(tips.mean()), float(np.degrees(turned)), float(np.degrees(np.mean(bent)))


def _gone_and_back(visible: Float64, ok: NDArray[np.bool_], errors: Float64) -> tuple[str, str]:
    """Return the frames until a tool that left is not ok any more, and until one that came back is followed again."""
    gone = np.flatnonzero(visible < _GONE)
    runs = [run for run in np.split(gone, np.flatnonzero(np.diff(gone) > 1) + 1) if len(run) >= _LEAST_GONE]
    said, back = [], []
    for run in runs:
        said.append(next((k for k, i in enumerate(run) if not ok[i]), None))
        after = np.flatnonzero((np.arange(len(ok)) > run[-1]) & (visible >= _WELL_VISIBLE))
        back.append(next((k for k, i in enumerate(after) if ok[i] and errors[i] < WRONG_MM), None))
    text = [", ".join("never" if n is None else str(n) for n in numbers) or "-" for numbers in (said, back)]
    return text[0], text[1]


def mask_figures(done: Followed, body: Body) -> dict[str, Any]:
    """Return overlap with the masks, turns between frames, and the scatter of the joints."""
    renderer = Renderer(body, done.recording.session.camera, threads=1)
    overlaps, poses, joints = [], [], []
    for files, result in zip(done.frames, done.results, strict=True):
        if result.camera_from_root is None:
            overlaps.append(0.0)
            continue
        mask = read_frame(files, done.recording.session.camera, blank=True).mask
        values = np.array(list(result.joints.values()))
        drawn = renderer.masks(result.camera_from_root[None], values[None])[0]
        overlaps.append(float((drawn & mask).sum() / max((drawn | mask).sum(), 1)))
        poses.append(result.camera_from_root)
        joints.append(np.degrees(values))
    turns = np.degrees([float(rotation_angle(a, b)) for a, b in pairwise(poses)] or [0.0])
    scatter = np.std(joints, axis=0) if joints else np.zeros(0)
    return {
        "IoU, mean": float(np.mean(overlaps)),
        "IoU, least": float(np.min(overlaps)),
        "largest turn, deg": float(turns.max()),
        "joints' std, deg": ", ".join(f"{value:.2f}" for value in scatter),
        "lag, ms": None if done.tracker.lag is None else 1e3 * done.tracker.lag.seconds,
    }
