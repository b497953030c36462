"""Shards of one session, done by several machines, become one folder of results as if one had done it all."""

from __future__ import annotations

import os
import shutil
from collections.abc import Sequence
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import Any

from dvrk_cmaes.errors import InputError
from dvrk_cmaes.io.atomic import not_written
from dvrk_cmaes.results.file import read_result
from dvrk_cmaes.results.paths import mask_path, overlay_path, result_path
from dvrk_cmaes.runs.batch import finish
from dvrk_cmaes.runs.manifest import (
    MANIFEST,
    check_same_settings,
    read_manifest,
    with_frames,
    write_manifest,
)
from dvrk_cmaes.runs.output import locked, refuse_strangers, sweep
from dvrk_cmaes.runs.worklist import shard_of, shards_folder


def merge_shards(out: str | Path) -> dict[str, Any]:
    """Move the results of a folder's shards into the folder itself, write its tables and page, return its summary.

    It may be killed and run again, and be run before all shards are complete: these go on where they were.

    Raises
    ------
    InputError
        No results of a batch there, or shards that were made from something else than each other.
    DvrkCmaesError
        A shard is still being written, or the disk is full.
    """
    out = Path(out)
    if not out.is_dir():
        raise InputError(f"{out}: no such folder; expected results of dvrk-cmaes batch --shard")
    folders = sorted(path for path in shards_folder(out).glob("*") if shard_of(path) and (path / MANIFEST).exists())
    if not folders and not (out / MANIFEST).exists():
        raise InputError(f"{out}: expected results of dvrk-cmaes batch --shard, got none")
    with ExitStack() as locks:
        for folder in (out, *folders):
            locks.enter_context(locked(folder))
        refuse_strangers(out)
        sweep(out)
        _unite_manifests(out, folders)
        try:
            for folder in folders:
                _move_results(folder, out)
                shutil.rmtree(folder)
        except OSError as error:
            raise not_written(out, error, "results") from None
        summary = finish(out)
    with suppress(OSError):  # A shard has been begun in the meantime, or there were none.
        shards_folder(out).rmdir()
    return summary


def _unite_manifests(out: Path, folders: Sequence[Path]) -> None:
    """State what the results of all folders are made from, before any of them is moved."""
    united = read_manifest(out)
    for folder in folders:
        manifest = read_manifest(folder)
        if united is not None and manifest is not None:
            check_same_settings(folder, united, manifest)
            manifest = with_frames(united, manifest["frames"])
        united = manifest
    if united is not None:
        write_manifest(out, united)


def _move_results(folder: Path, out: Path) -> None:
    """Move whole results, each after its overlay."""
    for path in sorted((folder / "frames").glob("*.json")):
        try:
            frame = read_result(path).frame
        except InputError:  # Damaged: as good as missing.
            continue
        for source, target in (
            (mask_path(folder, frame), mask_path(out, frame)),
            (overlay_path(folder, frame), overlay_path(out, frame)),
            (path, result_path(out, frame)),
        ):
            target.parent.mkdir(parents=True, exist_ok=True)
            if source.is_file():
                os.replace(source, target)
