"""All readings of a session as functions of one clock, to be interpolated at times other than the images' own."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from dvrk_cmaes.errors import InputError
from dvrk_cmaes.geometry import Float64
from dvrk_cmaes.joints.interpolation import NANOSECONDS, TimedReadings, smooth_spline, straight_line
from dvrk_cmaes.joints.lag import Lag, Unit
from dvrk_cmaes.joints.rows import NO_TIME, JointFile, number_of

_LEAST_GAP = 0.1  # s, of the gaps that are not interpolated, ...
_SPACINGS = 3.0  # ... or times the usual spacing of the readings
_LARGEST_JUMPS = 0.25  # sum of deviations from the neighbours' means over that of changes: moves take two rows


_Table = tuple[Sequence[str], Float64, Float64]
"""J joints, increasing times (M,), and readings (M, J), NaN where there is none."""


@dataclass(frozen=True, eq=False)
class ReadingSeries:
    """Readings of joints as functions of time, and the times of the frames' images on the same clock.

    ``times`` (M,), strictly increasing, and ``values`` (M,), rad or m, are by joint name. ``frames`` are the frames'
    times by name. Times are in seconds, or in frames where only their order is known. ``interval`` is the time between
    consecutive images, in the same unit. ``origin`` is the zero of the times on the recording's own clock, s.
    """

    unit: Unit
    times: Mapping[str, Float64]
    values: Mapping[str, Float64]
    frames: Mapping[str, float]
    interval: float
    origin: float = 0.0

    def at(self, names: Sequence[str], times: Float64, *, smoothed: bool = False) -> Float64:
        """Interpolate the readings of J joints at times (N,), by straight lines or, if ``smoothed``, by a spline.

        Returns (N, J), NaN outside the series, and in gaps of more than three times the usual spacing of the joint's
        readings and, with times, of more than a tenth of a second.

        Parameters
        ----------
        names
            Names of the J joints.
        times
            Times (N,) on the clock of the series.
        smoothed
            Whether to interpolate by a spline.
        """
        out, least = np.full((len(times), len(names)), np.nan), _LEAST_GAP if self.unit == "s" else 0.0
        for k, name in enumerate(names):
            if (readings := self._of_joints.get(name)) is not None:
                gap = max(_SPACINGS * readings.spacing, least) if len(readings.times) > 2 else np.inf
                out[:, k] = readings.at(times, smooth_spline if smoothed else straight_line, apart=gap)[:, 0]
        return out

    @cached_property
    def _of_joints(self) -> Mapping[str, TimedReadings]:
        """The readings of each joint."""
        return {name: TimedReadings((name,), own, self.values[name][:, None]) for name, own in self.times.items()}

    def of_frame(self, name: str, lag: Lag) -> dict[str, float]:
        """Return the readings at the time of a frame's image less the lag, by joint; without those that are not there.

        Parameters
        ----------
        name
            Name of the frame.
        lag
            The lag of the images behind the readings.

        Raises
        ------
        InputError
            The lag is not known in the unit of the series.
        """
        time = np.array([self.frames[name]])
        at = time - lag.in_unit(self.unit)
        found = self.at(tuple(self.values), at)[0]
        return {joint: float(value) for joint, value in zip(self.values, found, strict=True) if not np.isnan(value)}

    def is_interpolable(self, names: Sequence[str], tolerance: Float64) -> bool:
        """Whether the readings of J joints change smoothly from row to row.

        They do unless the deviation of a row from the mean of its neighbours is, in the median over the rows, both more
        than ``tolerance`` (J,) and more than a third of the change between the neighbours.

        Parameters
        ----------
        names
            Names of the J joints.
        tolerance
            (J,), rad (insertion: m).
        """
        return all(
            np.median(deviations) <= max(most, np.median(changes) / 3)
            for most, deviations, changes in self._changes(names, tolerance)
        )

    def jumps(self, names: Sequence[str], tolerance: Float64) -> bool:
        """Whether the readings of one of J joints jump from row to row, as those of postures, which are no recording.

        A joint that moves steadily, and stands still between moves that take two rows, is at the limit; one that scans
        the rows of a board and jumps back is beyond it, however long the rows are.

        Parameters
        ----------
        names
            Names of the J joints.
        tolerance
            (J,), rad (insertion: m), of the mean deviation of a row from the mean of its neighbours.
        """
        return any(
            deviations.mean() > most and deviations.sum() > _LARGEST_JUMPS * changes.sum()
            for most, deviations, changes in self._changes(names, tolerance)
        )

    def _changes(self, names: Sequence[str], tolerance: Float64) -> Iterator[tuple[float, Float64, Float64]]:
        """Yield the tolerance, deviations from the neighbours' means, and changes, of joints of three rows or more."""
        for name, most in zip(names, tolerance, strict=True):
            values = self.values.get(name, np.zeros(0))
            if len(values) >= 3:
                yield most, np.abs(values[1:-1] - (values[:-2] + values[2:]) / 2), np.abs(values[2:] - values[:-2])

    @classmethod
    def of_frames(
        cls, readings: Mapping[str, Mapping[str, float]], times: Mapping[str, float | None]
    ) -> ReadingSeries | None:
        """Create a series from the readings of the frames, which are in the order of their images.

        The clock is that of ``times``, s, if all frames have one and these increase; otherwise the frames are counted.
        Returns None for fewer than two frames.

        Parameters
        ----------
        readings
            Readings by frame and joint, rad (insertion: m).
        times
            Time of each frame's image, s, or None.
        """
        names = list(readings)
        if len(names) < 2:
            return None
        given = [times.get(name) for name in names]
        seconds = np.array([np.nan if time is None else time for time in given])
        timed = bool((np.diff(seconds) > 0).all())
        clock = seconds - seconds[0] if timed else np.arange(len(names), dtype=np.float64)
        joints = list(dict.fromkeys(joint for row in readings.values() for joint in row))
        values = np.array([[row.get(joint, np.nan) for joint in joints] for row in readings.values()]).reshape(
            len(names), -1
        )
        frames, interval = dict(zip(names, clock.tolist(), strict=True)), float(np.median(np.diff(clock)))
        origin = float(seconds[0]) if timed else 0.0
        return cls._of("s" if timed else "frames", [(joints, clock, values)], frames, interval, origin)

    @classmethod
    def of_files(cls, files: Sequence[JointFile], images: Mapping[str, int | None]) -> ReadingSeries | None:
        """Create a series from all rows of a session's files; ``images`` are the frames' names and image times, ns.

        The clock is in seconds if all rows and images have times: an image's own, or that of its row. Otherwise the
        rows of a single file that are labelled by frame are numbered by the numbers that end the labels, or if these
        are missing or do not increase, counted. Returns None where neither is possible. Rows with wrong cells raise
        `InputError`.

        Parameters
        ----------
        files
            The files of readings.
        images
            Times of the images by frame, ns, or None.
        """
        named = [file for file in files if file.labels == "frame"]
        of_row = {name: next((t for file in named if (t := file.time(name)) is not None), None) for name in images}
        stamps = {name: of_row[name] if time is None else time for name, time in images.items()}
        known = {name: time for name, time in stamps.items() if time is not None}
        of_rows = [file.times[file.times != NO_TIME] for file in named]
        every = np.unique(np.concatenate([np.array([*known.values()], np.int64), *of_rows]))
        readings = [timed for file in files for timed in file.timed] if known and len(known) == len(stamps) else []
        if len(every) == 1 and readings:  # one image among readings without names
            every = np.unique(np.concatenate([timed.times for timed in readings]))
        if len(every) > 1 and readings and all(file.timed for file in files):
            origin = min(known.values())
            frames = {name: (time - origin) / NANOSECONDS for name, time in known.items()}
            in_seconds = [(one.joints, (one.times - origin) / NANOSECONDS, one.values) for one in readings]
            interval = float(np.median(np.diff(every))) / NANOSECONDS
            return cls._of("s", in_seconds, frames, interval, origin / NANOSECONDS)
        if len(files) != 1 or len(named) != 1 or len(named[0].names) < 2:
            return None
        (file,) = named
        for text in file.wrong.values():
            raise InputError(text)
        found = (-1 if (number := number_of(label)) is None else number for label in file.names)
        numbers = np.fromiter(found, np.float64, len(file.names))
        numbered = numbers.min() >= 0 and bool((np.diff(numbers) > 0).all())
        clock = numbers if numbered else np.arange(len(numbers), dtype=np.float64)
        frames = {name: float(clock[file.names[name]]) for name in images if name in file.names}
        return cls._of("frames", [(file.joints, clock, file.values)], frames, 1.0)

    @classmethod
    def _of(
        cls, unit: Unit, tables: Iterable[_Table], frames: Mapping[str, float], interval: float, origin: float = 0.0
    ) -> ReadingSeries:
        """Create a series from tables of readings."""
        times, read = dict[str, Float64](), dict[str, Float64]()
        for joints, clock, values in tables:
            for joint, column in zip(joints, values.T, strict=True):
                known = ~np.isnan(column)
                rows = slice(None) if known.all() else known  # a view takes no memory
                if known.any():
                    times[joint], read[joint] = clock[rows], column[rows]
        return cls(unit, times, read, frames, interval, origin)
