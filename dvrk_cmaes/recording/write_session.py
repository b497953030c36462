"""Writing of a recording as a session folder: camera.yaml, session.toml, images/, images.csv and joints.csv.

Of both eyes there are left.yaml, right.yaml, images/left and images/right.

images.csv has the columns frame and time, joints.csv the columns frame, time and one for each joint. A cell of
joints.csv is blank if no reading was near enough in time. The folder is written completely or not at all.
"""

from __future__ import annotations

import math
import re
import shlex
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from decimal import Decimal
from itertools import count
from pathlib import Path
from typing import Final

import numpy as np

from dvrk_cmaes.errors import InputError
from dvrk_cmaes.frames.coco_mask import FILES, frames_of
from dvrk_cmaes.frames.images import THRESHOLD, match_size
from dvrk_cmaes.frames.paired_names import counted_apart, with_names_of
from dvrk_cmaes.frames.session_folder import UNCALIBRATED, image_files, read_session
from dvrk_cmaes.frames.session_toml import SESSION_FILE, CameraEntry, ToolEntry, session_toml
from dvrk_cmaes.frames.video_frames import Video
from dvrk_cmaes.io.csv_file import csv_text
from dvrk_cmaes.io.encode import Document
from dvrk_cmaes.io.image_header import PNG, read_header
from dvrk_cmaes.io.json_file import write_text
from dvrk_cmaes.io.output import whole_folder, write_bytes
from dvrk_cmaes.io.short_text import listed, natural
from dvrk_cmaes.joints.interpolation import NANOSECONDS, TimedReadings, weighted_mean
from dvrk_cmaes.joints.lag import LARGEST_SECONDS, Lag
from dvrk_cmaes.joints.names import ECM_JOINTS
from dvrk_cmaes.recording.messages import encode_png
from dvrk_cmaes.recording.recording import RecordedImage, Recording

_FARTHEST = NANOSECONDS // 100  # ns, between the images of a pair: less than half of the time between images
_ARM = re.compile(r"(?<![A-Za-z0-9])PSM[1-3](?![A-Za-z0-9])")


@dataclass(frozen=True)
class InterpolationSummary:
    """Summary of the interpolation of one source of readings.

    ``frames`` is the number of images with readings, ``without`` that of images without. ``farthest_s`` is the largest
    distance in time of a reading used from its image, s; ``nearest_s`` is the smallest distance in time of a reading
    from an image that has none, s. Both are None if there is no such image.
    """

    source: str
    joints: tuple[str, ...]
    frames: int
    without: int
    farthest_s: float | None
    nearest_s: float | None


@dataclass(frozen=True)
class ImportSummary(Document):
    """Summary of a written session.

    ``images`` is the number of images read from the recording, ``frames`` that of images written, ``size`` their width
    and height, px. ``lag_s`` is the lag of the images that was taken out of the readings. ``warnings`` are on times
    that are not those of a clock.
    """

    session: Path
    images: int
    frames: int
    size: tuple[int, int]
    tolerance_s: float
    readings: tuple[InterpolationSummary, ...]
    notes: tuple[str, ...]
    lag_s: float = 0.0
    warnings: tuple[str, ...] = ()


def write_session(
    recording: Recording,
    out: Path,
    *,
    every: int = 1,
    start: float = 0.0,
    end: float = math.inf,
    tolerance: float = 0.05,
    lag: Lag | None = None,
    overwrite: bool = False,
) -> ImportSummary:
    """Write the session folder of a recording, with one image at a time in memory.

    Parameters
    ----------
    recording
        An open recording whose images have not been iterated yet.
    out
        The session folder; unless ``overwrite`` is given, it must be empty or not exist.
    every, start, end
        Every Nth of the images between two times, in seconds after the first image, is written.
    tolerance
        Largest distance in time between an image and the readings before and after it, s.
    lag
        Lag of the images behind the readings, in seconds: an image gets the readings of this much earlier. By default
        none.
    overwrite
        Replace an existing session.

    Raises
    ------
    InputError
        No image is selected, an image is not valid or of another size, no image has readings near enough in time, the
        written folder cannot be read as a session, or ``out`` cannot be written.
    DvrkCmaesError
        Writing fails, e.g. because the disk is full.
    """
    tools, summaries, said = list[ToolEntry](), list[InterpolationSummary](), list[str]()
    warnings: tuple[str, ...] = ()
    names, times, size, apart, numbers = list[str](), list[int](), (0, 0), list[int](), count()
    seconds = 0.0 if lag is None or not recording.pictured else lag.in_unit("s")
    if abs(seconds) > LARGEST_SECONDS:
        raise InputError(f"lag: expected at most {LARGEST_SECONDS:g} s in magnitude, got {seconds:g} s")
    if (masks := recording.masks) is not None and (recording.right is not None or not recording.pictured):
        raise InputError(f"{masks}: --masks: expected a recording with images of one eye")
    with whole_folder(out, "import", overwrite=overwrite, source=recording.path) as folder:
        for name, data in recording.kept.items():
            write_bytes(folder / name, data)
        if recording.pictured:
            images = (image for image, _ in zip(recording.images, numbers, strict=False))
            of, times, size, apart = _write_images(folder / "images", recording, _selected(images, every, start, end))
            names = [recording.name(number) for number in of]
            said += [] if masks is None else [write_masks(masks, folder, names, of)]
            warnings = _check_times(recording.path, names, times)
            cells = zip(names, map(_seconds_text, times), strict=True)
            write_text(folder / "images.csv", csv_text(("frame", "time"), cells))
            cameras = _write_cameras(folder, recording)
            said += [] if recording.camera else [UNCALIBRATED.replace("FOLDER", shlex.quote(str(out)))]
        for number, (name, readings) in enumerate(recording.arms.items()):
            file, arm = f"joints_{name}.csv" if name else "joints.csv", name or _arm_of(readings)
            at = times if names or not readings else readings[0].times.tolist()
            if not at:
                raise InputError(f"{recording.path}: expected images or readings, got neither")
            read_at = [time - round(seconds * NANOSECONDS) for time in at]
            tables, columns, of_arm = _interpolate(recording.path, readings, read_at, round(tolerance * NANOSECONDS))
            keys = {**({"frame": names} if names else {}), "time": [_seconds_text(time) for time in at]}
            rows = ((*key, *row) for *key, row in zip(*keys.values(), tables, strict=True))
            write_text(folder / file, csv_text((*keys, *columns), rows))
            summaries += of_arm
            if arm is not None:
                tools.append(ToolEntry(arm, label=(number + 1,), joints=Path(file)) if name else ToolEntry(arm))
            if names:  # raises InputError if the folder is not a valid session
                session = read_session(folder, joints=[folder / file], focal=None if recording.camera else "usual")
        if names:
            try:
                match_size(session.camera, size[::-1], "image")
            except InputError as error:
                warnings = (*warnings, f"the images do not fit the camera: {error}")
            write_text(folder / SESSION_FILE, session_toml(cameras, tools))
    said += [f"readings of {seconds:g} s before each image"] if seconds else []
    if recording.right is not None:
        away = f"images at most {1e3 * max(apart) / NANOSECONDS:.1f} ms after or before those of the left"
        said.append(f"right eye: {len(apart)} of {len(names)} frames, {away}")
    sources, notes = tuple(summaries), (*recording.notes, *said)
    return ImportSummary(out, next(numbers), len(names), size, tolerance, sources, notes, seconds, warnings)


def _selected(images: Iterator[RecordedImage], every: int, start: float, end: float) -> Iterator[RecordedImage]:
    """Yield every Nth of the images between two times, s after the first image, beginning with the first of these."""
    first: int | None = None
    inside = count()
    for image in images:
        first = image.time if first is None else first
        if start <= (image.time - first) / NANOSECONDS <= end and next(inside) % every == 0:
            yield image


def _seconds_text(time: int) -> str:
    """Return a time, ns, as the text of seconds."""
    return f"{Decimal(time).scaleb(-9):f}"


def _check_times(path: Path, names: Sequence[str], times: Sequence[int]) -> tuple[str, ...]:
    """Return warnings about images whose times are not later than those before; InputError if they are half of all."""
    steps = np.diff(np.array(times, dtype=np.int64))
    same, back = np.flatnonzero(steps == 0), np.flatnonzero(steps < 0)
    if len(steps) and 2 * len(same) >= len(steps):
        raise InputError(
            f"{path}: expected times of the images that advance, got {len(same)} of {len(times)} with the time of the "
            "one before: --recorded-times uses those of recording"
        )
    warnings = []
    if len(same):
        which = listed(names[int(k) + 1] for k in same)
        warnings.append(f"{len(same)} images have the time of the one before ({which}): they count as one moment")
    if len(back):
        by = -int(steps[back[0]]) / NANOSECONDS
        warnings.append(
            f"time goes back by {by:.3f} s at frame {names[int(back[0]) + 1]} (a clock that was set?), as in "
            f"{len(back)} places: track will refuse it; --recorded-times uses the times of recording"
        )
    return tuple(warnings)


def _arm_of(readings: Sequence[TimedReadings]) -> str | None:
    """Return the name of the arm that the sources of all readings name, such as PSM1; None if there is not one."""
    arms = {name for source in readings for name in _ARM.findall(source.source)}
    return arms.pop() if len(arms) == 1 else None


def _write_cameras(folder: Path, recording: Recording) -> CameraEntry:
    """Write the camera files, and return them as entries of session.toml."""
    if not recording.camera:
        return CameraEntry()
    if recording.right is None or recording.camera == recording.right.camera:  # in this case a file of both eyes
        write_bytes(folder / "camera.yaml", recording.camera)
        return CameraEntry(file=Path("camera.yaml"), rectified=recording.rectified)
    write_bytes(folder / "left.yaml", recording.camera)
    write_bytes(folder / "right.yaml", recording.right.camera)
    return CameraEntry(left=Path("left.yaml"), right=Path("right.yaml"), rectified=recording.rectified)


def _write_images(
    folder: Path, recording: Recording, images: Iterator[RecordedImage]
) -> tuple[list[int], list[int], tuple[int, int], list[int]]:
    """Write images as files; return their numbers and times, ns, width and height, and how far pairs are apart, ns.

    Those of the right eye are written beside them, into folders of both eyes.
    """
    numbers, times, apart, sizes = list[int](), list[int](), list[int](), dict[Path, tuple[int, int]]()
    both = recording.right is not None
    left = folder / "left" if both else folder
    for image, partner in _paired(images, iter(()) if recording.right is None else recording.right.images):
        numbers.append(image.number)
        times.append(image.time)
        apart += [] if partner is None else [abs(partner.time - image.time)]
        for own, to in ((image, left), (partner, folder / "right")):
            if own is not None:
                _write_image(recording.path, own, to, recording.name(image.number), sizes)
    if not numbers:
        raise InputError(f"{recording.path}: expected images, got none (of those asked for)")
    if both and not apart:
        raise InputError(f"{recording.path}: expected images of the right eye within 10 ms of the left one's, got none")
    return numbers, times, sizes[left], apart


def _paired(
    images: Iterator[RecordedImage], of_right: Iterator[RecordedImage]
) -> Iterator[tuple[RecordedImage, RecordedImage | None]]:
    """Yield images with that of the right eye taken within 10 ms, None if there is none."""
    waiting: RecordedImage | None = None
    for image in images:
        if waiting is None or waiting.time < image.time - _FARTHEST:
            waiting = next((own for own in of_right if own.time >= image.time - _FARTHEST), None)
        near = waiting is not None and waiting.time <= image.time + _FARTHEST
        yield image, waiting if near else None
        waiting = None if near else waiting


def _write_image(path: Path, image: RecordedImage, folder: Path, name: str, sizes: dict[Path, tuple[int, int]]) -> None:
    """Write an image to a folder; InputError if it is of another size than those before, which ``sizes`` have."""
    data = image.load()
    header = read_header(data)
    assert header is not None
    width, height = sizes.setdefault(folder, (header.width, header.height))
    if (header.width, header.height) != (width, height):
        raise InputError(
            f"{path}: image {image.number}: expected the first image's size {width} x {height}, "
            f"got {header.width} x {header.height}"
        )
    write_bytes(folder / f"{name}{'.png' if data.startswith(PNG) else '.jpg'}", data)


def _interpolate(
    path: Path, readings: Sequence[TimedReadings], times: Sequence[int], tolerance: int
) -> tuple[list[list[str]], tuple[str, ...], tuple[InterpolationSummary, ...]]:
    """Interpolate all readings; return the cells of each frame, the column names and a summary for each source."""
    at = np.array(times, dtype=np.int64)
    columns, parts, summaries = list[str](), [np.empty((len(times), 0))], []
    for source in readings:
        repeated = [name for name in source.joints if name in columns]
        if repeated:
            raise InputError(
                f"{path}: {source.source}: {', '.join(repeated)}: expected joints that were not read before "
                "(leave a topic out by --jaw-topic none)"
            )
        nearest, farther = (each / NANOSECONDS for each in source.distances(at))
        values = source.at(at, weighted_mean, away=tolerance)
        known = np.isfinite(values).any(axis=1)
        used, missed = farther[known].tolist(), nearest[~known].tolist()
        limits = max(used, default=None), min(missed, default=None)
        summaries.append(InterpolationSummary(source.source, source.joints, len(used), len(missed), *limits))
        if not used and source.joints == ECM_JOINTS:  # the endoscope's arm may have stopped publishing
            continue
        if not used:
            spans = [
                f"{each[0] / NANOSECONDS:.3f} to {each[-1] / NANOSECONDS:.3f} s" if len(each) else "none"
                for each in (source.times.tolist(), sorted(times))
            ]
            raise InputError(
                f"{path}: {source.source}: expected readings within {tolerance / NANOSECONDS:g} s before and after an "
                f"image, got readings of {spans[0]} and images of {spans[1]}: give the time of a video's first "
                "image on the readings' clock by --video-start, or a larger --tolerance"
            )
        columns += source.joints
        parts.append(values)
    table = [["" if math.isnan(value) else f"{value:.9f}" for value in row] for row in np.hstack(parts).tolist()]
    return table, tuple(columns), tuple(summaries)


_EXPECTED: Final = "a folder of masks, a video of masks, or a COCO file (JSON)"


def write_masks(given: Path, folder: Path, names: Sequence[str], numbers: Sequence[int]) -> str:
    """Write the masks of a session's frames, and say how many have one.

    Parameters
    ----------
    given
        A folder of masks named as the frames or by their numbers; a video whose N-th picture is the mask of the N-th
        image of the recording; or a COCO file of such names.
    folder
        The session folder.
    names, numbers
        Of its frames, and of their images in the recording, from zero.

    Raises
    ------
    InputError
        There is no such file, or no frame has a mask.
    """
    met = dict[str, str]()
    if given.is_dir():
        masks = image_files(given)
        met = {name: frame for name, frame in with_names_of(given, masks, (), names).items() if frame in {*names}}
        for name, frame in met.items():
            write_bytes(folder / "masks" / f"{frame}{masks[name].suffix.lower()}", masks[name].read_bytes())
        found, there = len(met), [*masks]
    elif given.suffix.lower() == ".json":
        there = [*frames_of(given)]
        met = with_names_of(given, dict.fromkeys(there, given), (), names) if there else {}
        found = len({*names} & {*met.values()})
        write_bytes(folder / FILES[0], given.read_bytes())
    else:
        wanted, there = dict(zip(numbers, names, strict=True)), list[str]()
        for number, _, decoded in Video(given, _EXPECTED).frames():
            if number in wanted:
                mask = encode_png(np.where(decoded().max(axis=2) > THRESHOLD, np.uint8(255), np.uint8(0)))
                write_bytes(folder / "masks" / f"{wanted[number]}.png", mask)
            there.append(f"{number}")
        found = sum(number < len(there) for number in wanted)
    if not found:
        of_frames = listed(sorted(names, key=natural), 2)
        raise InputError(f"{given}: expected masks of the frames {of_frames}, got {listed(there, 2) or 'none'}")
    in_order = f", in order from {there[0]} on" if met and counted_apart(there, names) else ""
    return f"masks: {found} of {len(names)} frames, of {given}{in_order}"
