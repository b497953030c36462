"""Joint readings of frames, from files of any supported format or given as text ``name=value,name=value``.

A missing column or a blank cell means that the reading is not known; it is not zero. If the rows of a file have times,
a frame's readings are interpolated to the image's time between the rows before and after it.
"""

from __future__ import annotations

import io
import os
import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from dvrk_cmaes.errors import InputError, nearest_first, one_line
from dvrk_cmaes.io.files import read_bytes, text_of
from dvrk_cmaes.io.short_text import listed, shown
from dvrk_cmaes.joints.csv_table import EXPECTED, LEAST, read_joint_csv, read_plain_table
from dvrk_cmaes.joints.interpolation import NANOSECONDS, weighted_mean
from dvrk_cmaes.joints.joint_state import POSITION, read_joint_state
from dvrk_cmaes.joints.lag import Lag
from dvrk_cmaes.joints.names import check_joint, joint_reading, joints_by_count
from dvrk_cmaes.joints.rows import BY_THEMSELVES, JointFile, ReadAs, number_of
from dvrk_cmaes.joints.series import ReadingSeries
from dvrk_cmaes.joints.times import time_in_name

TIME_TOLERANCE = NANOSECONDS // 20
"""Default of the largest distance in time between an image and the readings before and after it, ns."""

_LARGEST = 1_000_000_000  # bytes; one hour at 1 kHz has half as many
_LARGEST_YAML = 10_000_000  # bytes; about 25,000 messages, read in a quarter of a minute


class NoneNearError(InputError):
    """No reading is near the time of an image, as where one of the two began earlier."""


FrameReadings = tuple[dict[str, float], tuple[str, ...], int | None]
"""Readings of one frame, by joint, rad or m; assumptions made where the files are ambiguous, one sentence each; and the
largest distance in time, ns, between the image and a reading used in interpolation, None if none was."""


def read_joint_table(path: str | Path) -> dict[str, dict[str, float]]:
    """Read the joint readings of all rows of a file, by their label (frame or number), in the file's order.

    Errors are those of `read_joint_file`.
    """
    file = read_joint_file(path)
    return {label: file.readings(place) for label, place in file.names.items()}


def read_joint_file(text_or_path: str | Path | JointFile, *, read_as: ReadAs = BY_THEMSELVES) -> JointFile:
    """Read a file of readings whose format is recognised by its content, or readings given as text as one row.

    Parameters
    ----------
    text_or_path
        ``wrist_pitch=-0.68,wrist_yaw=-0.36,jaw=1.34``, or the path of a file of readings. Text with an equals sign is
        taken for a path only if such a file exists. A file that was read already is returned.
    read_as
        How files are read that do not say it themselves.

    Raises
    ------
    InputError
        The readings are not valid; the message names the file, the frame or the joint, and what was expected.
    """
    if isinstance(text_or_path, JointFile):
        return text_or_path
    if is_written_out(text_or_path):
        row = ("joints", _written_out(str(text_or_path), read_as.names), None)
        return JointFile.of("joints", "written-out readings", {"": row}, "message")
    path = str(text_or_path)
    data = read_bytes(path, expected=EXPECTED, largest=_LARGEST)
    if data.startswith(MAGIC):
        return read_joint_npy(path, data)
    if len(data) > LEAST and not read_as.columns and (table := read_plain_table(path, data, read_as.names)) is not None:
        return table
    text = text_of(path, data, expected=EXPECTED)
    if not POSITION.search(text):
        return read_joint_csv(path, text, read_as)
    if len(data) > _LARGEST_YAML:
        raise InputError(
            f"{path}: expected at most {_LARGEST_YAML / 1e6:g} MB of messages as YAML, got {len(data) / 1e6:.1f} MB: "
            "import a bag instead"
        )
    return read_joint_state(path, text, read_as)


def frame_readings(
    files: Sequence[JointFile],
    frame: str,
    *,
    time: int | None = None,
    tolerance: int = TIME_TOLERANCE,
    single: bool = False,
    needed: bool = False,
) -> FrameReadings:
    """Find the readings of one frame in all files of a session.

    If the rows of a file have times and the image's time is known, the readings are interpolated to it, unless the row
    with the frame's name has exactly that time. Otherwise the row with the frame's name is used, or, in a file whose
    rows are numbered, the row with the whole number at the end of the frame's name.

    Parameters
    ----------
    files
        Files as returned by ``read_joint_file``; each joint must be in one of them only.
    frame
        The frame's name.
    time
        The image's time, ns.
    tolerance
        Largest distance in time between the image and the readings before and after it, ns.
    single
        Whether the only row of a file is used whatever its name.
    needed
        Whether each file must have a row of the frame; the only row of one without names of frames is used.

    Raises
    ------
    InputError
        No reading is within the tolerance, the image's time is needed but not known, a joint is in two files, a cell is
        not valid, or a row that is ``needed`` is not there.
    """
    readings: dict[str, float] = {}
    origin: dict[str, str] = {}
    notes: list[str] = []
    farthest: int | None = None
    for file in files:
        named = file.time(frame) if file.labels == "frame" else None
        if time is not None and file.timed and named != time:
            found, distance = _interpolated(file, frame, time, tolerance)
            farthest = max(distance, farthest or 0)
        else:
            row, note = _row_of(file, frame, single=single or (needed and file.labels != "frame"))
            if row is None and needed:
                near = listed(nearest_first(frame, file.names))
                expected = f"expected one of its {len(file.values)} frames ({near})"
                raise InputError(f"{file.path}: frame: {expected}, got {shown(frame)} (--frame)")
            found = {} if row is None else file.readings(row)
            notes.extend(note)
        for name, value in found.items():
            if name in readings:
                raise InputError(f"{file.path}: {name}: expected each joint in one file, got it in {origin[name]} too")
            readings[name], origin[name] = value, file.path
    return readings, tuple(notes), farthest


def read_frame_joints(
    sources: Sequence[str | Path | JointFile],
    *,
    frame: str | None,
    image: str,
    time: int | None = None,
    lag: Lag | None = None,
    read_as: ReadAs = BY_THEMSELVES,
) -> FrameReadings:
    """Read the readings of a frame that is not part of a session folder.

    Parameters
    ----------
    sources
        Texts or paths as for `read_joint_file`, or files; each joint must be in one of them only.
    frame
        The frame's name, or None; if it is given, the sources must have its row.
    image
        The image's name, used as the frame's name if ``frame`` is None; the only row of a table is then used for any
        name.
    time
        The image's time, ns; by default the time at the end of the image's name, if any.
    read_as
        How files are read that do not say it themselves.
    lag
        Lag of the images behind the readings: the readings are interpolated at the image's time less the lag. A note
        states it where it cannot be taken out, because the readings are those of a single moment.

    Raises
    ------
    InputError
        As for ``frame_readings``; the frame has no row; there are no readings at its time less the lag.
    """
    name = image if frame is None else frame
    files = [read_joint_file(source, read_as=read_as) for source in sources]
    if (offset := read_as.offset) is not None:
        files = [own if own.labels == "message" else own.by_number([name], offset, read_as.step) for own in files]
    image_time = time_in_name(image) if time is None else time
    series = None if lag is None else ReadingSeries.of_files(files, {name: image_time})
    if lag is not None and series is not None and name in series.frames:
        found = series.of_frame(name, lag)
        if not found:
            raise InputError(f"{files[0].path}: frame {name}: expected readings {lag.text} before the image, got none")
        return found, (f"readings of {lag.text} before the image",), None
    readings, notes, farthest = frame_readings(files, name, time=image_time, single=frame is None, needed=True)
    late = () if lag is None else (f"the lag of {lag.text} is not taken out of single readings",)
    return readings, (*notes, *late), farthest


def is_written_out(text_or_path: str | Path) -> bool:
    """Whether an argument is readings as text ``name=value,...`` and not a path."""
    return isinstance(text_or_path, str) and "=" in text_or_path and not os.path.exists(text_or_path)


def _written_out(text: str, names: tuple[str, ...]) -> dict[str, float]:
    """Parse readings given as text ``name=value,name=value``."""
    readings: dict[str, float] = {}
    for item in text.split(","):
        name, equals, value = (part.strip() for part in item.partition("="))
        if not equals:
            raise InputError(f"joints: expected name=value,name=value, got {shown(item.strip())}")
        check_joint("joints", name, names)
        if name in readings:
            raise InputError(f"joints: {name}: expected one reading, got two")
        readings[name] = joint_reading("joints", name, value)
    return readings


def _interpolated(file: JointFile, frame: str, time: int, tolerance: int) -> tuple[dict[str, float], int]:
    """Interpolate a file's readings at a time; return them and the distance of the farthest reading used, ns."""
    found: dict[str, float] = {}
    at, farthest = np.array([time]), 0
    for timed in file.timed:
        # those that a robot sends five times a second are thus interpolated as those of a faster one are
        most = tolerance if len(timed.times) < 4 else max(tolerance, round(1.5 * timed.spacing))
        nearest, farther = (int(distance[0]) for distance in timed.distances(at))
        if not timed.known(at, away=most):
            raise NoneNearError(
                f"{file.path}: frame {frame}: {timed.joints[0]}: expected readings before and after the image's time "
                f"{time / NANOSECONDS:.3f} s, within {most / NANOSECONDS:g} s, got the nearest "
                f"{nearest / NANOSECONDS:.3f} s away"
            )
        found |= zip(timed.joints, timed.at(at, weighted_mean, away=most)[0].tolist(), strict=True)
        farthest = max(farthest, farther)
    return found, farthest


def _row_of(file: JointFile, frame: str, *, single: bool) -> tuple[int | None, tuple[str, ...]]:
    """Find the place of a frame's row (None if there is none), and notes on how it was found."""
    if single and len(file.values) == 1:
        return 0, ()
    if file.labels == "frame":
        return file.names.get(frame), ()
    if file.labels == "number":
        label = str(number_of(frame))
        note = f"frame {frame} is taken for row {label} of {Path(file.path).name}, by its number"
        return file.names.get(label), (note,) if label in file.names else ()
    raise InputError(
        f"{file.path}: frame {frame}: expected a column frame, or the image's time (images.csv of a session, --time of "
        f"one frame; of a video, `dvrk-cmaes import`), to find its row among {len(file.values)}"
    )


MAGIC = b"\x93NUMPY"

_EXPECTED = "joint readings (joint_NNNN.npy of 6 numbers or jaw_NNNN.npy of 1)"
_NAME = re.compile(r"(joint|jaw)_\d+")


def read_joint_npy(path: str, data: bytes) -> JointFile:
    """Read joint readings from the bytes of a .npy file; ``path`` is for messages and names the row.

    Pickled objects are refused.

    Raises
    ------
    InputError
        The array is not one of readings; the message names the file and what was expected.
    """
    stem = Path(path).stem
    if not _NAME.fullmatch(stem):
        raise InputError(f"{path}: expected {_EXPECTED}, got another NumPy file: write its numbers to a joints.csv")
    try:
        values = np.load(io.BytesIO(data), allow_pickle=False)
    except Exception as error:  # NumPy parses the header as a Python literal, with errors of many types
        raise InputError(f"{path}: expected {_EXPECTED}, got no valid NumPy file ({one_line(error)})") from None
    if values.dtype.kind not in "fiu" or not 0 < values.size <= 6:
        raise InputError(f"{path}: expected {_EXPECTED}, got {values.dtype} of shape {values.shape}")
    cells = dict(zip(joints_by_count(path, values.size), values.ravel().tolist(), strict=True))
    return JointFile.of(path, f"NumPy array of {values.size}", {stem: (path, cells, None)}, "message")
