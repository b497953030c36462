"""``run.json``: what a folder's results were made from, so that nothing else is mixed into them.

schema, version, instrument {name, digest}, arm, camera, config, segment, session (its path; not compared),
frames {frame: {part: digest}, or null for a frame that another shard does}
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any, Final

from dvrk_cmaes._version import __version__
from dvrk_cmaes.errors import InputError
from dvrk_cmaes.io.atomic import write_json
from dvrk_cmaes.io.json_file import read_json_object
from dvrk_cmaes.io.short_text import listed
from dvrk_cmaes.runs.digests import calibration_digest, instrument_digest
from dvrk_cmaes.runs.worker import BatchSetup

Manifest = dict[str, Any]
FrameParts = Mapping[str, Mapping[str, str] | None]

MANIFEST: Final = "run.json"
_SCHEMA: Final = 1
_NOT_COMPARED: Final = ("session", "frames")
_MOST_SHOWN: Final = 5
_WAY_OUT: Final = "choose another --out, or begin anew with --overwrite"


def manifest_of(setup: BatchSetup, frames: FrameParts) -> Manifest:
    """State what results are made from; ``frames`` are the digests of each frame's parts, None for other shards'."""
    camera = asdict(setup.camera)
    return {
        "schema": _SCHEMA,
        "version": __version__,
        "instrument": {"name": setup.instrument.name, "digest": instrument_digest(setup.instrument)},
        "arm": setup.arm,
        "camera": {name: list(value) if isinstance(value, tuple) else value for name, value in camera.items()},
        "config": setup.config.as_dict(),
        "segment": {
            "model": setup.segment.model,
            "weights": None if setup.segment.weights is None else str(setup.segment.weights),
        },
        "calibration": None if setup.calibration is None else calibration_digest(setup.calibration),
        "session": str(setup.folder),
        "frames": _sorted(frames),
    }


def read_manifest(out: Path) -> Manifest | None:
    """Read a folder's manifest, None where there is none; InputError if it is damaged."""
    path = out / MANIFEST
    if not path.exists():
        return None
    manifest = read_json_object(path, expected="what a batch was run with (run.json)")
    if not isinstance(manifest.get("frames"), dict):
        raise InputError(f"{path}: frames: expected an object, got none: {_WAY_OUT}")
    return manifest


def write_manifest(out: Path, manifest: Manifest) -> None:
    """Write a folder's manifest."""
    write_json(out / MANIFEST, manifest)


def check_same_settings(out: Path, old: Manifest, new: Manifest) -> None:
    """Refuse to go on in a folder whose results were made otherwise.

    Raises
    ------
    InputError
        Naming each setting that differs, with its old and new value.
    """
    before, after = dict(_leaves(old)), dict(_leaves(new))
    changes = [
        f"{key}: {before.get(key, 'not there')} -> {after.get(key, 'not there')}"
        for key in dict.fromkeys((*after, *before))
        if before.get(key) != after.get(key)
    ]
    if changes:
        more = f" and {len(changes) - _MOST_SHOWN} more" if len(changes) > _MOST_SHOWN else ""
        raise InputError(
            f"{out}: its results were made otherwise ({'; '.join(changes[:_MOST_SHOWN])}{more}): {_WAY_OUT}"
        )


def check_same_frames(
    out: Path, old: Manifest, new: FrameParts, *, done: Collection[str], session: Iterable[str]
) -> None:
    """Refuse to go on in a folder that has results of other frames than are there now.

    Parameters
    ----------
    out
        The folder.
    old
        The folder's manifest.
    new
        Digests of the frames to be done.
    done
        Frames whose results are kept.
    session
        All frames of the session.

    Raises
    ------
    InputError
        Naming the frames, and which of their files have changed.
    """
    gone = sorted(set(done) - set(session))
    if gone:
        raise InputError(f"{out}: it has results of frames that are not in the session: {listed(gone)}: {_WAY_OUT}")
    changes = []
    for name in sorted(set(done) & set(new)):
        before, after = old["frames"].get(name) or {}, new[name] or {}
        parts = after and [part for part in dict.fromkeys((*after, *before)) if before.get(part) != after.get(part)]
        if parts:
            changes.append(f"{name} ({', '.join(parts)})")
    if changes:
        raise InputError(f"{out}: frames have changed since their results were made: {listed(changes)}: {_WAY_OUT}")


def with_frames(manifest: Manifest, more: FrameParts) -> Manifest:
    """Add frames to a manifest; those of ``more`` win, unless they are only named there."""
    known = manifest["frames"]
    return {**manifest, "frames": _sorted({**known, **{n: parts or known.get(n) for n, parts in more.items()}})}


def _sorted(frames: FrameParts) -> FrameParts:
    return {name: frames[name] for name in sorted(frames)}


def _leaves(tree: Mapping[str, Any], table: str = "") -> Iterator[tuple[str, Any]]:
    """List settings as ``table.key`` and value, without those that may differ."""
    for name, value in tree.items():
        if not table and name in _NOT_COMPARED:
            continue
        if isinstance(value, dict):
            yield from _leaves(value, f"{table}{name}.")
        else:
            yield f"{table}{name}", value
