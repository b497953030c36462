"""Inspection of videos and LeRobot data sets: sizes, counts, rates, clocks, and the command that reads them."""

from __future__ import annotations

import math
import shlex
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import cv2

from dvrk_cmaes.errors import InputError
from dvrk_cmaes.frames.video_frames import open_capture
from dvrk_cmaes.inspection.finding import Finding, counted
from dvrk_cmaes.io.json_file import read_json_object
from dvrk_cmaes.io.short_text import listed

LEROBOT = Path("meta") / "info.json"
"""The file of a LeRobot data set by which it is known."""

_BOTH_EYES = 2.2  # width by height of a video, from which on it is likely to show both eyes beside each other
_STACKED = 0.9  # the same, below which they are likely to be above each other


def next_command(*words: object) -> str:
    """Say which command to type next."""
    return f"next: dvrk-cmaes {shlex.join(map(str, words))}"


def inspect_video(path: Path) -> Finding:
    """Describe a video by its size, its number of images and its rate; InputError if it cannot be decoded."""
    with open_capture(path) as capture:
        width, height, count = (
            int(capture.get(each))
            for each in (cv2.CAP_PROP_FRAME_WIDTH, cv2.CAP_PROP_FRAME_HEIGHT, cv2.CAP_PROP_FRAME_COUNT)
        )
        rate, decoded = float(capture.get(cv2.CAP_PROP_FPS)), capture.read()[0]
    if not decoded or min(width, height) < 1:
        raise InputError(f"{path}: expected a video whose images can be decoded, got another file, or a damaged one")
    known = math.isfinite(rate) and rate > 0 and count > 0
    beside = {name: path.parent / name for name in ("camera.yaml", "joints.csv") if (path.parent / name).is_file()}
    lines = [f"{width} x {height} px, {counted(count, 'image') if count > 0 else 'images that are not counted'}"]
    if known:
        lines[0] += f", {rate:.2f} a second, {count / rate:.1f} s"
    lines.append("clock: its images are counted from 0 s on; --video-start is that of the first on the readings' clock")
    notes = []
    if width >= _BOTH_EYES * height or width < _STACKED * height:
        layout = "side-by-side" if width > height else "top-bottom"
        notes.append(f"of this shape it may show both eyes: then give --layout {layout}")
    if len(beside) == 2:
        lines.append(f"taken for a recording: {' and '.join(beside)} are beside it")
        lines.append(next_command("track", path))
    else:
        options = [word for name in ("camera.yaml", "joints.csv") for word in (f"--{name.split('.')[0]}", name)]
        lines.append(f"a camera file is needed, and readings{f'; beside it is {listed(beside)}' if beside else ''}")
        lines.append(next_command("import", path, *options, "--out", "session"))
    read = {"width": width, "height": height, "images": count if count > 0 else None, "rate": rate if known else None}
    return Finding("video", tuple(lines), read, tuple(notes))


def inspect_lerobot(path: Path) -> Finding:
    """Describe a LeRobot data set by its meta/info.json; InputError if that has not the fields."""
    file = path / LEROBOT
    info = read_json_object(file, expected="what a LeRobot data set has (meta/info.json)")
    features = info.get("features")
    if not isinstance(features, dict):
        raise InputError(f"{file}: features: expected an object, got {type(features).__name__}")
    videos = {key: size for key, each in features.items() if (size := _video_size(each)) is not None}
    state = features.get("observation.state")
    names = _names(state.get("names")) if isinstance(state, Mapping) else []
    rate, version = info.get("fps"), str(info.get("codebase_version", "without a version"))[:40]
    counts = {name: info.get(f"total_{name}") for name in ("episodes", "frames")}
    lines = (
        f"codebase {version}, {', '.join(f'{name} {_number(value)}' for name, value in counts.items())}",
        f"videos: {listed(f'{key} ({size})' for key, size in videos.items()) or 'none'}, {_number(rate)} a second",
        f"readings, a row a frame: {listed(names) or 'none that are named'}",
        "clock: timestamp, s, of images and readings alike",
        "no camera file: --camera is needed",
        next_command("import", path, "--episode", 0, "--camera", "camera.yaml", "--out", "session"),
    )
    return Finding("LeRobot data set", lines, {"fps": rate, "videos": list(videos), "readings": names, **counts})


def _number(value: Any) -> str:
    """Return a number as text; anything else is unknown."""
    return f"{value:g}" if isinstance(value, int | float) and not isinstance(value, bool) else "unknown"


def _names(value: Any) -> list[str]:
    """Return the names of a feature's numbers, which may be in a list or in one by kind."""
    lists = [value] if isinstance(value, list) else list(value.values()) if isinstance(value, Mapping) else []
    return [name for each in lists if isinstance(each, list) for name in each if isinstance(name, str)]


def _video_size(feature: Any) -> str | None:
    """Return the size of a feature that is a video, as text; None of another one."""
    if not isinstance(feature, Mapping) or feature.get("dtype") != "video":
        return None
    shape = feature.get("shape")
    whole = isinstance(shape, list) and len(shape) == 3 and all(isinstance(each, int) for each in shape)
    return f"{shape[1]} x {shape[0]} px" if whole and shape is not None else "of unknown size"
