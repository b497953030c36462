"""Following an instrument through the frames of a session, without writing anything."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.calibration.document import SessionCalibration
from dvrk_cmaes.camera import Camera
from dvrk_cmaes.config import EstimateConfig
from dvrk_cmaes.errors import InputError
from dvrk_cmaes.frames.frame import FrameFiles, frame_size, read_frame, read_frame_image
from dvrk_cmaes.frames.images import match_size
from dvrk_cmaes.frames.session_folder import Session
from dvrk_cmaes.instrument.arm import Arm
from dvrk_cmaes.results.tracked import TrackResult
from dvrk_cmaes.runs.track_clock import FRAMES_A_SECOND, TrackClock
from dvrk_cmaes.segment.segmentation import Hints
from dvrk_cmaes.silhouette import Body
from dvrk_cmaes.track import Tracker
from dvrk_cmaes.track.sight import EvidenceKind

_SAME_TIME = 1e-9  # s
_FIXED = 1e-9  # mm and deg, drift in a second of a base that does not move


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
    smooth: bool = False
    evidence: EvidenceKind | None = None
    hints: Hints | None = None

    def tracker(self, camera: Camera, body: Body) -> Tracker:
        """Return a tracker with these settings."""
        return self._tracker(camera, body, self.config, self.lag, record=False)

    def recording_tracker(self, camera: Camera, body: Body, lag: float | None) -> Tracker:
        """Return a tracker whose results can be smoothed, with a given lag and a base that does not move."""
        track = replace(self.config.track, base_drift_mm=_FIXED, base_drift_deg=_FIXED)
        config = replace(self.config, track=track)
        given = self.lag if lag is None else lag
        return self._tracker(camera, body, config, given, record=True)

    def _tracker(
        self, camera: Camera, body: Body, config: EstimateConfig, lag: float | None, *, record: bool
    ) -> Tracker:
        return Tracker(
            camera,
            body,
            self.calibration,
            config,
            arm=self.arm,
            lag=lag,
            evidence=self.evidence,
            hints=self.hints,
            record=record,
        )


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
    frames = session.frames
    masked, shown = (any(there) for there in zip(*((one.mask, one.has_image) for one in frames), strict=True))
    if evidence in ("masks", "both") and not masked:
        raise InputError(f"{session.folder}: --evidence {evidence}: expected masks of the frames, got none")
    if evidence in ("images", "both") and not shown:
        raise InputError(f"{session.folder}: --evidence {evidence}: expected images or video.mp4, got neither")
    if evidence is None and all(one.mask is not None for one in frames):
        return session, "masks"
    if evidence == "images" or not masked:
        frames = tuple(replace(one, mask=None) for one in frames)
        first = next(one for one in frames if one.has_image)
        camera, note = match_size(session.camera, frame_size(first)[::-1], "image")
        notes = session.notes if note is None else (*session.notes, note)
        return replace(session, frames=frames, camera=camera, notes=notes), "images"
    return session, evidence


def with_first_mask(session: Session, mask: Path | None) -> Session:
    """Return a session whose first frame has a mask; as it is without one."""
    first, *rest = session.frames
    return session if mask is None else replace(session, frames=(replace(first, mask=mask), *rest))


def followed(
    tracker: Tracker,
    frames: Sequence[FrameFiles],
    clock: TrackClock,
    camera: Camera,
    *,
    done: int = 0,
    with_images: bool = False,
) -> Iterator[tuple[FrameFiles, TrackResult]]:
    """Follow the frames after the first ``done`` ones; readings are given to the tracker when their time has come.

    ``with_images`` tells to give it the images of frames that have a mask, too.

    Raises
    ------
    InputError
        A file of a frame is wrong, or a mask is not of the camera's size.
    """
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
            continue
        data = read_frame(files, camera, blank=True)
        if (data.camera.width, data.camera.height) != (camera.width, camera.height):
            raise InputError(
                f"{files.mask}: expected {camera.width} x {camera.height} pixels as the camera has, got "
                f"{data.camera.width} x {data.camera.height}"
            )
        image = _fitted(data.image, camera) if with_images and data.image is not None else None
        yield files, tracker.step(time, data.mask, image, data.ignore)


def _fitted(image: NDArray[np.uint8], camera: Camera) -> NDArray[np.uint8]:
    """Return an image (H, W, 3) in the size of the camera's images."""
    size = (camera.width, camera.height)
    if image.shape[1::-1] == size:
        return image
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)
