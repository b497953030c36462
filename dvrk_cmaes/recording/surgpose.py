"""Reader of folders of SurgPose, a set of stereo videos of two arms with labelled points.

A folder has the files::

    regular/left_video.mp4, regular/right_video.mp4     30 images a second, not rectified
    api_jp_data.yaml                                    {frame: {arm: six joints, rad and m}}
    StereoCalibrationDVRK.ini                           both cameras and the pose between them
    keypoints_left.yaml, keypoints_right.yaml           {frame: {number: [x, y] or null}}, px; may be missing
    ../gripper_angle.yaml                               {folder: {arm: jaw of each frame, rad}}; may be missing
    bbox_left.json, bbox_right.json                     {frame: {id: [x, y, width, height]}}, px; may be missing

Frame N is image N of the videos, from zero. The reader follows a description of this layout; it has not been tried with
the set itself. The session gets the labels of the arm as markers.csv, and boxes.csv.

Of the labels' numbers, 1 to 7 are on PSM1 and 8 to 14 on PSM3. Boxes are of numbered tools: the box of an arm is that
with most of its labels.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np

from dvrk_cmaes.camera.fields import Side, as_number
from dvrk_cmaes.errors import InputError
from dvrk_cmaes.frames.video_frames import Video, frame_name
from dvrk_cmaes.io.csv_file import csv_text
from dvrk_cmaes.io.json_file import read_json_object
from dvrk_cmaes.io.short_text import shown
from dvrk_cmaes.io.yaml_file import read_yaml_by_frame
from dvrk_cmaes.joints.interpolation import NANOSECONDS, TimedReadings
from dvrk_cmaes.joints.names import joint_reading
from dvrk_cmaes.recording.camera import read_camera_bytes, read_stereo_ini
from dvrk_cmaes.recording.recording import Asked, Recording, listed_readings, series_of_rows
from dvrk_cmaes.recording.surgsync import chosen_arm
from dvrk_cmaes.recording.video import images_of

Labels = dict[int, dict[str, tuple[float, float]]]
"""Pixels (u, v) by the label's number, as text, in each frame."""

Box = tuple[float, float, float, float]
"""Left, top, right, bottom, px."""

_NUMBERS: Final[Mapping[str, range]] = {"PSM1": range(1, 8), "PSM3": range(8, 15)}
_ALL: Final = range(1, 15)


def arm_labels(path: Path, rows: Mapping[int, Any], arm: str) -> Labels:
    """Return the labels of an arm from a document's values by frame; points that are null are left out.

    Raises
    ------
    InputError
        Naming the frame and the label, and what was expected.
    """
    own = _NUMBERS.get(arm, range(0))
    labels: Labels = {}
    for frame, row in _given(path, rows, "points by number"):
        for name, value in row.items():
            number = as_number(name)
            if number is None or number not in _ALL:
                raise InputError(f"{path}: frame {frame}: expected numbers of labels, 1 to 14, got {shown(name)}")
            if value is not None and number in own:
                where = f"{path}: frame {frame}: label {int(number)}"
                u, v = _numbers(where, value, 2, "[x, y] in pixels or null")
                labels.setdefault(frame, {})[str(int(number))] = (u, v)
    return labels


def arm_boxes(path: Path, rows: Mapping[int, Any], labels: Labels) -> dict[int, Box]:
    """Return the box with most of an arm's labels in each frame that has one; errors as in ``arm_labels``."""
    boxes: dict[int, Box] = {}
    for frame, row in _given(path, rows, "boxes by id"):
        points = np.array(list(labels.get(frame, {}).values())).reshape(-1, 2)
        most = 0
        for name, value in row.items():
            if value is None:
                continue
            expected = "[x, y, width, height] in pixels or null"
            x, y, width, height = _numbers(f"{path}: frame {frame}: box {shown(name)}", value, 4, expected)
            inside = int(((points >= [x, y]) & (points <= [x + width, y + height])).all(axis=1).sum())
            if width > 0 and height > 0 and inside > most:
                most, boxes[frame] = inside, (x, y, x + width, y + height)
    return boxes


def _given(path: Path, rows: Mapping[int, Any], expected: str) -> Iterator[tuple[int, Mapping[Any, Any]]]:
    """Yield the frames that have something, with what they have by name; InputError otherwise."""
    for frame, row in rows.items():
        if row is not None and not isinstance(row, Mapping):
            raise InputError(f"{path}: frame {frame}: expected {expected}, got {shown(row)}")
        if row is not None:
            yield frame, row


def _numbers(where: str, value: Any, count: int, expected: str) -> list[float]:
    """Return a list of finite numbers; InputError otherwise."""
    numbers = [as_number(each) for each in value] if isinstance(value, list) else []
    found = [number for number in numbers if number is not None and np.isfinite(number)]
    if len(numbers) != count or len(found) != count:
        raise InputError(f"{where}: expected {expected}, got {shown(value)}")
    return found


_VIDEOS: Final = "regular"
_READINGS: Final = "api_jp_data.yaml"
_JAW: Final = "gripper_angle.yaml"
_CALIBRATION: Final = "StereoCalibrationDVRK.ini"
_RATE: Final = 30  # images a second, to which the frames of the other files refer


def is_surgpose(path: Path) -> bool:
    """Whether a folder has the layout of SurgPose."""
    return (path / _VIDEOS).is_dir() and (path / _READINGS).exists()


def open_surgpose(path: Path, asked: Asked) -> Recording:
    """Open a folder; readings and labels are read at once, images during iteration.

    Parameters
    ----------
    path
        The folder.
    asked
        What is read. The time of the first image is 0 in that of a file of readings.

    Raises
    ------
    InputError
        A file is missing or not valid, the video has not 30 images a second or another size than the camera, or several
        arms were recorded and none was chosen.
    """
    rows = _by_frame(path / _READINGS, read_yaml_by_frame(path / _READINGS, expected="joints by frame (YAML)"))
    first, side, camera = next(iter(rows.values()), None), asked.eye, asked.camera
    if not isinstance(first, Mapping) or not first:
        expected = "joints by the name of the arm in each frame"
        raise InputError(f"{path / _READINGS}: expected {expected}, got {shown(first)}")
    chosen = chosen_arm(path, [str(name) for name in first], asked.arm, "folder")
    if asked.joints is None:
        readings, source = _readings(path / _READINGS, rows, chosen), f"{_READINGS}, {chosen}"
        jaw, of_jaw = _jaw(path, chosen) if "jaw" not in readings[0].joints else ((), [])
        readings += jaw
    else:
        (readings, of_jaw), source = asked.given_readings(), ""
    stereo = path / _CALIBRATION
    lens, of_camera = read_stereo_ini(stereo, side) if camera is None else (read_camera_bytes(camera), ())
    kept, of_labels = _labels(path, side, chosen)
    video = Video(path / _VIDEOS / f"{side}_video.mp4")
    video.check_rate(_RATE, "which labels and readings count")
    notes = [
        f"images: {_VIDEOS}/{video.path.name}, taken for raw ones",
        f"camera: {camera or _CALIBRATION}",
        *(f"camera: {note}" for note in of_camera),
        *(f"{' '.join(series.joints)}: {source}" for series in readings if source and series.joints != ("jaw",)),
        *of_jaw,
        f"times: frame N at N/{_RATE} s",
        *of_labels,
    ]
    if asked.joints is None and video.stated not in (None, len(rows)):
        notes.append(f"{_READINGS} has {len(rows)} frames, the video {video.stated}")
    images = images_of(video, lambda number, _: _time(number))
    return Recording(path, images, video.stated, lens, {"": readings}, tuple(notes), kept)


def _by_frame(path: Path, document: Any) -> dict[int, Any]:
    """Return the values of a document by the number of the frame, in order; a list begins with frame 0."""
    if isinstance(document, list):
        return dict(enumerate(document))
    rows = {}
    for key, value in document.items():
        text = str(key)
        if not (text.isascii() and text.isdigit()) or len(text) > 9:
            raise InputError(f"{path}: {shown(key)}: expected the number of a frame")
        rows[int(text)] = value
    return dict(sorted(rows.items()))


def _readings(path: Path, rows: Mapping[int, Any], arm: str) -> tuple[TimedReadings, ...]:
    """Return the readings of an arm; a frame without a value has none."""
    found = {}
    for number, row in rows.items():
        own, where = row.get(arm) if isinstance(row, Mapping) else row, f"{path}: frame {number}: {arm}"
        if own is not None and not isinstance(own, list):
            raise InputError(f"{where}: expected a list of joints, got {shown(own)}")
        if own is not None:
            found[number] = listed_readings(where, own)
    return (series_of_rows(f"{path.name} ({arm})", found, _time),)


def _jaw(path: Path, arm: str) -> tuple[tuple[TimedReadings, ...], list[str]]:
    """Return the readings of an arm's jaw in the file beside the folders, where there are some, and notes on them."""
    file = next((place / _JAW for place in (path, path.resolve().parent) if (place / _JAW).exists()), None)
    if file is None:
        return (), [f"jaw: not read, for there is no {_JAW} in the folder or beside it"]
    document = read_yaml_by_frame(file, expected="jaw angles by folder and arm (YAML)")
    folders = {str(key): value for key, value in document.items()} if isinstance(document, Mapping) else {}
    own = folders.get(path.resolve().name, folders if arm in folders else None)
    found = own.get(arm) if isinstance(own, Mapping) else None
    if found is None:
        return (), [f"jaw: not read, for {file.name} has none of {arm} in {path.resolve().name}"]
    if not isinstance(found, list | Mapping) or not found:
        raise InputError(f"{file}: {path.resolve().name}: {arm}: expected the jaw of each frame, got {shown(found)}")
    by_frame = _by_frame(file, found)
    rows = {n: {"jaw": joint_reading(f"{file}: {arm}: frame {n}", "jaw", cell)} for n, cell in by_frame.items()}
    series = series_of_rows(f"{file.name} ({arm})", rows, _time)
    return (series,), [f"jaw: {file.name}, {arm}"]


def _labels(path: Path, side: Side, arm: str) -> tuple[dict[str, bytes], list[str]]:
    """Return markers.csv and boxes.csv of an arm, where the folder has labels and boxes, and notes on them."""
    kept: dict[str, bytes] = {}
    notes: list[str] = []
    labels: Labels = {}
    file = path / f"keypoints_{side}.yaml"
    if file.exists():
        labels = arm_labels(file, _by_frame(file, read_yaml_by_frame(file, expected="labels by frame (YAML)")), arm)
        marked = [(frame_name(k), name, *pixel) for k, own in labels.items() for name, pixel in own.items()]
        kept["markers.csv"] = csv_text(("frame", "marker", "u", "v"), marked).encode()
        notes.append(f"labels of {arm}: {file.name}, {len(marked)} points, kept in markers.csv")
    file = path / f"bbox_{side}.json"
    if file.exists():
        document = _by_frame(file, read_json_object(file, expected="boxes by frame (JSON)"))
        boxes = [(frame_name(k), *box) for k, box in arm_boxes(file, document, labels).items()]
        kept["boxes.csv"] = csv_text(("frame", "x0", "y0", "x1", "y1"), boxes).encode()
        notes.append(f"boxes of {arm}: {file.name}, in {len(boxes)} frames that which has most of its labels")
    return kept, notes


def _time(number: int) -> int:
    """Return the time of a frame, ns after the first."""
    return round(number * NANOSECONDS / _RATE)
