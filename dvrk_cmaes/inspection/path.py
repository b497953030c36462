"""Recognition of a file's format by its first bytes and fields; recordings, meshes and settings by their suffix.

The readers of each kind are imported where a file is of that kind: importing those of all takes longer than reading.
"""

from __future__ import annotations

import re
from pathlib import Path

from dvrk_cmaes.errors import InputError
from dvrk_cmaes.inspection.finding import MESHES, RECORDINGS, VIDEOS, Finding, Options
from dvrk_cmaes.io.csv_file import separator_of
from dvrk_cmaes.io.files import check_file
from dvrk_cmaes.io.short_text import is_number
from dvrk_cmaes.joints.joint_state import is_joint_state

_EXPECTED = "a file or folder to look at"
_KNOWN = "a camera file, joint readings, a mask, an image, a URDF, a mesh, or a JSON document of a known kind"
_NUMPY = b"\x93NUMPY"
MAT_FILE = b"MATLAB "
_IMAGE_STARTS = (b"\x89PNG\r\n\x1a\n", b"\xff\xd8")
_TEXTS = (".md", ".rst", ".html", ".log")
_START = 65536  # bytes read to recognise the format
_ROOT = re.compile(rb"<\s*(?!\?|!)([\w:.-]+)")
_IMAGE_TIMES = {"frame", "time"}
_TRACKER = re.compile(r".*_ctr|optimized_joint_angles")


def inspect_path(path: str | Path, options: Options | None = None) -> Finding:
    """Recognise the format of a file or folder and describe its content.

    Raises
    ------
    InputError
        The path does not exist, or the file is of no known format or not valid (with the message of its reader).
    """
    settings = Options() if options is None else options
    file = Path(path)
    try:
        if file.is_dir():
            from dvrk_cmaes.inspection.folders import inspect_folder

            return inspect_folder(file, settings)
        check_file(file, expected=_EXPECTED)
        with file.open("rb") as stream:
            start = stream.read(_START)
    except OSError as error:
        raise InputError(f"{path}: not readable ({error.strerror}); expected {_EXPECTED}") from None
    if file.suffix.lower() in (*RECORDINGS, *VIDEOS):
        from dvrk_cmaes.inspection.folders import inspect_recording

        return inspect_recording(file)
    if file.suffix.lower() in MESHES:
        from dvrk_cmaes.inspection.instruments import inspect_mesh

        return inspect_mesh(file)
    if file.suffix.lower() in _TEXTS:
        return Finding("text for people", ("skipped: it has no data that is read",), {})
    if file.suffix.lower() == ".toml":
        return _inspect_settings(file)
    if start.startswith(_IMAGE_STARTS):
        from dvrk_cmaes.inspection.pictures import inspect_image

        return inspect_image(file)
    if start.startswith(MAT_FILE):
        return _inspect_camera(file, settings)
    if start.startswith(_NUMPY):
        from dvrk_cmaes.inspection.tables import inspect_joints, inspect_tracker_array

        return inspect_tracker_array(file) if _TRACKER.fullmatch(file.stem) else inspect_joints(file, settings)
    return _inspect_text(file, start.removeprefix(b"\xef\xbb\xbf"), settings)


def _inspect_text(path: Path, start: bytes, options: Options) -> Finding:
    """Recognise the format of a text file and describe it; ``start`` is the beginning of the file."""
    if b"\0" in start:
        raise InputError(f"{path}: expected {_KNOWN}, got something else")
    content = start.lstrip()
    if content.startswith(b"<"):
        root = _ROOT.search(content)
        if root is None or root[1] != b"robot":
            return _inspect_camera(path, options)
        from dvrk_cmaes.inspection.instruments import inspect_urdf

        return inspect_urdf(path, options)
    if content.startswith((b"{", b"/*", b"//")):
        from dvrk_cmaes.inspection.documents import inspect_json

        return inspect_json(path, options)
    text = start.decode("utf-8", errors="replace")
    if is_joint_state(text):
        from dvrk_cmaes.inspection.tables import inspect_joints

        return inspect_joints(path, options)
    lines = [line for line in text.splitlines() if line.strip() and not line.startswith("#")]
    separator = separator_of(lines[0]) if lines else ","
    names = [name.strip() for name in lines[0].split(separator)] if lines else []
    header = set(names) if separator != " " or all(map(is_number, names)) else set()
    if len(header) > 1 and ":" not in lines[0]:
        return _inspect_table(path, header, options)
    return _inspect_camera(path, options)


def _inspect_camera(path: Path, options: Options) -> Finding:
    """Describe a camera file."""
    from dvrk_cmaes.inspection.cameras import inspect_camera

    return inspect_camera(path, options)


def _inspect_table(path: Path, header: set[str], options: Options) -> Finding:
    """Describe a table by the names of its columns."""
    from dvrk_cmaes.inspection import tables

    if "tip_1_u" in header:
        return tables.inspect_keypoints(path)
    if "marker" in header:
        return tables.inspect_detections(path)
    if header == _IMAGE_TIMES:
        return tables.inspect_image_times(path)
    if {"rx", "tx", "jaw_1"} <= header:
        return tables.inspect_published_poses(path)
    return tables.inspect_joints(path, options)


def _inspect_settings(path: Path) -> Finding:
    """Describe a settings file by the settings that differ from the defaults."""
    from dvrk_cmaes.config import EstimateConfig
    from dvrk_cmaes.io.toml_file import leaves, read_config

    default = EstimateConfig()
    changed = dict(leaves(read_config(path, default)))
    defaults = dict(leaves(default))
    changes = {name: value for name, value in changed.items() if value != defaults[name]}
    lines = tuple(f"{name} = {value} instead of {defaults[name]}" for name, value in changes.items())
    return Finding("settings", lines or ("nothing but the defaults",), changes)
