"""A recording to a session folder, whole or not at all: camera.yaml, images/, images.csv and joints.csv.

images.csv    frame, time: of every image
joints.csv    frame, time, one column a joint: a blank cell where no reading was near enough
"""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from decimal import Decimal
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np

from dvrk_cmaes.errors import InputError
from dvrk_cmaes.frames.session_folder import read_session
from dvrk_cmaes.io.atomic import write_bytes, write_text
from dvrk_cmaes.io.atomic_folder import whole_folder
from dvrk_cmaes.joints.interpolation import NANOSECONDS, TimedReadings
from dvrk_cmaes.recording.recording import RecordedImage, Recording

_DIGITS = 6  # of a frame's name


@dataclass(frozen=True)
class Selection:
    """Which images: every Nth of those between two times, seconds after the first image."""

    every: int = 1
    start: float = 0.0
    end: float = math.inf

    def of(self, images: Iterator[RecordedImage]) -> Iterator[RecordedImage]:
        """Go through the selected images; the first selected one is the first in time."""
        first: int | None = None
        passed = 0
        for image in images:
            first = image.time if first is None else first
            if self.start <= (image.time - first) / NANOSECONDS <= self.end:
                if passed % self.every == 0:
                    yield image
                passed += 1


@dataclass(frozen=True)
class Interpolated:
    """What became of one source of readings: how many frames got some, and how far away the readings used were.

    ``farthest_s`` is the largest distance in seconds of a reading that was used from its image; ``nearest_s`` that of
    any reading from an image that got none. None where there is no such frame.
    """

    source: str
    joints: tuple[str, ...]
    frames: int
    without: int
    farthest_s: float | None
    nearest_s: float | None


@dataclass(frozen=True)
class ImportSummary:
    """A session that was written: where, how many frames of how many images, and their readings."""

    session: Path
    images: int
    frames: int
    size: tuple[int, int]
    tolerance_s: float
    readings: tuple[Interpolated, ...]
    notes: tuple[str, ...]

    def to_dict(self) -> dict[str, Any]:
        """Plain values, for JSON."""
        return {
            "session": str(self.session),
            "images": self.images,
            "frames": self.frames,
            "size": list(self.size),
            "tolerance_s": self.tolerance_s,
            "readings": [{**vars(one), "joints": list(one.joints)} for one in self.readings],
            "notes": list(self.notes),
        }


def write_session(
    recording: Recording, out: Path, *, selection: Selection, tolerance: float, overwrite: bool = False
) -> ImportSummary:
    """Write the session folder of a recording; its images pass through memory one at a time.

    Parameters
    ----------
    recording
        Open, its images not yet gone through.
    out
        The folder, which must be new or empty unless ``overwrite``.
    selection
        Which images.
    tolerance
        How far in seconds the readings on either side of an image's time may be from it.
    overwrite
        Replace an older session.

    Raises
    ------
    InputError
        No image is selected, an image will not do or is of another size, no image has readings near enough, what was
        recorded does not read back as a session, or ``out`` cannot be written.
    DvrkCmaesError
        The disk is full or failing.
    """
    names: list[str] = []
    times: list[int] = []
    with whole_folder(out, sign="camera.yaml", overwrite=overwrite, source=recording.path) as folder:
        counted = _Counted(recording.images)
        size = _write_images(folder / "images", recording, selection.of(counted.images()), names, times)
        tables, columns, outcomes = _interpolate(recording, times, round(tolerance * NANOSECONDS))
        stamps = [f"{Decimal(time).scaleb(-9):f}" for time in times]
        write_bytes(folder / "camera.yaml", recording.camera)
        write_text(folder / "images.csv", _csv(("frame", "time"), zip(names, stamps, strict=True)))
        rows = ((name, stamp, *table) for name, stamp, table in zip(names, stamps, tables, strict=True))
        write_text(folder / "joints.csv", _csv(("frame", "time", *columns), rows))
        read_session(folder)  # what was written must read back, whatever was in the recording
    return ImportSummary(out, counted.number, len(names), size, tolerance, outcomes, recording.notes)


class _Counted:
    """Images that are counted as they pass."""

    def __init__(self, images: Iterator[RecordedImage]) -> None:
        self._images = images
        self.number = 0

    def images(self) -> Iterator[RecordedImage]:
        for image in self._images:
            self.number += 1
            yield image


def _write_images(
    folder: Path, recording: Recording, images: Iterator[RecordedImage], names: list[str], times: list[int]
) -> tuple[int, int]:
    """Write images under their numbers; give their size, width and height."""
    size: tuple[int, int] | None = None
    for image in images:
        file = image.load()
        size = size or (file.width, file.height)
        if (file.width, file.height) != size:
            raise InputError(
                f"{recording.path}: image {image.number}: expected the first image's size {size[0]} x {size[1]}, "
                f"got {file.width} x {file.height}"
            )
        name = f"{image.number:0{_DIGITS}d}"
        write_bytes(folder / f"{name}{file.extension}", file.data)
        names.append(name)
        times.append(image.time)
    if size is None:
        raise InputError(f"{recording.path}: expected images, got none (of those asked for)")
    return size


def _interpolate(
    recording: Recording, times: Sequence[int], tolerance: int
) -> tuple[list[list[str]], tuple[str, ...], tuple[Interpolated, ...]]:
    """Cells of each frame, names of their columns, and what became of each source."""
    columns: list[str] = []
    parts: list[list[list[str]]] = []
    outcomes = []
    for source in recording.readings:
        doubled = [name for name in source.joints if name in columns]
        if doubled:
            raise InputError(
                f"{recording.path}: {source.source}: {', '.join(doubled)}: expected joints that were not read before "
                "(leave a topic out by --jaw-topic none)"
            )
        columns += source.joints
        cells, outcome = _interpolate_source(source, times, tolerance)
        if outcome.frames == 0:
            away = math.nan if outcome.nearest_s is None else outcome.nearest_s
            raise InputError(
                f"{recording.path}: {source.source}: expected readings within {tolerance / NANOSECONDS:g} s before and "
                f"after an image, got none; the nearest is {away:.6g} s away (another clock? a larger --tolerance?)"
            )
        parts.append(cells)
        outcomes.append(outcome)
    table = [list(chain.from_iterable(part[k] for part in parts)) for k in range(len(times))]
    return table, tuple(columns), tuple(outcomes)


def _interpolate_source(
    source: TimedReadings, times: Sequence[int], tolerance: int
) -> tuple[list[list[str]], Interpolated]:
    cells: list[list[str]] = []
    used: list[int] = []
    missed: list[int] = []
    for time in times:
        found = source.at(time, tolerance)
        if found is None:
            cells.append([""] * len(source.joints))
            missed.append(source.distance(time))
        else:
            cells.append(["" if np.isnan(value) else f"{value:.9f}" for value in found[0]])
            used.append(found[1])
    return cells, Interpolated(
        source=source.source,
        joints=source.joints,
        frames=len(used),
        without=len(missed),
        farthest_s=max(used) / NANOSECONDS if used else None,
        nearest_s=min(missed) / NANOSECONDS if missed else None,
    )


def _csv(header: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(header)
    writer.writerows(rows)
    return text.getvalue()
