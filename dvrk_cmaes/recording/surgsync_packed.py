"""Reader of packed SurgSync episodes: readings and times by frame as parquet, a video for each camera.

An episode's folder, ``RELEASE/DATASET/episodes/TASK/CLIP``, has the files::

    timestamp.parquet            times of the left images, and of all else against these
    PSM1.parquet, PSM2.parquet   readings of an arm and of its jaw
    video_raw/stereo_left.mkv    raw images (FFV1); video/stereo_left.mp4 are rectified ones
    calibration/left.yaml        the cameras of the raw images, and the pose between them
    episode_meta.json            the time of the first image

The reader follows the schemas that the recorder's authors publish; it has not been tried with a released episode.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any, Final

from dvrk_cmaes.camera.files import Side
from dvrk_cmaes.errors import InputError
from dvrk_cmaes.frames.video_frames import EXPECTED, open_capture
from dvrk_cmaes.io.files import check_file
from dvrk_cmaes.io.json_file import read_json_object
from dvrk_cmaes.io.short_text import listed, shown
from dvrk_cmaes.joints.interpolation import TimedReadings
from dvrk_cmaes.joints.names import joint_reading, joints_by_count
from dvrk_cmaes.recording.parquet_file import field_names, read_columns
from dvrk_cmaes.recording.recording import Asked, Recording
from dvrk_cmaes.recording.surgsync import at_images, camera_of_clip, chosen_arm, registrations
from dvrk_cmaes.recording.video import frames_at

_TIMES: Final = "timestamp.parquet"
_META: Final = "episode_meta.json"
_ROW: Final = "frame_index"
_TIME: Final = "master_timestamp_ns"
_JOINTS: Final = "measured_js.position"
_JAW: Final = "jaw.measured_position"
_TOPICS: Final = {_JOINTS: "measured_js", _JAW: "jaw_measured"}
"""Topics whose times against the left image are those of a field."""
_AGAINST: Final = "delta_to_master."
_OLDEST, _LATEST = -(2**62), 2**62  # ns


def is_packed(path: Path) -> bool:
    """Whether a folder is a packed episode, or a release of them."""
    return (path / _TIMES).is_file() or ((path / "meta" / "dataset.json").is_file() and any(path.glob("*/episodes")))


@contextmanager
def open_packed(path: Path, asked: Asked) -> Iterator[Recording]:
    """Open an episode; times and readings are read at once, images during iteration.

    Parameters and errors are those of `open_surgsync`; rectified images need a camera file.
    """
    if not (path / _TIMES).is_file():
        episodes = sorted(found.parent.relative_to(path).as_posix() for found in path.glob(f"*/episodes/*/*/{_TIMES}"))
        raise InputError(f"{path}: expected the folder of one episode, one of {listed(episodes) or 'none'}")
    video, rectified = _video(path, asked.side, asked.camera)
    times = _times(path, asked.side)
    lens, source = camera_of_clip(path / "calibration", asked)
    kind = "rectified" if rectified else "raw"
    notes = [f"images: {video.relative_to(path)} ({kind})", f"camera: {source}", f"times: {_TIME}"]
    readings, said = asked.given_readings()
    if asked.joints is None:
        arms = [file.stem for file in path.glob("*.parquet") if file.stem.startswith(("PSM", "ECM"))]
        readings, said = _readings(path, chosen_arm(path, arms, asked.arm, "episode"), times)
    kept, of_kept = registrations(path / "calibration" / "hand_eye")
    with open_capture(video) as capture:
        recorded = frames_at(video, capture, times.images, len(times.left), f", one for each row of {_TIMES}")
        yield Recording(path, recorded, len(times.images), lens, readings, (*notes, *said, *of_kept), kept)


def _video(path: Path, side: Side, camera: Path | None) -> tuple[Path, bool]:
    """Return an eye's video, the raw one if there is one, and whether it is rectified."""
    raw, rectified = path / "video_raw" / f"stereo_{side}.mkv", path / "video" / f"stereo_{side}.mp4"
    if raw.is_file() or not rectified.is_file():
        check_file(raw, expected=EXPECTED)
        return raw, False
    if camera is None:
        raise InputError(
            f"{path}: --camera: expected {raw.relative_to(path)}, or the camera file of the rectified images of "
            f"{rectified.relative_to(path)}; got none"
        )
    check_file(rectified, expected=EXPECTED)
    return rectified, True


@dataclass(frozen=True)
class _Times:
    """Times of an episode, ns: ``images`` of an eye's images by row, ``left`` (N) of the left ones.

    ``against_left`` has times against those, by topic, None where a row has none.
    """

    images: Mapping[int, int]
    left: Sequence[int]
    against_left: Mapping[str, Sequence[int | None]]

    def of(self, topic: str) -> list[int]:
        """Return the times (N) of a topic; those of the left images where none are stated."""
        offs = self.against_left.get(topic, [None] * len(self.left))
        return [time + (off or 0) for time, off in zip(self.left, offs, strict=True)]


def _times(path: Path, side: Side) -> _Times:
    """Read the times of an episode, of which an image of the right eye without one is left out."""
    table, meta = path / _TIMES, path / _META
    start = 0
    if meta.is_file():
        start = _whole(meta, "master_t0_ns", read_json_object(meta, expected=f"a packed episode's {_META}"))
    of_right = f"{_AGAINST}image_right_ns"
    others = [name for name in field_names(table) if name.startswith(_AGAINST)]
    columns = read_columns(table, (_ROW, _TIME, *([of_right] if side == "right" else [])), others)
    if columns[_ROW] != list(range(len(columns[_ROW]))) or not columns[_ROW]:
        raise InputError(f"{table}: {_ROW}: expected the numbers from 0 on, got {shown(columns[_ROW][:5])}")
    left = [start + _whole(table, _TIME, {_TIME: value}) for value in columns[_TIME]]
    if any(later <= before for before, later in pairwise(left)):
        raise InputError(f"{table}: {_TIME}: expected increasing times, got others")
    against = {
        name.removeprefix(_AGAINST).removesuffix("_ns"): [
            None if off is None else _whole(table, name, {name: off}) for off in columns[name]
        ]
        for name in others
    }
    offs = against["image_right"] if side == "right" else [0] * len(left)
    pairs = enumerate(zip(left, offs, strict=True))
    return _Times({k: time + off for k, (time, off) in pairs if off is not None}, left, against)


def _readings(path: Path, arm: str, times: _Times) -> tuple[tuple[TimedReadings, ...], list[str]]:
    """Read an arm's table: a series of its joints and one of its jaw at the times of the images, and notes."""
    table = path / f"{arm}.parquet"
    columns = read_columns(table, (_ROW, _JOINTS), (_JAW,))
    if columns.pop(_ROW) != list(range(len(times.left))):
        raise InputError(f"{table}: {_ROW}: expected the {len(times.left)} rows of {_TIMES}, got others")
    taken, notes, rest = [], [], [name for name in field_names(table) if name not in (_ROW, _TIME, _JOINTS, _JAW)]
    for field, values in columns.items():
        rows = {k: _row(f"{table}: row {k}: {field}", values[k]) for k in times.images if values[k] is not None}
        if not rows:
            if field == _JOINTS:
                raise InputError(f"{table}: {field}: expected readings of the images' frames, got none")
            rest.append(field)
            continue
        names = tuple(next(iter(rows.values())))
        moments = times.of(f"{arm}.{_TOPICS[field]}")
        taken.append(at_images(str(table), names, rows, times.images, {k: moments[k] for k in rows}))
        notes.append(f"{' '.join(names)}: {arm}.parquet, {field}")
    return tuple(taken), [*notes, *([f"not taken: {listed(rest, 40)}"] if rest else [])]


def _row(where: str, value: Any) -> dict[str, float]:
    """Return the readings of a cell: a list of an arm's joints, or the jaw's."""
    if not isinstance(value, list):
        return {"jaw": joint_reading(where, "jaw", value)}
    return {
        name: joint_reading(where, name, cell)
        for name, cell in zip(joints_by_count(where, len(value)), value, strict=True)
    }


def _whole(path: Path, name: str, document: Mapping[str, Any]) -> int:
    """Return a field that is a whole number, ns."""
    value = document.get(name)
    if isinstance(value, bool) or not isinstance(value, int) or not _OLDEST < value < _LATEST:
        raise InputError(f"{path}: {name}: expected a whole number of nanoseconds, got {shown(value)}")
    return value
