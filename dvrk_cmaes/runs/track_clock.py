"""Times of a session's images and readings, in the order in which a tracker gets them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from dvrk_cmaes.frames.frame import FrameFiles
from dvrk_cmaes.frames.session_folder import Session
from dvrk_cmaes.geometry import Float64
from dvrk_cmaes.instrument.arm import OUTER_JOINTS
from dvrk_cmaes.joints.gaps import unbroken
from dvrk_cmaes.joints.interpolation import NANOSECONDS, TimedReadings, straight_line
from dvrk_cmaes.joints.lag import Unit
from dvrk_cmaes.joints.series import ReadingSeries

FRAMES_A_SECOND: Final = 30.0
"""Images a second of a session whose images have no times."""


@dataclass(frozen=True, eq=False)
class TrackClock:
    """Times of images and readings in seconds.

    times : of the images, by frame. unit : of the times in the session; where images are only counted, their times
    follow from the number of images a second. interval : s, between consecutive images. readings : with their times,
    in order.
    """

    times: Mapping[str, float]
    unit: Unit
    interval: float
    readings: tuple[tuple[float, dict[str, float]], ...]

    @property
    def outer_read(self) -> bool:
        """Whether each of the outer joints has a reading."""
        return set(OUTER_JOINTS) <= {name for _, row in self.readings for name in row}

    def readings_at(self, times: Float64, gap: float) -> dict[str, Float64]:
        """Interpolate the readings of each joint at times (F,), s; NaN before the first, after the last and in gaps.

        ``gap`` s is the longest time between two readings without a gap between them.
        """
        found = {}
        for joint in sorted({name for _, row in self.readings for name in row}):
            known = [(stamp, row[joint]) for stamp, row in self.readings if joint in row]
            stamps, values = np.array(known, dtype=np.float64).T
            series = TimedReadings((joint,), stamps, values[:, None])
            found[joint] = series.at(times, unbroken(gap), straight_line)[:, 0]
        return found

    @staticmethod
    def of(
        session: Session, frames: Sequence[FrameFiles], frames_a_second: float, *, use_joints: bool = True
    ) -> TrackClock:
        """Find the times of frames and readings: the session's own, or else from the order of its frames."""
        series = series_of(session)
        if series is None:
            return TrackClock({files.name: 0.0 for files in frames}, "frames", 1 / frames_a_second, ())
        factor = 1.0 if series.unit == "s" else 1 / frames_a_second
        rows: dict[float, dict[str, float]] = {}
        for name, stamps in series.times.items() if use_joints else ():
            for stamp, value in zip(stamps.tolist(), series.values[name].tolist(), strict=True):
                rows.setdefault(stamp, {})[name] = value
        return TrackClock(
            {files.name: series.frames[files.name] * factor for files in frames},
            series.unit,
            series.interval * factor,
            tuple((stamp * factor, rows[stamp]) for stamp in sorted(rows)),
        )


def series_of(session: Session) -> ReadingSeries | None:
    """Return all readings of a session with the times of all its frames; None for a single frame without a clock."""
    series = session.reading_series()
    names = [files.name for files in session.frames]
    if series is not None and all(name in series.frames for name in names):
        return series
    given = session.image_times
    times = {name: None if (time := given.get(name)) is None else time / NANOSECONDS for name in names}
    return ReadingSeries.of_frames({files.name: files.readings for files in session.frames}, times)
