"""Every frame of a recording, given the calibration of its keyframes: fitted, smoothed over time, and judged."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any, Final

import numpy as np

from dvrk_cmaes.calibration.calibrate import SolvedSession
from dvrk_cmaes.calibration.document import SessionCalibration
from dvrk_cmaes.calibration.model import ecm_readings, outer_readings
from dvrk_cmaes.calibration.prediction import Prediction
from dvrk_cmaes.calibration.session_frame import Run
from dvrk_cmaes.calibration.session_problem import ArmSetup
from dvrk_cmaes.camera import Rig
from dvrk_cmaes.errors import InputError
from dvrk_cmaes.frames.frame import FrameData, FrameFiles, read_frame
from dvrk_cmaes.geometry import Bool, Float64, Indices
from dvrk_cmaes.instrument.arm import OUTER_JOINTS
from dvrk_cmaes.joints.interpolation import Sparseness
from dvrk_cmaes.joints.series import ReadingSeries
from dvrk_cmaes.pose.doubts import pose_lost, readings_frozen, readings_missing, readings_too_sparse, reasons
from dvrk_cmaes.pose.judge import far_joints
from dvrk_cmaes.pose.terms.tips_term import Expected
from dvrk_cmaes.results.tracked import TrackResult
from dvrk_cmaes.track.frame_fits import FittedFrame, PredictedFrame, fit_block
from dvrk_cmaes.track.image_masks import ColourModel
from dvrk_cmaes.track.keyframes import MOST_KEYFRAMES, MaskShape, choose_keyframes, well_in_view
from dvrk_cmaes.track.reading_buffer import frozen_frames, frozen_since
from dvrk_cmaes.track.window import Judged, Window, WindowImage, judge_frame

BLOCK: Final = 10
"""Consecutive frames that are fitted one after the other by one process."""

_CONTINUED: Final = 6  # frames beyond the first or last readings, as far as these are taken to go on


@dataclass(frozen=True, eq=False)
class RecordedFrames:
    """The frames of a recording that are followed, with what is measured once.

    ``shapes`` are those of the masks, ``times`` (N,) s, ``names`` the K joints that are read, ``readings`` (N, K), NaN
    without one; ``frozen`` (N,) tells where the outer joints' readings stand still while the mask moves. ``centres``
    (N, 2) are those of the masks, px, NaN without one.
    """

    files: tuple[FrameFiles, ...]
    rig: Rig
    series: ReadingSeries | None
    times: Float64
    shapes: list[MaskShape]
    names: tuple[str, ...]
    readings: Float64
    frozen: Bool
    centres: Float64

    @classmethod
    def of(
        cls, files: tuple[FrameFiles, ...], rig: Rig, series: ReadingSeries | None, times: Float64
    ) -> RecordedFrames:
        """Return frames of whose masks nothing is known."""
        names = tuple(dict.fromkeys(name for own in files for name in own.readings))
        readings = np.array([[own.readings.get(name, np.nan) for name in names] for own in files])
        shapes, still = [MaskShape(0.0, 1.0)] * len(files), np.zeros(len(files), np.bool_)
        return cls(files, rig, series, times, shapes, names, readings, still, np.full((len(files), 2), np.nan))

    def with_own_masks(self) -> RecordedFrames:
        """Return the frames with the shapes of their masks; InputError names a file that is wrong."""
        return self.measured((i, read_seen(own, self.rig, images=False)) for i, own in enumerate(self.files))

    def measured(self, frames: Iterable[tuple[int, FrameData | None]]) -> RecordedFrames:
        """Return the frames with the shapes of masks, of frames that are given with their numbers."""
        shapes, centres = [MaskShape(0.0, 1.0)] * len(self.files), np.full((len(self.files), 2), np.nan)
        for i, data in frames:
            if data is not None and data.mask.any():
                shapes[i], (rows, columns) = MaskShape.of(data.mask), np.nonzero(data.mask)
                centres[i] = columns.mean(), rows.mean()
        frozen = frozen_frames(self.outer, centres, self.rig.views[0].camera.width)
        return replace(self, shapes=shapes, frozen=frozen, centres=centres)

    @property
    def outer(self) -> Float64:
        """The readings (N, 4) of the outer joints, rad and m; NaN without one."""
        return outer_readings([own.readings for own in self.files])

    @property
    def trusted(self) -> Bool:
        """Which frames (N,) have readings of all outer joints that are not frozen."""
        return np.asarray(~np.isnan(self.outer).any(axis=1) & ~self.frozen)

    def keyframes(self, most: int = MOST_KEYFRAMES) -> list[int]:
        """Choose at most some keyframes: well in view, with readings that are not frozen, far from each other."""
        usable = well_in_view(self.shapes) & self.trusted
        return choose_keyframes(usable, self.times, self.names, self.readings, most)


def read_seen(files: FrameFiles, rig: Rig, *, images: bool = True) -> FrameData | None:
    """Read a frame by its masks, where it has any, or else its images, if these count; None if it has neither.

    InputError for a file that is wrong.
    """
    files = files if images else files.changed(image=None, video=None)
    if files.problem is None and not (files.has_mask or files.has_image):
        return None
    try:
        return read_frame(files, rig, blank=True)
    except InputError as error:
        if len(rig.views) > 1 and "mask is empty" in str(error):
            return None
        raise


def predict(
    recorded: RecordedFrames, session: SessionCalibration, joint_names: tuple[str, ...]
) -> tuple[Prediction, list[Sparseness]]:
    """Predict all frames from their readings less the lag; also returns how far these may be off between others.

    A frame without readings is predicted by those nearest in time, with a wide standard deviation; near the beginning
    and the end of the readings, by what they did there.
    """
    readings = _late_readings(recorded.files, recorded.series, session)
    outer = outer_readings(readings)
    joints = np.array([[own.get(name, np.nan) for name in joint_names] for own in readings])
    has_outer = np.asarray(~np.isnan(outer).any(axis=1))
    endoscope = None
    if session.endoscope is not None:
        read, times = ecm_readings(readings), [own.time for own in recorded.files]
        found = session.endoscope.in_frames(session.camera_from_base, read, times, [own.name for own in recorded.files])
        if isinstance(found, str):
            raise InputError(f"recording: {found}: expected the readings by which the calibration places the endoscope")
        endoscope = found
    known = np.flatnonzero(has_outer)
    nearest = known[np.abs(np.arange(len(has_outer))[:, None] - known).argmin(axis=1)]
    outer, joints = (_continued(values, recorded.times, has_outer, nearest) for values in (outer, joints))
    sparse = _sparseness(recorded, session)
    errors = np.array([one.error for one in sparse])
    moving = ~recorded.frozen
    predicted = Prediction.of(
        session, outer, joints, joint_names, outer_read=has_outer, moving=moving, errors=errors, endoscope=endoscope
    )
    return predicted, sparse


def _continued(values: Float64, times: Float64, has_outer: Bool, nearest: Indices) -> Float64:
    """Return the readings (N, K) at all frames: those of the nearest one that has any, or as they go on from there."""
    found = values[nearest]
    for i in np.flatnonzero(~has_outer):
        near = int(nearest[i])
        inner = near + (1 if near > i else -1)
        if abs(i - near) > _CONTINUED or not 0 <= inner < len(has_outer) or not has_outer[inner]:
            continue
        rate = (values[near] - values[inner]) / (times[near] - times[inner])
        found[i] += rate * (times[i] - times[near])
    return found


def _late_readings(
    files: Sequence[FrameFiles], series: ReadingSeries | None, session: SessionCalibration
) -> list[dict[str, float]]:
    """Return the readings of frames at the times of their images less the lag, if that was taken out."""
    lag = session.applied_lag
    if lag is None or series is None:
        return [dict(own.readings) for own in files]
    return [series.of_frame(own.name, lag) if own.name in series.frames else {} for own in files]


def _sparseness(recorded: RecordedFrames, session: SessionCalibration) -> list[Sparseness]:
    """Return for each of N frames how far its readings may be off between those that were taken."""
    series, lag = recorded.series, session.applied_lag
    stamps = None if series is None or series.unit != "s" else series.times.get(OUTER_JOINTS[0])
    if series is None or stamps is None or not set(OUTER_JOINTS) <= set(series.times):
        return [Sparseness.none()] * len(recorded.files)
    values, found = series.at(OUTER_JOINTS, stamps), []
    read = ~np.isnan(values).any(axis=1)
    for own in recorded.files:
        time = series.frames.get(own.name, np.nan)
        late = 0.0 if lag is None else lag.in_unit(series.unit)
        known = bool(read.any()) and not np.isnan(time)
        found.append(Sparseness.of(stamps[read], values[read], time - late) if known else Sparseness.none())
    return found


@dataclass(frozen=True, eq=False)
class RecordedSolution:
    """A recording's frames and their calibration; with ``colours`` by view, masks are found in the images."""

    recorded: RecordedFrames
    calibration: SessionCalibration
    colours: Mapping[str, ColourModel] | None = None

    @classmethod
    def of(cls, recorded: RecordedFrames, solved: SolvedSession) -> RecordedSolution:
        """Return a solution of keyframes in the digits of session.json, by which a recording can be followed again."""
        return cls(recorded, SessionCalibration.from_dict(solved.calibration.to_dict()))

    @cached_property
    def rig(self) -> Rig:
        """The cameras of the calibration; a task needs no more of the recording and its calibration."""
        return Rig(self.calibration.corrected_views(self.recorded.rig.views))

    def expected(self, predicted: Prediction, numbers: Iterable[int]) -> list[PredictedFrame]:
        """Return some frames with what is predicted of them."""
        information, files = np.linalg.inv(predicted.spread), self.recorded.files
        read, at = partial(read_seen, rig=self.rig, images=self.colours is not None), predicted.at
        return [(partial(read, files[i]), Expected(at[i], information[i])) for i in numbers]

    def fits(self, predicted: Prediction, run: Run[Any, Any]) -> list[FittedFrame | None]:
        """Fit every frame with the prediction as its prior."""
        count = len(self.recorded.files)
        frames, masks = self.expected(predicted, range(count)), self.calibration.masks
        blocks = [tuple(frames[k : k + BLOCK]) for k in range(0, count, BLOCK)]
        fit = partial(fit_block, masks=masks, colours=self.colours)
        return [fitted for block in run(fit, blocks) for fitted in block]


def follow_window(solution: RecordedSolution, work: ArmSetup) -> list[TrackResult]:
    """Fit all frames, solve them as one window, judge their poses, and describe them, in order."""
    recorded, session, instrument = solution.recorded, solution.calibration, work.instrument
    source = "mask" if solution.colours is None else "image"
    predicted, sparse = predict(recorded, session, instrument.joint_names)
    fits, config, run = solution.fits(predicted, work.run), work.config, work.run
    camera, images = recorded.rig.views[0].camera, []
    window = Window(session, camera, instrument, config)
    for i, fitted in enumerate(fits):
        own: tuple[Any, ...] = ()
        if fitted is not None:
            own = fitted.fit, fitted.stored.own.noises[0].inflation(camera.pixel_scale)
        holds = fitted is not None and fitted.fit.explains_mask
        images.append(WindowImage.of(float(recorded.times[i]), predicted, i, *own, holds=holds))
    found = window.solve(images)
    of_fits = zip(fits, found, images, strict=True)
    shown = [(fitted.stored, own, image.misfit) for fitted, own, image in of_fits if fitted is not None]
    of_shown = iter(run(partial(judge_frame, window=window, source=source), shown))
    nothing = Judged("lost", reasons(pose_lost(source, None)))
    frozen = frozen_since(recorded.frozen, [own.name for own in recorded.files])
    results = []
    for i, (fitted, image) in enumerate(zip(fits, images, strict=True)):
        judged = nothing if fitted is None else next(of_shown)
        doubts = [*judged.reasons, *(() if fitted is None else fitted.doubts)]
        if solution.colours is not None:
            doubts += far_joints(found[i][0], image.at, predicted.spread[i], instrument.joint_names)
        doubts += reasons(
            readings_missing(bool(predicted.outer_read[i]), still=False, source=source),
            readings_too_sparse(sparse[i]),
            readings_frozen(frozen[i]),
        )
        seconds = 0.0 if fitted is None else fitted.seconds
        results.append(window.result(image, found[i], judged, doubts, seconds=seconds, remarks=recorded.rig.remarks))
    return results
