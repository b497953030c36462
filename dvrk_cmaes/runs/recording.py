"""Every frame of a recording, given the calibration of its keyframes: fitted, smoothed over time, and judged."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Final

import numpy as np

from dvrk_cmaes.calibration.document import SessionCalibration
from dvrk_cmaes.calibration.model import outer_readings
from dvrk_cmaes.calibration.prediction import Prediction, endoscope_in
from dvrk_cmaes.calibration.session_problem import ArmSetup
from dvrk_cmaes.camera import Rig
from dvrk_cmaes.errors import InputError
from dvrk_cmaes.frames.frame import FrameData, FrameFiles, read_frame
from dvrk_cmaes.frames.session_folder import Session
from dvrk_cmaes.geometry import Bool, Float64
from dvrk_cmaes.instrument.arm import OUTER_JOINTS
from dvrk_cmaes.joints.interpolation import NANOSECONDS, Sparseness
from dvrk_cmaes.joints.lag import Lag
from dvrk_cmaes.joints.names import ECM_JOINTS
from dvrk_cmaes.joints.series import ReadingSeries
from dvrk_cmaes.pose.doubts import pose_lost, readings_frozen, readings_missing, readings_too_sparse, reasons
from dvrk_cmaes.pose.terms.tips_term import Expected
from dvrk_cmaes.results.tracked import TrackResult
from dvrk_cmaes.track.frame_fits import PredictedFrame, StoredFit, fit_block
from dvrk_cmaes.track.image_masks import Colours
from dvrk_cmaes.track.keyframes import MOST_KEYFRAMES, NOTHING, MaskShape, choose_keyframes, well_in_view
from dvrk_cmaes.track.reading_buffer import frozen_frames, frozen_since
from dvrk_cmaes.track.window import Judged, Window, judge_frame

BLOCK: Final = 10
"""Consecutive frames that are fitted one after the other by one process."""


@dataclass(frozen=True, eq=False)
class RecordedFrames:
    """The N frames of a recording that are followed: files, cameras, and all readings, with the times of all frames.

    ``seconds`` is the unit of these times, s: where images are only counted, it follows from their number a second.
    ``shapes`` (N) are those of the masks that were measured.
    """

    files: tuple[FrameFiles, ...]
    rig: Rig
    series: ReadingSeries
    seconds: float = 1.0
    shapes: tuple[MaskShape, ...] = ()

    @classmethod
    def of(cls, session: Session, rate: float = 1.0, every: int = 1) -> RecordedFrames:
        """Return every N-th frame of a session; without a clock, they are counted, ``rate`` a second."""
        names, given = [files.name for files in session.frames], session.image_times
        series = session.reading_series()
        if series is None or any(name not in series.frames for name in names):
            times = {name: None if (time := given.get(name)) is None else time / NANOSECONDS for name in names}
            series = ReadingSeries.of_frames({files.name: files.readings for files in session.frames}, times)
            series = series or ReadingSeries("frames", {}, {}, dict.fromkeys(names, 0.0), 1.0)
        return cls(session.frames[::every], session.rig, series, 1.0 if series.unit == "s" else 1 / rate)

    @cached_property
    def times(self) -> Float64:
        """Times (N,) of the frames, s."""
        return np.array([self.series.frames[own.name] for own in self.files]) * self.seconds

    def with_own_masks(self) -> RecordedFrames:
        """Return the frames with the shapes of their masks; InputError names a file that is wrong."""
        return self.measured((i, read_seen(own, self.rig, images=False)) for i, own in enumerate(self.files))

    def measured(self, frames: Iterable[tuple[int, FrameData | None]]) -> RecordedFrames:
        """Return the frames with the shapes of masks, of frames that are given with their numbers."""
        found = {i: MaskShape.of(data.mask) for i, data in frames if data is not None}
        return replace(self, shapes=tuple(found.get(i, NOTHING) for i in range(len(self.files))))

    @cached_property
    def outer(self) -> Float64:
        """The readings (N, 4) of the outer joints, rad and m; NaN without one."""
        return outer_readings([own.readings for own in self.files])

    @cached_property
    def frozen(self) -> Bool:
        """At which frames (N,) the outer joints' readings stand still while the mask moves."""
        centres = np.array([shape.centre for shape in self.shapes or [NOTHING] * len(self.files)])
        return frozen_frames(self.outer, centres, self.rig.views[0].camera.width)

    @property
    def trusted(self) -> Bool:
        """Which frames (N,) have readings of all outer joints that are not frozen."""
        return np.asarray(~np.isnan(self.outer).any(axis=1) & ~self.frozen)

    def keyframes(self, most: int = MOST_KEYFRAMES, usable: Bool | None = None) -> list[int]:
        """Choose at most some keyframes: with readings that are not frozen, far from each other.

        They are among those that are ``usable`` (N,), by default those whose masks show enough of the instrument.
        """
        usable = well_in_view(self.shapes) if usable is None else usable
        names = tuple(dict.fromkeys(name for own in self.files for name in own.readings))
        return choose_keyframes(usable & self.trusted, self.times, names, self.readings(names, None), most)

    def readings(self, names: tuple[str, ...], lag: Lag | None) -> Float64:
        """Return the readings (N, K) of joints at the times of the images less a lag; NaN where there is none."""
        if lag is None:
            return np.array([[own.readings.get(name, np.nan) for name in names] for own in self.files])
        at = np.array([self.series.frames[own.name] for own in self.files]) - lag.in_unit(self.series.unit)
        return self.series.at(names, at)

    @property
    def interval(self) -> float:
        """Time between consecutive images of the recording, s."""
        return self.series.interval * self.seconds

    def readings_before(self, late: float) -> dict[str, Float64]:
        """Interpolate the readings (N,) of each joint some seconds before the images; NaN where they are not known."""
        at = (self.times - late) / self.seconds
        return {joint: self.series.at((joint,), at)[:, 0] for joint in sorted(self.series.times)}

    def lag(self, late: float, std: float) -> Lag:
        """Return a lag with its standard deviation, both in s, that is taken out of the readings."""
        unit, series = self.seconds, self.series
        return Lag.of(late / unit, std / unit, series.unit, series.interval, applied=True)

    def rows(self) -> Iterator[tuple[float, dict[str, float]]]:
        """Yield all readings with their times, s, in order."""
        rows: dict[float, dict[str, float]] = {}
        for name, stamps in self.series.times.items():
            for stamp, value in zip(stamps.tolist(), self.series.values[name].tolist(), strict=True):
                rows.setdefault(stamp * self.seconds, {})[name] = value
        yield from sorted(rows.items())


def read_seen(files: FrameFiles, rig: Rig, *, images: bool = True) -> FrameData | None:
    """Read a frame by its masks, where it has any, or else its images, if these count; None if it has neither.

    InputError for a file that is wrong.
    """
    files = files if images else files.changed(image=None, video=None)
    if files.problem is None and not (files.has_mask or files.has_image):
        return None
    return read_frame(files, rig, blank=True)


def predict(
    recorded: RecordedFrames, session: SessionCalibration, joint_names: tuple[str, ...]
) -> tuple[Prediction, list[Sparseness]]:
    """Predict all frames from their readings less the lag; also returns how far these may be off between others.

    A frame without readings is predicted by those nearest in time, with a wide standard deviation.
    """
    values = recorded.readings((*OUTER_JOINTS, *joint_names, *ECM_JOINTS), session.applied_lag)
    outer, joints, ecm = np.split(values, [len(OUTER_JOINTS), len(OUTER_JOINTS) + len(joint_names)], axis=1)
    has_outer = np.asarray(~np.isnan(outer).any(axis=1))
    times, names = [own.time for own in recorded.files], [own.name for own in recorded.files]
    endoscope = endoscope_in(session, times, names, ecm)
    if session.endoscope is not None and endoscope is None:
        raise InputError("recording: expected the readings by which the calibration places the endoscope, got none")
    known = np.flatnonzero(has_outer)
    nearest = known[np.abs(np.arange(len(has_outer))[:, None] - known).argmin(axis=1)]
    sparse = _sparseness(recorded, session.applied_lag)
    predicted = Prediction.of(
        session,
        outer[nearest],
        joints[nearest],
        joint_names,
        outer_read=has_outer,
        moving=~recorded.frozen,
        errors=np.array([one.error for one in sparse]),
        endoscope=endoscope,
    )
    return predicted, sparse


def _sparseness(recorded: RecordedFrames, lag: Lag | None) -> list[Sparseness]:
    """Return for each of N frames how far its readings may be off between those that were taken."""
    series = recorded.series
    stamps = series.times.get(OUTER_JOINTS[0], np.zeros(0))
    values = series.at(OUTER_JOINTS, stamps)
    read = ~np.isnan(values).any(axis=1)
    if series.unit != "s" or not read.any():
        return [Sparseness()] * len(recorded.files)
    late = 0.0 if lag is None else lag.in_unit("s")
    return [Sparseness.of(stamps[read], values[read], series.frames[own.name] - late) for own in recorded.files]


@dataclass(frozen=True, eq=False)
class RecordedSolution:
    """A recording's frames, their calibration, and how they are solved; with ``colours``, masks are found in images."""

    recorded: RecordedFrames
    calibration: SessionCalibration
    work: ArmSetup
    colours: Colours | None = None

    @cached_property
    def rig(self) -> Rig:
        """The cameras of the calibration."""
        return Rig(self.calibration.corrected_views(self.recorded.rig.views))

    def fits(self, predicted: Prediction) -> list[StoredFit | None]:
        """Fit every frame with the prediction as its prior."""
        read = partial(read_seen, rig=self.rig, images=self.colours is not None)
        information = np.linalg.inv(predicted.spread)
        expected = [Expected(predicted.at[i], own) for i, own in enumerate(information)]
        reads = [partial(read, own) for own in self.recorded.files]
        frames: list[PredictedFrame] = list(zip(reads, expected, strict=True))
        blocks = [tuple(frames[k : k + BLOCK]) for k in range(0, len(frames), BLOCK)]
        fit = partial(fit_block, margin=self.calibration.margin_px, colours=self.colours)
        return [fitted for block in self.work.run(fit, blocks) for fitted in block]


def follow_window(solution: RecordedSolution) -> list[TrackResult]:
    """Fit all frames, solve them as one window, judge their poses, and describe them, in order."""
    recorded, session, work = solution.recorded, solution.calibration, solution.work
    names = work.instrument.joint_names
    work.progress("fitting", len(recorded.files))
    source = "mask" if solution.colours is None else "image"
    predicted, sparse = predict(recorded, session, names)
    fits, window = solution.fits(predicted), Window(session, recorded.rig.views[0].camera, work.instrument, work.config)
    images = [
        window.image(float(time), predicted, i, None if one is None else one[1])
        for i, (time, one) in enumerate(zip(recorded.times, fits, strict=True))
    ]
    found = window.solve(images)
    shown = [
        (one[0], own, image.misfit, window.doubts(one[1], own, image, source))
        for one, own, image in zip(fits, found, images, strict=True)
        if one is not None
    ]
    of_shown = iter(work.run(partial(judge_frame, window=window, source=source), shown))
    nothing = Judged("lost", reasons(pose_lost(source, None)))
    frozen = frozen_since(recorded.frozen, [own.name for own in recorded.files])
    results = []
    for i, (one, image) in enumerate(zip(fits, images, strict=True)):
        judged = nothing if one is None else next(of_shown)
        missing = readings_missing(bool(predicted.outer_read[i]), still=False, source=source)
        doubts = [*judged.reasons, *reasons(missing, readings_too_sparse(sparse[i]), readings_frozen(frozen[i]))]
        seconds = 0.0 if one is None else one[1].seconds
        results.append(window.result(image, found[i], judged, doubts, seconds=seconds, remarks=recorded.rig.remarks))
    return results
