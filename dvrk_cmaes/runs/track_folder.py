"""Following an instrument through a session folder: tracks.jsonl, tracks.csv, session.json and an overlay video.

The state of the tracker is saved from time to time, so that a run that was interrupted goes on with the same results.
"""

from __future__ import annotations

import threading
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from dvrk_cmaes.calibration.document import SessionCalibration
from dvrk_cmaes.camera import Camera
from dvrk_cmaes.config import EstimateConfig
from dvrk_cmaes.errors import InputError
from dvrk_cmaes.frames.frame import FrameFiles, read_frame, read_frame_image
from dvrk_cmaes.frames.session_folder import Session
from dvrk_cmaes.instrument.arm import Arm
from dvrk_cmaes.io.atomic import not_written, write_json, write_text
from dvrk_cmaes.io.json_file import read_json_object
from dvrk_cmaes.results.folder import SESSION
from dvrk_cmaes.results.paths import check_writable
from dvrk_cmaes.results.track_files import TABLE, TRACKS, VIDEO, line_of, read_tracks, write_table
from dvrk_cmaes.results.tracked import TrackResult
from dvrk_cmaes.runs.digests import frame_digests
from dvrk_cmaes.runs.manifest import (
    Manifest,
    check_same_frames,
    check_same_settings,
    manifest_of,
    read_manifest,
    write_manifest,
)
from dvrk_cmaes.runs.output import locked
from dvrk_cmaes.runs.track_clock import FRAMES_A_SECOND, TrackClock
from dvrk_cmaes.runs.track_video import write_video
from dvrk_cmaes.runs.worker import BatchSetup
from dvrk_cmaes.silhouette import Body
from dvrk_cmaes.track import Tracker

CHECKPOINT: Final = "checkpoint.json"
_SAVED_EVERY: Final = 100  # frames
_SAME_TIME: Final = 1e-9  # s


@dataclass(frozen=True, eq=False)
class TrackSettings:
    """What is followed and how: as the options of ``dvrk-cmaes track``."""

    config: EstimateConfig
    arm: Arm = "classic"
    calibration: SessionCalibration | None = None
    lag: float | None = None
    every: int = 1
    use_joints: bool = True
    frames_a_second: float = FRAMES_A_SECOND


@dataclass(frozen=True, eq=False)
class TrackSummary:
    """Numbers of frames by status, whether the run was stopped before the end, and what was found."""

    counts: dict[str, int]
    interrupted: bool
    calibration: SessionCalibration | None


def track_folder(
    session: Session,
    out: Path,
    body: Body,
    settings: TrackSettings,
    *,
    resume: bool = True,
    video: bool = True,
    stop: threading.Event | None = None,
    progress: Callable[[int, int, TrackResult | None], None] = lambda done, total, result: None,
) -> TrackSummary:
    """Follow an instrument through the frames of a session, and write everything to a folder.

    Parameters
    ----------
    session, body, settings
        The session; the instrument; what is followed and how.
    out
        Folder of the results.
    resume
        Go on with the frames that an interrupted run left; if False, begin anew.
    video
        Whether to draw the overlay video.
    stop
        When set, the run ends after the frame it is at.
    progress
        Called after each frame with the number of frames done, that of all, and the frame's result; at the start, with
        the number of frames that are there already and None.

    Raises
    ------
    InputError
        A file of a frame is wrong, the folder cannot be written to, or it has results of other settings.
    DvrkCmaesError
        Another run is writing there.
    """
    frames = session.frames[:: settings.every]
    clock = TrackClock.of(session, frames, settings.frames_a_second, use_joints=settings.use_joints)
    check_writable(out)
    with locked(out):
        manifest = _manifest(session, frames, body, settings)
        old = read_manifest(out)
        if old is not None and resume:
            check_same_settings(out, old, manifest)
            names = list(manifest["frames"])
            check_same_frames(out, old, manifest["frames"], done=names, session=names)
        tracker = Tracker(
            session.camera, body, settings.calibration, settings.config, arm=settings.arm, lag=settings.lag
        )
        kept = _restored(out, tracker) if old is not None and resume else []
        (out / SESSION).unlink(missing_ok=True)
        write_manifest(out, manifest)
        rows = [*kept]
        progress(len(kept), len(frames), None)
        interrupted = False
        with _lines(out, kept) as append:
            for files, result in _followed(tracker, frames, clock, len(kept), session.camera):
                rows.append(result.to_dict(files.name, timed=clock.unit == "s"))
                append(rows[-1])
                progress(len(rows), len(frames), result)
                interrupted = stop is not None and stop.is_set()
                if interrupted or len(rows) % _SAVED_EVERY == 0 or len(rows) == len(frames):
                    write_json(out / CHECKPOINT, {"frames": len(rows), "state": tracker.checkpoint()})
                if interrupted:
                    break
        calibration = tracker.calibration(clock.interval, clock.unit)
        if calibration is not None:
            write_json(out / SESSION, calibration.to_dict())
        if not interrupted:
            write_table(out / TABLE, rows, body.instrument.joint_names)
            if video:
                rate = 1 / (clock.interval * settings.every)
                write_video(out / VIDEO, frames, rows, session.camera, body, frames_a_second=rate)
    counts = Counter(row["status"] for row in rows)
    return TrackSummary(dict(counts), interrupted, calibration)


def _manifest(session: Session, frames: Sequence[FrameFiles], body: Body, settings: TrackSettings) -> Manifest:
    """Return what the results depend on."""
    setup = BatchSetup(
        body.instrument,
        session.camera,
        settings.config,
        settings.arm,
        session.folder,
        calibration=settings.calibration,
    )
    followed = {
        "lag": settings.lag,
        "every": settings.every,
        "joints": settings.use_joints,
        "frames_a_second": settings.frames_a_second,
    }
    return manifest_of(setup, {files.name: frame_digests(files) for files in frames}) | {"track": followed}


def _restored(out: Path, tracker: Tracker) -> list[dict[str, Any]]:
    """Return the rows of an interrupted run that the saved state of its tracker belongs to, and restore that state."""
    path = out / CHECKPOINT
    if not path.exists() or not (out / TRACKS).exists():
        return []
    saved = read_json_object(path, expected="the state of a tracker (checkpoint.json)")
    rows = read_tracks(out / TRACKS)
    count = saved.get("frames")
    if not isinstance(count, int) or not isinstance(saved.get("state"), dict) or not 0 <= count <= len(rows):
        raise InputError(f"{path}: expected the state after a number of frames, got another: begin with --overwrite")
    tracker.restore(saved["state"])
    return rows[:count]


@contextmanager
def _lines(out: Path, kept: Sequence[dict[str, Any]]) -> Iterator[Callable[[dict[str, Any]], None]]:
    """Open tracks.jsonl with the rows that are kept, and give a function that appends one."""
    path = out / TRACKS
    write_text(path, "".join(line_of(row) for row in kept))
    try:
        with open(path, "a", encoding="utf-8") as file:

            def append(row: dict[str, Any]) -> None:
                file.write(line_of(row))
                file.flush()

            yield append
    except OSError as error:
        raise not_written(path, error, "results") from None


def _followed(
    tracker: Tracker, frames: Sequence[FrameFiles], clock: TrackClock, done: int, camera: Camera
) -> Iterator[tuple[FrameFiles, TrackResult]]:
    """Follow the frames after the first ``done`` ones; readings are given when their time has come."""
    fed = 0
    for number, files in enumerate(frames):
        time = clock.times[files.name]
        while fed < len(clock.readings) and clock.readings[fed][0] <= time + _SAME_TIME:
            tracker.add_readings(*clock.readings[fed])
            fed += 1
        if number < done:
            continue
        if files.mask is None:
            seen = read_frame_image(files, camera)
            yield files, tracker.step(time, image=seen.image, ignore=seen.ignore)
        else:
            data = read_frame(files, camera, blank=True)
            if (data.camera.width, data.camera.height) != (camera.width, camera.height):
                raise InputError(
                    f"{files.mask}: expected {camera.width} x {camera.height} pixels as the camera has, got "
                    f"{data.camera.width} x {data.camera.height}"
                )
            yield files, tracker.step(time, data.mask, ignore=data.ignore)
