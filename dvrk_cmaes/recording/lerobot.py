"""Reader of LeRobot data sets (v2.1 and v3): meta/info.json, readings by frame as parquet, a video for each camera.

The names of ``observation.state`` in info.json name its joints. The reader follows a description of the format; it has
not been tried with a real set of a dVRK.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any, Final

import numpy as np

from dvrk_cmaes.camera.fields import Side
from dvrk_cmaes.errors import InputError
from dvrk_cmaes.frames.video_frames import Video
from dvrk_cmaes.geometry import inverse
from dvrk_cmaes.instrument.inverse_kinematics import POSED_JOINTS
from dvrk_cmaes.io.json_file import read_json_object
from dvrk_cmaes.io.parquet_file import read_columns
from dvrk_cmaes.io.short_text import listed, shown
from dvrk_cmaes.joints.interpolation import NANOSECONDS, TimedReadings
from dvrk_cmaes.joints.names import joint_reading, joints_of_arm
from dvrk_cmaes.recording.camera import WITHOUT, read_camera_bytes
from dvrk_cmaes.recording.pose_table import POSE, joints_of_poses, poses_of
from dvrk_cmaes.recording.recording import Asked, Recording
from dvrk_cmaes.recording.video import images_of

_STATE: Final = "observation.state"
_ROWS: Final = ("episode_index", "frame_index", "timestamp")
_ARM: Final = re.compile(r"(?:(psm\d)[_./ ]+)?(.*)", re.IGNORECASE)
_PREFIX: Final = re.compile(r"(measured_js|outer|joint|joints)_(?=[a-z])")
_NUMBERED: Final = re.compile(r"(?:measured_js|joint|joints)_?([1-6])")
_POSED: Final = re.compile(r"(?:pose_)?(?:(?:position|pos)|(orientation|quat|quaternion))_([xyzw])")


def is_lerobot(path: Path) -> bool:
    """Whether a folder has the layout of LeRobot."""
    return (path / "meta" / "info.json").is_file() and (path / "data").is_dir()


def open_lerobot(path: Path, asked: Asked) -> Recording:
    """Open an episode of a data set; readings are read at once, images during iteration.

    Parameters
    ----------
    path
        The folder.
    asked
        The episode, eye and arm, of a set with several, and the camera file, which is required, because these sets have
        none. The times of a file of readings are those of the episode.

    Raises
    ------
    InputError
        A file or field is missing or not valid, names of the readings are not those of joints, there is no camera file,
        or an arm or eye must be chosen.
    """
    camera, episode = asked.camera, asked.episode
    if camera is None:
        raise InputError(f"{path}: --camera: expected a camera file, which these data sets lack, got none; {WITHOUT}")
    file = path / "meta" / "info.json"
    info = read_json_object(file, expected="a LeRobot data set's info.json")
    key = _video_key(file, info, asked.eye)
    table, film, start = _place(path, file, info, key, episode)
    columns = read_columns(table, _ROWS if asked.joints is not None else (*_ROWS, _STATE))
    own = [k for k, number in enumerate(columns["episode_index"]) if number == episode]
    seconds = {k: _number(table, "timestamp", columns["timestamp"][k], least=0.0) for k in own}
    at = {k: round(second * NANOSECONDS) for k, second in seconds.items()}
    rows = sorted(at, key=at.__getitem__)
    times = [at[k] for k in rows]
    if not times or any(later <= before for before, later in pairwise(times)):
        raise InputError(f"{table}: timestamp: expected increasing times of episode {episode}, got others or none")
    readings, said = asked.given_readings()
    if asked.joints is None:
        names, said = _fields(file, info, asked.arm)
        readings = _readings(table, names, times, [columns[_STATE][k] for k in rows], said[0], asked)
        said += [series.source for series in readings if series.joints == POSED_JOINTS and {*POSE} <= {*names}]
    video, fps = Video(film), _number(file, "fps", info.get("fps"))
    video.check_rate(fps, "as fps in info.json")
    first = round(start * fps)
    notes = (
        f"episode {episode}: {table.relative_to(path)}, {film.relative_to(path)} from image {first}",
        f"camera: {camera}",
        *said,
        "times: timestamp",
    )
    count, numbered = first + len(times), dict(enumerate(times, start=first))
    images = images_of(video, lambda k, _: numbered.get(k), count=count, expected=" by the readings", first=first)
    return Recording(path, images, len(times), read_camera_bytes(camera), {"": readings}, notes)


def _video_key(file: Path, info: Mapping[str, Any], side: Side) -> str:
    """Return the name of the only video, or of that of an eye."""
    features = info.get("features")
    if not isinstance(features, Mapping):
        raise InputError(f"{file}: features: expected the fields by name, got {shown(features)}")
    keys = [key for key, own in features.items() if isinstance(own, Mapping) and own.get("dtype") == "video"]
    chosen = [key for key in keys if side in re.split(r"[_./ -]", key.lower())] or keys[: len(keys) == 1]
    if len(chosen) != 1:
        raise InputError(f"{file}: features: expected one video of the {side} eye, got {listed(keys, 20) or 'none'}")
    return str(chosen[0])


def _place(path: Path, file: Path, info: Mapping[str, Any], key: str, episode: int) -> tuple[Path, Path, float]:
    """Find the table and the video of an episode, which begins there at a time, s.

    Their paths are stated in info.json, and in v3 by the tables of episodes.
    """
    version = info.get("codebase_version")
    if version == "v2.1":
        size = int(_number(file, "chunks_size", info.get("chunks_size", 1000)))
        both: dict[str, Any] = {"episode_index": episode, "episode_chunk": episode // size, "video_key": key}
        return _formatted(path, file, info, "data_path", both), _formatted(path, file, info, "video_path", both), 0.0
    if version != "v3.0":
        raise InputError(f"{file}: codebase_version: expected v2.1 or v3.0, got {shown(version)}")
    film, indices = f"videos/{key}/", ("chunk_index", "file_index")
    begin, names = f"{film}from_timestamp", [f"{part}{name}" for part in ("data/", film) for name in indices]
    for table in sorted((path / "meta" / "episodes").rglob("*.parquet")):
        columns = read_columns(table, ("episode_index", *names, begin))
        if episode in columns["episode_index"]:
            row = {name: cells[columns["episode_index"].index(episode)] for name, cells in columns.items()}
            data, video = ({name: row[f"{part}{name}"] for name in indices} for part in ("data/", film))
            of_data = _formatted(path, file, info, "data_path", data)
            of_video = _formatted(path, file, info, "video_path", {**video, "video_key": key})
            return of_data, of_video, _number(table, begin, row[begin], least=0.0)
    raise InputError(f"{path}/meta/episodes: expected episode {episode}, got none")


def _formatted(path: Path, file: Path, info: Mapping[str, Any], key: str, values: Mapping[str, Any]) -> Path:
    """Return a path by its template in info.json; it must be within the folder."""
    template = info.get(key)

    def filled(match: re.Match[str]) -> str:
        value = values.get(match[1])
        if value is None:
            raise InputError(f"{file}: {key}: expected fields {', '.join(values)}, got {shown(match[1])}")
        return f"{value:0{int(match[2] or 0)}d}" if isinstance(value, int) else str(value)

    if not isinstance(template, str):
        raise InputError(f"{file}: {key}: expected a path, got {shown(template)}")
    found = path / re.sub(r"\{(\w+)(?::0(\d)d)?\}", filled, template)
    if "\0" in str(found) or not found.resolve().is_relative_to(path.resolve()):
        raise InputError(f"{file}: {key}: expected a path within the folder, got {shown(template)}")
    return found


def _fields(file: Path, info: Mapping[str, Any], arm: str | None) -> tuple[dict[str, int], list[str]]:
    """Return the place in observation.state of each joint of an arm, and notes on what was taken and what not."""
    feature = info["features"].get(_STATE)
    names = feature.get("names") if isinstance(feature, Mapping) else None
    if isinstance(names, Mapping) and len(names) == 1:
        names = next(iter(names.values()))
    if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
        raise InputError(f"{file}: features: {_STATE}: names: expected a list of names, got {shown(names)}")
    split = [_joint(name) for name in names]
    known = [k for k, (_, joint) in enumerate(split) if joint]
    if not known:
        raise InputError(f"{file}: {_STATE}: expected names of joints such as PSM1.yaw, got {listed(names, 40)}")
    arms = dict.fromkeys(split[k][0] for k in known)
    if (arm is None and len(arms) > 1) or (arm is not None and arm.upper() not in arms):
        expected = listed(own or "without a name" for own in arms)
        raise InputError(f"{file}: --arm: expected one of {expected}, got {arm}")
    chosen = next(iter(arms)) if arm is None else arm.upper()
    own = [k for k in known if split[k][0] == chosen]
    places = joints_of_arm(f"{file}: {_STATE}", [split[k][1] for k in own], (*POSED_JOINTS, "jaw", *POSE))
    taken = {joint: own[place] for joint, place in places.items()}
    posed = {*POSE} <= {*taken} and not {*POSED_JOINTS} & {*taken}
    taken = {name: k for name, k in taken.items() if posed or name not in POSE}
    said = [f"{_STATE} ({chosen})" if chosen else _STATE, *(f"{j}: {names[k]}" for j, k in taken.items())]
    others = listed([name for k, name in enumerate(names) if k not in taken.values()], 40)
    return taken, [*said, *([f"not taken: {others}"] if others else [])]


def _joint(name: str) -> tuple[str, str]:
    """Return the arm, upper case or empty, and the joint or the part of its pose that a name means, empty for none."""
    match = _ARM.fullmatch(name)
    arm, rest = (match[1] or "", match[2]) if match else ("", name)
    plain = re.sub(r"[./ -]+", "_", rest.lower()).removesuffix("_pos")
    if (posed := _POSED.fullmatch(plain)) is not None:
        return arm.upper(), f"{'q' if posed[1] else ''}{posed[2]}"
    if (numbered := _NUMBERED.fullmatch(plain)) is not None:
        return arm.upper(), POSED_JOINTS[int(numbered[1]) - 1]
    plain = _PREFIX.sub("", _PREFIX.sub("", plain, count=1), count=1)
    return arm.upper(), plain if plain in (*POSED_JOINTS, "jaw") else ""


def _readings(
    path: Path, names: Mapping[str, int], times: Sequence[int], states: Sequence[Any], source: str, asked: Asked
) -> tuple[TimedReadings, ...]:
    """Return the readings of the rows of an episode; those of the arm's poses are found by inverse kinematics."""
    values, wheres = [], [f"{path}: row {k}: {_STATE}" for k in range(len(states))]
    for where, state in zip(wheres, states, strict=True):
        if not isinstance(state, list) or len(state) <= max(names.values()):
            raise InputError(
                f"{where}: expected a list of at least {max(names.values()) + 1} numbers, got {shown(state)}"
            )
        values.append([joint_reading(where, name, state[place]) for name, place in names.items()])
    joints, table = [k for k, name in enumerate(names) if name not in POSE], np.array(values)
    series = [TimedReadings.of(source, tuple(name for name in names if name not in POSE), times, table[:, joints])]
    if len(joints) < len(names):
        posed = table[:, [list(names).index(name) for name in POSE]]
        point, base, arm, tool = asked.posed or ("tip", np.eye(4), "classic", None)
        found, said = joints_of_poses(path, inverse(base) @ poses_of(wheres, posed), point, arm, tool)
        said += "" if asked.posed else "; taken in its base (local/measured_cp), --pose-base says otherwise"
        series.insert(0, TimedReadings.of(f"{source}, {said}", POSED_JOINTS, times, found))
    return tuple(own for own in series if own.joints)


def _number(path: Path, key: str, value: Any, least: float = 1.0) -> float:
    """Return a finite number of at least ``least``; InputError for anything else."""
    if isinstance(value, bool) or not isinstance(value, int | float) or not least <= value < 1e9:
        raise InputError(f"{path}: {key}: expected a number of at least {least:g}, got {shown(value)}")
    return float(value)
