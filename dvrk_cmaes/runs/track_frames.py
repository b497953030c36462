"""Following an instrument through the frames of a session, without writing anything."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

from dvrk_cmaes.calibration.document import SessionCalibration
from dvrk_cmaes.camera import Camera
from dvrk_cmaes.config import EstimateConfig
from dvrk_cmaes.errors import InputError
from dvrk_cmaes.frames.frame import FrameFiles, read_frame, read_frame_image
from dvrk_cmaes.instrument.arm import Arm
from dvrk_cmaes.results.tracked import TrackResult
from dvrk_cmaes.runs.track_clock import FRAMES_A_SECOND, TrackClock
from dvrk_cmaes.silhouette import Body
from dvrk_cmaes.track import Tracker

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

    def tracker(self, camera: Camera, body: Body) -> Tracker:
        """Return a tracker with these settings."""
        return Tracker(camera, body, self.calibration, self.config, arm=self.arm, lag=self.lag)

    def recording_tracker(self, camera: Camera, body: Body, lag: float | None) -> Tracker:
        """Return a tracker whose results can be smoothed, with a given lag and a base that does not move."""
        track = replace(self.config.track, base_drift_mm=_FIXED, base_drift_deg=_FIXED)
        config = replace(self.config, track=track)
        given = self.lag if lag is None else lag
        return Tracker(camera, body, self.calibration, config, arm=self.arm, lag=given, record=True)


def followed(
    tracker: Tracker, frames: Sequence[FrameFiles], clock: TrackClock, camera: Camera, *, done: int = 0
) -> Iterator[tuple[FrameFiles, TrackResult]]:
    """Follow the frames after the first ``done`` ones; readings are given to the tracker when their time has come.

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
        yield files, tracker.step(time, data.mask, ignore=data.ignore)
