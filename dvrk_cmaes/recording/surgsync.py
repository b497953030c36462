"""Reader of clips in the raw layout of SurgSync, the dVRK's recorder of synchronised images and kinematics.

Frame N of a clip has the files::

    image/left/N.png, image/right/N.png
    kinematic/ARM/N.json     readings of the arm (measured_js) and of its jaw
    time_syn/N.json          times of the image and of the readings

``camera_calibration`` has left.yaml and right.yaml, and in stereo_calib_params.json the pose between them, which is
used where right.yaml states none.
The recorder takes the readings that are nearest in time to each image; here they are interpolated between those of
neighbouring frames to the image's time.

A packed episode has readings and times by frame as parquet, and a video for each camera. Its folder,
``RELEASE/DATASET/episodes/TASK/CLIP``, has the files::

    timestamp.parquet            times of the left images, and of all else against these
    PSM1.parquet, PSM2.parquet   readings of an arm and of its jaw
    video_raw/stereo_left.mkv    raw images (FFV1); video/stereo_left.mp4 are rectified ones
    calibration/left.yaml        the cameras of the raw images, and the pose between them
    episode_meta.json            the time of the first image

The reader follows the schemas that the recorder's authors publish; it has not been tried with a released episode.

The online and the offline recorder nest the fields of JSON files differently (e.g. ``jaw`` beside ``arm`` or inside
it), so that a field is searched for by its name, at the outermost level first.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any, Final

import numpy as np

from dvrk_cmaes.camera.files import Side, read_document
from dvrk_cmaes.camera.stereo import has_pose, pose_of_storage
from dvrk_cmaes.errors import InputError
from dvrk_cmaes.frames.images import read_image_file
from dvrk_cmaes.frames.video_frames import Video
from dvrk_cmaes.io.json_file import read_json, read_json_object
from dvrk_cmaes.io.parquet_file import field_names, read_columns
from dvrk_cmaes.io.short_text import listed, shown
from dvrk_cmaes.io.yaml_file import yaml_text
from dvrk_cmaes.joints.interpolation import NANOSECONDS, TimedReadings, weighted_mean
from dvrk_cmaes.joints.names import ECM_JOINTS, joint_reading, joints_by_count
from dvrk_cmaes.joints.times import parse_stamp, parse_time
from dvrk_cmaes.recording.camera import read_camera_bytes
from dvrk_cmaes.recording.recording import Asked, RecordedImage, Recording, Rows, listed_readings
from dvrk_cmaes.recording.video import images_of

Times = Mapping[int, int]
"""Times, ns, by the number of the frame."""

_TIMES = "the times of a frame (time_syn, JSON)"
_KINEMATICS = "the readings of an arm (kinematic, JSON)"


def read_times(path: Path, side: Side, arm: str | None) -> tuple[int, int, int]:
    """Read ``time_syn/N.json``: the times of a camera's image, of an arm's readings, and of those of its jaw, ns.

    Where the times of readings are not stated, they are those of the image.

    Raises
    ------
    InputError
        The file is not readable or states no time of the image; the message names it and the field.
    """
    document = read_json(path, expected=_TIMES)
    image = _time(str(path), document, f"image_{side}_stamp", f"image_{side}", side, "timestamp")
    if image is None:
        raise InputError(f"{path}: image_{side}_stamp: expected the image's time (sec, nsec), got none")
    of_arm = None if arm is None else _field(document, arm)
    taken = _time(str(path), of_arm, "measured_js_stamp", "measured_js") or image
    of_jaw = _time(str(path), _field(of_arm, "jaw"), "measured_stamp", "measured_js_stamp", "measured_js")
    return image, taken, of_jaw or taken


def read_positions(path: Path, joints: tuple[str, ...] = ()) -> dict[str, float]:
    """Read ``kinematic/ARM/N.json``: the positions of the arm's joints and, where it is stated, of its jaw, rad or m.

    ``joints`` are those of an arm without a jaw, as the endoscope's; without any, their number says which they are.

    Raises
    ------
    InputError
        The file is not readable, or has no measured_js, or one of another number of joints, or a wrong number.
    """
    where, document = str(path), read_json(path, expected=_KINEMATICS)
    measured = _field(document, "measured_data") or document
    values = _position(_field(measured, "measured_js") or _field(measured, "js"))
    if values is None:
        raise InputError(f"{path}: measured_js: expected an object with position, a list of numbers, got none")
    if joints and len(values) != len(joints):
        raise InputError(
            f"{path}: measured_js: expected the positions of {', '.join(joints)}, got {len(values)} of them"
        )
    names = joints or joints_by_count(f"{where}: measured_js", len(values))
    cells = dict(zip(names, values, strict=True))
    jaw = _field(document, "jaw")
    opening = _position(_field(jaw, "measured_data") or _field(jaw, "measured_js") or jaw)
    if opening and not joints:
        cells["jaw"] = opening[0]
    return {name: joint_reading(where, name, cell) for name, cell in cells.items()}


def _field(document: Any, name: str) -> Any:
    """Return the outermost value of a name in nested objects and lists; None if there is none."""
    level = [document]
    while level:
        for value in level:
            if isinstance(value, dict) and name in value:
                return value[name]
        nested = (own.values() if isinstance(own, dict) else own for own in level if isinstance(own, dict | list))
        level = [inner for values in nested for inner in values]
    return None


def _position(value: Any) -> list[Any] | None:
    """Return the list of positions of a JointState, or a list as it is; None for other values."""
    position = value.get("position") if isinstance(value, dict) else value
    return position if isinstance(position, list) else None


def _time(where: str, document: Any, *names: str) -> int | None:
    """Return the time, ns, under the first of some names that has one; None if none has, or it is zero."""
    for name in names:
        value = _field(document, name)
        if (stamp := parse_stamp(f"{where}: {name}", value)) is not None:
            return stamp
        if isinstance(value, str | int | float) and not isinstance(value, bool):
            # the name of the recorder's folder, SECONDS_NANOSECONDS, without leading zeros
            first, underscore, last = str(value).partition("_")
            return parse_time(f"{where}: {name}", f"{first}.{last:0>9}" if underscore else value)
    return None


_STAMPS: Final = "timestamp.parquet"
_META: Final = "episode_meta.json"
_ROW: Final = "frame_index"
_TIME: Final = "master_timestamp_ns"
_JOINTS: Final = "measured_js.position"
_JAW: Final = "jaw.measured_position"
_TOPICS: Final = {_JOINTS: "measured_js", _JAW: "jaw_measured"}
"""Topics whose times against the left image are those of a field."""
_AGAINST: Final = "delta_to_master."
_LEFT: Final = "image_left"
_OLDEST, _LATEST = -(2**62), 2**62  # ns


def is_packed(path: Path) -> bool:
    """Whether a folder is a packed episode, or a release of them."""
    return (path / _STAMPS).is_file() or ((path / "meta" / "dataset.json").is_file() and any(path.glob("*/episodes")))


def open_packed(path: Path, asked: Asked) -> Recording:
    """Open an episode; times and readings are read at once, images during iteration.

    Parameters and errors are those of `open_surgsync`; rectified images need a camera file.
    """
    if not (path / _STAMPS).is_file():
        episodes = sorted(found.parent.relative_to(path).as_posix() for found in path.glob(f"*/episodes/*/*/{_STAMPS}"))
        raise InputError(f"{path}: expected the folder of one episode, one of {listed(episodes) or 'none'}")
    video, kind = _video(path, asked.eye, asked.camera)
    images, taken = _times(path, asked.eye)
    lens, source = camera_of_clip(path / "calibration", asked)
    notes = [f"images: {video.path.relative_to(path)} ({kind})", f"camera: {source}", f"times: {_TIME}"]
    readings, said = asked.given_readings()
    if asked.joints is None:
        arms = [file.stem for file in path.glob("*.parquet") if file.stem.startswith(("PSM", "ECM"))]
        readings, said = _readings(path, chosen_arm(path, arms, asked.arm, "episode"), images, taken)
    expected = f", one for each row of {_STAMPS}"
    recorded = images_of(video, lambda k, _: images.get(k), count=len(taken[_LEFT]), expected=expected)
    return Recording(path, recorded, len(images), lens, {"": readings}, (*notes, *said))


def _video(path: Path, side: Side, camera: Path | None) -> tuple[Video, str]:
    """Return an eye's video, the raw one if there is one, and what its images are."""
    raw, rectified = path / "video_raw" / f"stereo_{side}.mkv", path / "video" / f"stereo_{side}.mp4"
    if raw.is_file() or not rectified.is_file():
        return Video(raw), "raw"
    if camera is None:
        raise InputError(
            f"{path}: --camera: expected {raw.relative_to(path)}, or the camera file of the rectified images of "
            f"{rectified.relative_to(path)}; got none"
        )
    return Video(rectified), "rectified"


def _times(path: Path, side: Side) -> tuple[dict[int, int], dict[str, list[int]]]:
    """Read the times of an episode, ns: of an eye's images by row, without those that have none, and by topic.

    A topic without a time in a row has that of the left image there.
    """
    table, meta = path / _STAMPS, path / _META
    said = read_json_object(meta, expected=f"a packed episode's {_META}") if meta.is_file() else {"master_t0_ns": 0}
    start = _whole(meta, "master_t0_ns", said.get("master_t0_ns"))
    of_right = f"{_AGAINST}image_right_ns"
    others = [name for name in field_names(table) if name.startswith(_AGAINST)]
    columns = read_columns(table, (_ROW, _TIME, *([of_right] if side == "right" else [])), others)
    if columns[_ROW] != list(range(len(columns[_ROW]))) or not columns[_ROW]:
        raise InputError(f"{table}: {_ROW}: expected the numbers from 0 on, got {shown(columns[_ROW][:5])}")
    left = [start + _whole(table, _TIME, value) for value in columns[_TIME]]
    if any(later <= before for before, later in pairwise(left)):
        raise InputError(f"{table}: {_TIME}: expected increasing times, got others")
    taken = {_LEFT: left}
    for name in others:
        offs = (0 if off is None else _whole(table, name, off) for off in columns[name])
        taken[name.removeprefix(_AGAINST).removesuffix("_ns")] = [t + off for t, off in zip(left, offs, strict=True)]
    seen = taken["image_right" if side == "right" else _LEFT]
    there = columns[of_right] if side == "right" else left
    return {k: time for k, time in enumerate(seen) if there[k] is not None}, taken


def _readings(
    path: Path, arm: str, images: Times, times: Mapping[str, list[int]]
) -> tuple[tuple[TimedReadings, ...], list[str]]:
    """Read an arm's table: a series of its joints and one of its jaw at the times of the images, and notes."""
    table = path / f"{arm}.parquet"
    columns = read_columns(table, (_ROW, _JOINTS), (_JAW,))
    if columns.pop(_ROW) != list(range(len(times[_LEFT]))):
        raise InputError(f"{table}: {_ROW}: expected the {len(times[_LEFT])} rows of {_STAMPS}, got others")
    taken, notes, rest = [], [], [name for name in field_names(table) if name not in (_ROW, _TIME, _JOINTS, _JAW)]
    for field, values in columns.items():
        rows = {k: listed_readings(f"{table}: row {k}: {field}", values[k]) for k in images if values[k] is not None}
        if not rows:
            if field == _JOINTS:
                raise InputError(f"{table}: {field}: expected readings of the images' frames, got none")
            rest.append(field)
            continue
        names = tuple(next(iter(rows.values())))
        moments = times.get(f"{arm}.{_TOPICS[field]}", times[_LEFT])
        taken.append(at_images(str(table), names, rows, images, {k: moments[k] for k in rows}))
        notes.append(f"{' '.join(names)}: {arm}.parquet, {field}")
    return tuple(taken), [*notes, *([f"not taken: {listed(rest, 40)}"] if rest else [])]


def _whole(path: Path, name: str, value: Any) -> int:
    """Return the value of a field that is a whole number, ns."""
    if isinstance(value, bool) or not isinstance(value, int) or not _OLDEST < value < _LATEST:
        raise InputError(f"{path}: {name}: expected a whole number of nanoseconds, got {shown(value)}")
    return value


ECM: Final = "ECM"
"""Name of the arm that holds the endoscope."""

_CAMERAS: Final = "camera_calibration"
_STEREO: Final = "stereo_calib_params.json"
_FARTHEST: Final = NANOSECONDS // 20  # of the readings of a frame from its image
_WIDEST_GAP: Final = NANOSECONDS // 4  # between readings that are interpolated
_IMAGES: Final = (".png", ".jpg")


def is_surgsync(path: Path) -> bool:
    """Whether a folder has the raw layout."""
    return (path / "image").is_dir() and (path / "kinematic").is_dir()


def open_surgsync(path: Path, asked: Asked) -> Recording:
    """Open a clip; times and readings are read at once, images during iteration.

    Parameters
    ----------
    path
        The clip's folder.
    asked
        What is read; an arm is required of a clip of several patient-side arms.

    Raises
    ------
    InputError
        A file is missing or not valid, or several arms were recorded and none was chosen.
    """
    side, images = asked.eye, _images(path, asked.eye)
    camera_bytes, source = camera_of_clip(path / _CAMERAS, asked)
    arms = [folder.name for folder in (path / "kinematic").iterdir() if folder.is_dir()]
    chosen = None if asked.joints is not None else chosen_arm(path, arms, asked.arm, "clip")

    def times_of(arm: str | None) -> dict[int, tuple[int, int, int]]:
        """Return the times of the images, and of an arm's readings and its jaw's, by frame."""
        return {number: read_times(path / "time_syn" / f"{number}.json", side, arm) for number in images}

    times, folder = times_of(chosen), path / "kinematic"
    notes = [f"images: image/{side}", f"camera: {source}", "times: those of the images in time_syn"]
    readings, said = asked.given_readings()
    notes += said
    if chosen is not None:
        readings = _readings_of_clip(folder / chosen, times)
        notes += [f"{' '.join(series.joints)}: kinematic/{chosen}" for series in readings]
        if chosen != ECM and (folder / ECM).is_dir():
            try:
                readings += _readings_of_clip(folder / ECM, times_of(ECM), ECM_JOINTS)
                notes.append(f"{' '.join(ECM_JOINTS)}: kinematic/{ECM}")
            except InputError as error:
                notes.append(f"the endoscope's arm is not read: {error}")
    recorded = (RecordedImage(k, times[k][0], partial(_load, file)) for k, file in images.items())
    return Recording(path, recorded, len(images), camera_bytes, {"": readings}, tuple(notes))


def camera_of_clip(folder: Path, asked: Asked) -> tuple[bytes, str]:
    """Read the given camera file or that of an eye in a clip's folder, and say what was read.

    To that of a right eye without a pose, the one between the eyes is added.
    """
    lens, stereo = asked.camera or folder / f"{asked.eye}.yaml", folder / _STEREO
    data = read_camera_bytes(lens)
    right = {} if asked.camera is not None or asked.eye == "left" or not stereo.is_file() else read_document(lens)
    if not right or has_pose(str(lens), right):
        return data, str(lens)
    pose, notes = pose_of_storage(str(stereo), read_document(stereo), rectified=False)
    right = {**right, "right_from_left": pose.tolist()}  # of raw cameras
    return yaml_text(right).encode(), "; ".join([f"{lens}, pose between the eyes: {stereo}", *notes])


def _images(path: Path, side: Side) -> dict[int, Path]:
    """Find the images of a camera by frame number, in order; InputError if there are none."""
    folder = path / "image" / side
    files = [file for file in folder.iterdir() if file.suffix.lower() in _IMAGES] if folder.is_dir() else []
    images = {int(file.stem): file for file in files if file.stem.isascii() and file.stem.isdigit()}
    if not images:
        raise InputError(f"{folder}: expected images N.png, got none")
    return dict(sorted(images.items()))


def _load(file: Path) -> bytes:
    """Read an image; its file is copied unchanged."""
    return read_image_file(file, "an image")[0]


def chosen_arm(path: Path, arms: Sequence[str], arm: str | None, what: str) -> str:
    """Return the requested arm, or the only patient-side one of a clip or episode."""
    if arm is not None and arm not in arms:
        raise InputError(f"{path}: --arm: expected one of {listed(sorted(arms)) or 'no arms'}, got {shown(arm)}")
    patient_side = sorted(name for name in arms if name.startswith("PSM"))
    if arm is None and len(patient_side) != 1:
        there = listed(patient_side) or "none"
        raise InputError(f"{path}: --arm: expected the name of the arm to import, for this {what} has {there}")
    return arm or patient_side[0]


def _readings_of_clip(
    folder: Path, times: Mapping[int, tuple[int, int, int]], joints: tuple[str, ...] = ()
) -> tuple[TimedReadings, ...]:
    """Read the readings of an arm in all frames, at the images' times, ns: those of its joints and those of the jaw."""
    rows = {number: read_positions(file, joints) for number in times if (file := folder / f"{number}.json").is_file()}
    if not rows:
        raise InputError(f"{folder}: expected readings N.json of the images' numbers, got none")
    images, of_arm, of_jaw = ({number: own[k] for number, own in times.items()} for k in range(3))
    first = next(iter(rows.values()))
    parts = (tuple(name for name in first if name != "jaw"), of_arm), (tuple({"jaw"} & {*first}), of_jaw)
    return tuple(at_images(str(folder), joints, rows, images, taken) for joints, taken in parts if joints)


def at_images(source: str, joints: tuple[str, ...], rows: Rows, images: Times, taken: Times) -> TimedReadings:
    """Interpolate readings that were ``taken`` near the images' times, ns, to these; where not possible, keep them.

    Readings that are farther from their image than the recorder allows are omitted.
    """
    values = {
        number: [row[name] for name in joints]
        for number, row in rows.items()
        if set(joints) <= set(row) and abs(taken[number] - images[number]) <= _FARTHEST
    }
    if not values:
        away = min(abs(taken[number] - images[number]) for number in rows) / NANOSECONDS
        raise InputError(
            f"{source}: {', '.join(joints)}: expected readings within {_FARTHEST / NANOSECONDS:g} s of the images, "
            f"got none; the nearest is {away:.6g} s away"
        )
    own, at = np.array(list(values.values())), np.array([images[number] for number in values], dtype=np.int64)
    series = TimedReadings.of(source, joints, [taken[number] for number in values], own)
    found = series.at(at, weighted_mean, away=_WIDEST_GAP)
    return TimedReadings.of(source, joints, at, np.where(np.isnan(found), own, found))
