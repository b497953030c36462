"""Merging of the shards of one session, estimated on several machines, into one folder of results."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import ExitStack, suppress
from functools import partial
from pathlib import Path
from typing import Any

from dvrk_cmaes.errors import InputError
from dvrk_cmaes.frames.frame import readable
from dvrk_cmaes.io.handles import not_written
from dvrk_cmaes.io.output import Output, output
from dvrk_cmaes.io.short_text import natural, no_folder
from dvrk_cmaes.results.file import read_result
from dvrk_cmaes.results.folder import MANIFEST, read_results
from dvrk_cmaes.results.paths import found_masks, overlay_path
from dvrk_cmaes.runs.batch import finish
from dvrk_cmaes.runs.manifest import check_same_settings, read_manifest, with_frames, write_manifest
from dvrk_cmaes.runs.output import COMMAND, TABLES, has_results
from dvrk_cmaes.runs.worklist import shards_folder


def merge_shards(out: str | Path) -> dict[str, Any]:
    """Move the results of all shards below ``out`` into ``out``, write tables and page, and return the summary.

    The merged folder is the same as that of a batch without shards. An interrupted merge can be repeated. Shards may be
    merged before they are complete, and continued and merged again later.

    Raises
    ------
    InputError
        The folder has no results of a batch, or the shards were made with different settings.
    DvrkCmaesError
        A shard is still being written, or the disk is full.
    """
    out = Path(out)
    if not out.is_dir():
        raise InputError(f"{out}: {no_folder(out)}; expected results of dvrk-cmaes batch --shard")
    folders = sorted(path for path in shards_folder(out).glob("[0-9]*-of-[0-9]*") if (path / MANIFEST).exists())
    if not folders and not (out / MANIFEST).exists():
        raise InputError(f"{out}: expected results of dvrk-cmaes batch --shard, got none")
    with ExitStack() as opened:
        own = opened.enter_context(output(out, COMMAND))
        shards = {folder: opened.enter_context(output(folder, COMMAND)) for folder in folders}
        own.refuse(TABLES)
        if folders and has_results(out):
            read_results(out, summary=False)  # a damaged one is refused before anything is written
        _merge_manifests(out, folders)
        try:
            for folder, shard in shards.items():
                _move_results(folder, shard, own)
                shard.clear(last=MANIFEST)
        except OSError as error:
            raise not_written(out, error, "results") from None
        summary = finish(out).summary or {}
    for folder in (*folders, shards_folder(out)):
        with suppress(OSError):  # not empty, because a shard was started in the meantime; or not there
            folder.rmdir()
    return summary


def _merge_manifests(out: Path, folders: Sequence[Path]) -> None:
    """Write the manifest of the merged results, before any result is moved."""
    merged = read_manifest(out)
    for folder in folders:
        manifest = read_manifest(folder)
        if merged is not None and manifest is not None:
            check_same_settings(folder, merged, manifest)
            manifest = with_frames(merged, manifest["frames"])
        merged = manifest
    if merged is not None and merged != read_manifest(out):
        write_manifest(out, merged)


def _move_results(folder: Path, shard: Output, own: Output) -> None:
    """Move the complete results of a shard's folder, each after its other files."""
    for path in sorted((folder / "frames").glob("*.json"), key=lambda path: natural(path.name)):
        if (result := readable(partial(read_result, path))) is None:  # damaged, therefore treated as missing
            continue
        frame = result.frame
        others = (*found_masks(folder, frame), overlay_path(folder, frame))
        for source in (*others, path):
            if source.is_file():
                own.move_from(shard, source.relative_to(folder).as_posix())
