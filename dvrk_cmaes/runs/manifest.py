"""What the results in a folder were made with: fields of its ``run.json``, compared before results are added.

Fields: version, instrument {name, digest}, arm, cameras (digest), config, segment {model, weights, backgrounds},
calibration (digest or null), session (its path; not compared), warnings (the session's; not compared),
frames {frame: {part: size and time of a file, or digest}}

The output folder of a batch: the frames of it, complete results, and writing.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from fnmatch import fnmatchcase
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import msgspec
import numpy as np

from dvrk_cmaes.calibration.document import read_calibration
from dvrk_cmaes.config import __version__
from dvrk_cmaes.errors import InputError, nearest_first
from dvrk_cmaes.frames.frame import FrameFiles, readable
from dvrk_cmaes.frames.session_folder import Session
from dvrk_cmaes.io.json_file import json_text, read_json_object
from dvrk_cmaes.io.short_text import in_order, listed, natural
from dvrk_cmaes.io.typed_document import convert_document
from dvrk_cmaes.results.folder import (
    MANIFEST,
    SESSION,
    SUMMARY,
    mask_path,
    overlay_path,
    read_result,
    result_path,
)
from dvrk_cmaes.results.result import Status
from dvrk_cmaes.segment.segmentation import SegmentSettings

if TYPE_CHECKING:
    from dvrk_cmaes.runs.frame import ArmInSession

_FILES = ("mask", "image", "ignore")
_LENGTH = 16
"""Hexadecimal digits of a digest; among a million digests, two are equal by chance with a probability of 3e-8."""

UNREADABLE = "unreadable"
"""Stands for the size and time of a file that cannot be read."""


def frame_stamps(files: FrameFiles) -> dict[str, str]:
    """Return sizes and times of the files of a frame, and digests of its other parts, by name of the part.

    Of a file that cannot be read it is `UNREADABLE`.
    """
    stamps = {
        f"{view} {name}".strip(): _stamp(path)
        for view, own in {"": files, **files.others}.items()
        for name in _FILES
        if (path := getattr(own, name)) is not None
    }
    for number, tool in enumerate(files.other_tools):
        stamps[f"other tool {number}"] = f"{tool.mask and _stamp(tool.mask)} {tool.label or ''}"
    if (film := files.video) is not None:
        stamps["video"] = f"{_stamp(film.video.path)} {film.number} {film.window}"
    prompts = files.prompts if files.mask is None else None
    return {
        **stamps,
        "readings": digest_of((dict(sorted(files.readings.items())), files.notes, files.problem, files.time)),
        "points and labels": digest_of((files.keypoints, files.label, files.pick, prompts)),
    }


def _stamp(path: Path) -> str:
    """Return size, bytes, and time of change, ns, of a file."""
    try:
        status = path.stat()
    except OSError:
        return UNREADABLE
    return f"{status.st_size} {status.st_mtime_ns}"


def digest_of(value: Any) -> str:
    """Compute the digest of a tree of dataclasses, mappings, sequences, arrays and plain values."""
    data = msgspec.json.encode(value, enc_hook=_plain, order="deterministic")
    return hashlib.sha256(data).hexdigest()[:_LENGTH]


def _plain(value: Any) -> Any:
    """Return an array as its type, shape and digest, a number of NumPy as one of Python, and others as text."""
    if isinstance(value, np.ndarray):
        return value.dtype.str, value.shape, hashlib.sha256(value.tobytes()).hexdigest()
    return value.item() if isinstance(value, np.generic) else dict(value) if isinstance(value, Mapping) else str(value)


Manifest = dict[str, Any]
FrameParts = Mapping[str, Mapping[str, str]]
"""Stamps of the parts of each frame, as of `frame_stamps`."""

_NOT_COMPARED: Final = ("session", "warnings", "frames")
_OF_FILES: Final = ("mask", "image", "video")
_MOST_SHOWN: Final = 5
ADVICE: Final = "choose another --out, or begin anew with --overwrite"


class _Instrument(msgspec.Struct):
    name: str


class _ManifestFields(msgspec.Struct):
    """Fields of a manifest that are used after it is read; the others are only compared."""

    version: str
    session: str
    instrument: _Instrument
    config: dict[str, Any]
    frames: dict[str, dict[str, str]]


def manifest_of(arm: ArmInSession, frames: Iterable[FrameFiles]) -> Manifest:
    """Return the manifest of a command that works on some frames of an arm."""
    instrument, method = arm.body.instrument, arm.method
    segment, views = method.segment or SegmentSettings(), arm.session.rig.views
    backgrounds = {view: digest_of(background) for view, background in sorted(segment.backgrounds.items())}
    weights = None if segment.weights is None else str(segment.weights)
    return {
        "version": __version__,
        "instrument": {"name": instrument.name, "digest": digest_of(instrument)},
        "arm": method.arm,
        "cameras": digest_of([replace(view, camera=replace(view.camera, remarks=())) for view in views]),
        "config": method.config.as_dict(),
        "segment": {"model": segment.model, "weights": weights, "backgrounds": backgrounds},
        "calibration": None if method.session is None else digest_of(json_text(method.session.to_dict())),
        "session": os.path.abspath(arm.session.folder),
        "warnings": list(arm.session.warnings),
        "frames": in_order({files.name: frame_stamps(files) for files in frames}),
    }


def read_manifest(out: Path) -> Manifest | None:
    """Read a folder's manifest, None if there is none; InputError if it is damaged."""
    path = out / MANIFEST
    if not path.exists():
        return None
    manifest = read_json_object(path, expected="what a batch was run with (run.json)")
    for name in ("command", "files"):
        manifest.pop(name, None)
    if not manifest:
        return None
    try:
        convert_document(str(path), manifest, _ManifestFields)
    except InputError as error:
        raise InputError(f"{error}: {ADVICE}") from None
    return manifest


def check_same_settings(out: Path, old: Manifest, new: Manifest) -> None:
    """Check that the results in a folder were computed with the same settings.

    Raises
    ------
    InputError
        A setting differs; the message states the old and new values of the first few.
    """
    changes = [f"{key}: {value[0]} -> {value[1]}" for key, value in _changed(dict(_leaves(old)), dict(_leaves(new)))]
    if changes:
        more = f" and {len(changes) - _MOST_SHOWN} more" if len(changes) > _MOST_SHOWN else ""
        raise InputError(f"{out}: its results were made otherwise ({'; '.join(changes[:_MOST_SHOWN])}{more}): {ADVICE}")


def check_same_session(out: Path, session: Session) -> None:
    """Raise InputError if the results in a folder are those of another session.

    A session is the same one if it is where it was, or, if it was moved, if files of a frame are what they were.
    """
    old = read_manifest(out)
    if old is None or Path(old["session"]).resolve() == session.folder.resolve():
        return
    for files in session.frames:
        before = old["frames"].get(files.name, {}).items()
        if any(part in _OF_FILES for part, _ in before & frame_stamps(files).items()):
            return
    raise InputError(f"{out}: it has the results of another session ({old['session']}); choose another --out")


def check_same_frames(out: Path, old: Manifest, new: FrameParts, *, done: Collection[str]) -> None:
    """Check that the results in a folder are those of the session's frames as they are now.

    Parameters
    ----------
    out
        The folder.
    old
        The folder's manifest.
    new
        Stamps of the frames to be computed.
    done
        Frames whose results exist and are not computed again.

    Raises
    ------
    InputError
        The files of a frame have changed; the message names the frames and files.
    """
    both = {name: [*_changed(old["frames"].get(name, {}), new[name])] for name in sorted(set(done) & set(new))}
    changes = [f"{name} ({', '.join(part for part, _ in parts)})" for name, parts in both.items() if parts]
    if changes:
        raise InputError(f"{out}: frames have changed since their results were made: {listed(changes)}: {ADVICE}")


def _changed(before: Mapping[str, Any], after: Mapping[str, Any]) -> Iterator[tuple[str, tuple[Any, Any]]]:
    """Yield the keys whose values differ, with both values."""
    for key in dict.fromkeys((*after, *before)):
        if before.get(key) != after.get(key):
            yield key, (before.get(key, "not there"), after.get(key, "not there"))


def _leaves(tree: Mapping[str, Any], table: str = "") -> Iterator[tuple[str, Any]]:
    """Yield settings as ``table.key`` and value, without those that are not compared."""
    for name, value in tree.items():
        if not table and name in _NOT_COMPARED:
            continue
        if isinstance(value, dict):
            yield from _leaves(value, f"{table}{name}.")
        else:
            yield f"{table}{name}", value


def chosen_frames(frames: Sequence[FrameFiles], pattern: str | None) -> tuple[FrameFiles, ...]:
    """Return the frames whose names match a shell pattern (``*``, ``?``, ``[..]``), or all frames, in order.

    The name of a frame, with brackets in it, too, is a pattern of this frame alone.

    Raises
    ------
    InputError
        No frame matches.
    """
    named = [frame for frame in frames if frame.name == pattern]
    matching = named or [frame for frame in frames if pattern is None or fnmatchcase(frame.name, pattern)]
    chosen = tuple(sorted(matching, key=lambda frame: natural(frame.name)))
    if not chosen:
        near = listed(nearest_first(str(pattern), [frame.name for frame in frames[:1000]]))
        raise InputError(f"--frames: expected a pattern of some of the {len(frames)} frames ({near}), got {pattern!r}")
    return chosen


COMMAND: Final = "batch"
POSES: Final = "poses.csv"
PAGE: Final = "report.html"
TABLES: Final = (POSES, SUMMARY, PAGE)
"""Files of all frames together."""


def results_of(frames: Iterable[str], views: Sequence[str]) -> list[str]:
    """Return the paths, in the folder, of all files that frames with views of some names may have."""
    here, views = Path(), views if len(views) > 1 else ("",)
    paths = ((result_path(here, f), overlay_path(here, f), *(mask_path(here, f, v) for v in views)) for f in frames)
    return [path.as_posix() for of_frame in paths for path in of_frame]


def earlier_results(out: Path, chosen: Collection[str], session: Collection[str]) -> dict[str, Status]:
    """Return the status of each frame that has a valid result in a folder, which has not failed, and an overlay.

    Raises
    ------
    InputError
        A result is not of one of the session's frames, or it is damaged and not among the chosen frames, which are
        estimated again; or the folder has a calibration that is damaged.
    """
    paths = {path.stem: path for path in sorted((out / "frames").glob("*.json"), key=lambda path: natural(path.name))}
    missing = [name for name in paths if name not in session]
    if missing:
        raise InputError(f"{out}: it has results of frames that are not in the session: {listed(missing)}: {ADVICE}")
    found: dict[str, Status] = {}
    for name, path in paths.items():
        result = readable(partial(read_result, path)) if name in chosen else read_result(path)
        has_pose = result is not None and result.frame == name and result.status != "failed"
        if result is not None and has_pose and overlay_path(out, name).is_file():
            found[name] = result.status
    if (out / SESSION).exists():
        read_calibration(out / SESSION)
    return found
