"""Following an instrument through the frames of a session, without writing anything."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from dvrk_cmaes.calibration.document import SessionCalibration
from dvrk_cmaes.calibration.endoscope import Place
from dvrk_cmaes.camera import Camera, Rig
from dvrk_cmaes.config import EstimateConfig
from dvrk_cmaes.errors import InputError
from dvrk_cmaes.frames.frame import FrameFiles, frame_size, read_frame, read_frame_image
from dvrk_cmaes.frames.images import match_size
from dvrk_cmaes.frames.session_folder import Session
from dvrk_cmaes.geometry import Bool, Image
from dvrk_cmaes.instrument.arm import Arm
from dvrk_cmaes.pose.doubts import NO_READINGS
from dvrk_cmaes.results.tracked import TrackResult
from dvrk_cmaes.runs.track_clock import FRAMES_A_SECOND, TrackClock
from dvrk_cmaes.segment.segmentation import Hints
from dvrk_cmaes.silhouette import Body
from dvrk_cmaes.track import Tracker
from dvrk_cmaes.track.solution_schedule import SolutionSchedule
from dvrk_cmaes.track.view_segmenter import EvidenceKind

Mask = Bool

_SAME_TIME = 1e-9  # s


@dataclass(frozen=True, eq=False)
class TrackSettings:
    """What is followed and how: as the options of ``dvrk-cmaes track``.

    ``workers`` is the number of processes that fit a recording with its own calibration; by default that of the cores.
    ``outer_read`` is whether the recording has readings of the outer joints, which alone tell of a base.
    """

    config: EstimateConfig
    arm: Arm = "classic"
    calibration: SessionCalibration | None = None
    lag: float | None = None
    every: int = 1
    use_joints: bool = True
    frames_a_second: float = FRAMES_A_SECOND
    causal: bool = False
    evidence: EvidenceKind | None = None
    hints: Hints | None = None
    workers: int | None = None
    outer_read: bool = True

    @property
    def keeps_keyframes(self) -> bool:
        """Whether a tracker's keyframes are solved beside its steps: there are readings that tell of a base."""
        return self.use_joints and self.outer_read

    def tracker(self, rig: Rig, body: Body) -> Tracker:
        """Return a tracker with these settings."""
        return Tracker(
            rig,
            body,
            self.calibration,
            self.config,
            arm=self.arm,
            lag=self.lag,
            evidence=self.evidence,
            hints=self.hints,
        )


@dataclass(frozen=True, eq=False)
class TrackRun:
    """A run that follows an instrument through the frames of a session.

    Its inputs, of which ``frames`` are those that are followed, its folder, and where its progress goes: ``progress``
    is called with the frames done, all frames, and the last result, ``notice`` with lines. ``stop`` ends it soon.
    ``arm`` is the name of one of several arms, ``places`` are those at which another one found the endoscope.
    """

    session: Session
    out: Path
    body: Body
    settings: TrackSettings
    frames: tuple[FrameFiles, ...]
    clock: TrackClock
    stop: threading.Event | None
    progress: Callable[[int, int, TrackResult | None], None]
    notice: Callable[[str], None]
    arm: str = ""
    places: Sequence[Place] = ()

    @property
    def stopped(self) -> bool:
        """Whether the run is to end."""
        return self.stop is not None and self.stop.is_set()

    @property
    def frames_a_second(self) -> float:
        """Frames a second that are followed."""
        return 1 / (self.clock.interval * self.settings.every)

    def notice_stage(self, stage: str, frames: int) -> None:
        """Say at which stage the run is."""
        self.notice(f"{stage}: {frames} frames")

    def row(self, files: FrameFiles, result: TrackResult) -> dict[str, Any]:
        """Return the row of a frame in tracks.jsonl; without any readings, it says that nothing tells the mode."""
        if not self.clock.readings and self.body.instrument.has_twin and result.status == "doubtful":
            result = replace(result, reasons=(NO_READINGS, *result.reasons))
        return result.to_dict(files.name, timed=self.clock.unit == "s")


def used_session(session: Session, evidence: EvidenceKind | None) -> tuple[Session, EvidenceKind | None]:
    """Return a session with the masks and images that are used, and the evidence that a tracker is to use.

    Without ``evidence`` it is the masks of frames that have one, and the images of the others. Where no masks are used,
    the camera is that of the images' size.

    Raises
    ------
    InputError
        The session has no masks, or no images, where they are asked for; the images have another aspect than the
        camera's.
    """
    parts = [(files, *files.others.values()) for files in session.frames]
    with_mask = [any(part.mask is not None for part in of_frame) for of_frame in parts]
    masked, shown = any(with_mask), any(part.has_image for of_frame in parts for part in of_frame)
    if evidence == "masks" and not masked:
        raise InputError(f"{session.folder}: --evidence {evidence}: expected masks of the frames, got none")
    if evidence == "images" and not shown:
        raise InputError(f"{session.folder}: --evidence {evidence}: expected images or video.mp4, got neither")
    if evidence is None and all(with_mask):
        return session, "masks"
    if evidence == "images" or not masked:
        return _by_images(session), "images"
    return session, evidence


def with_increasing_times(session: Session) -> tuple[Session, tuple[str, ...]]:
    """Return a session without the frames that have the time of the frame before, and their names.

    Raises
    ------
    InputError
        Time goes back at a frame, or stands still at half of the frames; names the file and the first such frame.
    """
    times = [files.time for files in session.frames]
    timed = [(files.name, time) for files, time in zip(session.frames, times, strict=True) if time is not None]
    if len(timed) < len(times):
        return session, ()
    source = session.folder / "images.csv"
    where = source if source.exists() else next((file.path for file in session.joint_files), session.folder)
    count = "; a file without times has its frames counted (--fps)"
    for (before, earlier), (name, time) in pairwise(timed):
        if time < earlier:
            raise InputError(
                f"{where}: frame {name}: expected a later time than that of frame {before}, {earlier:.6f} s, got "
                f"{time:.6f} s (a clock that was set?): follow the frames before and after by themselves{count}"
            )
    doubled = tuple(name for (_, earlier), (name, time) in pairwise(timed) if time == earlier)
    if 2 * len(doubled) >= len(timed):
        raise InputError(
            f"{where}: frame {doubled[0]}: expected a later time than that of the frame before, got the same, as of "
            f"{len(doubled)} of {len(timed)} frames{count}"
        )
    return replace(session, frames=tuple(files for files in session.frames if files.name not in doubled)), doubled


def _by_images(session: Session) -> Session:
    """Return a session without its masks, with cameras of the images' size."""
    frames = tuple(files.changed(mask=None) for files in session.frames)
    notes, fitted = session.notes, {}
    for view in session.rig.views:
        there = (files_of_views(files, session.rig).get(view.name) for files in frames)
        first = next((own for own in there if own is not None), None)
        if first is not None:
            fitted[view.name], note = match_size(view.camera, frame_size(first)[::-1], "image")
            notes = notes if note is None else (*notes, note)
    return replace(session, frames=frames, rig=session.rig.with_cameras(fitted), notes=notes)


def with_first_mask(session: Session, mask: Path | None) -> Session:
    """Return a session whose first frame has a mask; as it is without one."""
    first, *rest = session.frames
    return session if mask is None else replace(session, frames=(replace(first, mask=mask), *rest))


def files_of_views(files: FrameFiles, rig: Rig) -> dict[str, FrameFiles]:
    """Return the files of a frame by view: of those that have a mask or an image, or of the first if none has."""
    there = {name: own for name, own in files.of_views(rig).items() if own.mask is not None or own.has_image}
    return there or {rig.names[0]: files}


def followed(
    tracker: Tracker,
    frames: Sequence[FrameFiles],
    clock: TrackClock,
    rig: Rig,
    *,
    with_images: bool = False,
    schedule: SolutionSchedule | None = None,
) -> Iterator[tuple[FrameFiles, TrackResult]]:
    """Follow the frames; readings are given to the tracker when their time has come.

    ``rig`` has the views of the frames; ``with_images`` tells to give the tracker the images of frames that have a
    mask, too. ``schedule`` has the tracker's keyframes solved beside the steps.

    Raises
    ------
    InputError
        A file of a frame is wrong, or a mask is not of the camera's size.
    """
    fed = 0
    for files in frames:
        time = clock.times[files.name]
        while fed < len(clock.readings) and clock.readings[fed][0] <= time + _SAME_TIME:
            tracker.add_readings(*clock.readings[fed])
            fed += 1
        if files.problem is not None:
            raise InputError(files.problem)
        masks, images, ignored = {}, {}, {}
        for name, of_view in files_of_views(files, rig).items():
            image, masks[name], ignored[name] = read_arrays(of_view, rig.view(name).camera)
            images[name] = image if with_images or of_view.mask is None else None
        if schedule is not None:
            schedule.before_step(time)
        result = tracker.step(time, masks, images, ignored)
        if schedule is not None:
            schedule.after_step(time)
        yield files, result


def read_arrays(files: FrameFiles, camera: Camera) -> tuple[Image | None, Mask | None, Mask | None]:
    """Read the image (H, W, 3), if there is one, the mask and the ignored pixels (H, W) of a view of a frame.

    Raises
    ------
    InputError
        A file is wrong, or the mask is not of the camera's size.
    """
    if files.mask is None:
        seen = read_frame_image(files, camera)
        return seen.image, None, seen.ignore
    data = read_frame(files, camera, blank=True)
    if (data.camera.width, data.camera.height) != (camera.width, camera.height):
        raise InputError(
            f"{files.mask}: expected {camera.width} x {camera.height} pixels as the camera has, got "
            f"{data.camera.width} x {data.camera.height}"
        )
    return None if data.image is None else _fitted(data.image, camera), data.mask, data.ignore


def _fitted(image: Image, camera: Camera) -> Image:
    """Return an image (H, W, 3) in the size of the camera's images."""
    size = (camera.width, camera.height)
    if image.shape[1::-1] == size:
        return image
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)
