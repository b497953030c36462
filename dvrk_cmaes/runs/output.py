"""A folder of results while a batch writes there: one batch at a time, no leftovers, and what is whole."""

from __future__ import annotations

import re
import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Final

from filelock import FileLock, Timeout

from dvrk_cmaes.errors import DvrkCmaesError, InputError
from dvrk_cmaes.io.atomic import not_written, write_bytes
from dvrk_cmaes.results.file import read_result
from dvrk_cmaes.results.folder import SESSION, SUMMARY
from dvrk_cmaes.results.paths import mask_path, overlay_path, result_path
from dvrk_cmaes.results.result import Status
from dvrk_cmaes.runs.manifest import MANIFEST, read_manifest
from dvrk_cmaes.runs.worker import FrameOutcome
from dvrk_cmaes.runs.worklist import shards_folder

LOCK: Final = ".lock"
POSES: Final = "poses.csv"
PAGE: Final = "report.html"
_FOLDERS: Final = ("frames", "overlays", "masks")
_LEFTOVER: Final = re.compile(r"\.[0-9a-f]{32}\.tmp")


@contextmanager
def locked(out: Path) -> Iterator[None]:
    """Keep other batches out of a folder, which is made if need be; the lock ends with the process, however it ends.

    Raises
    ------
    DvrkCmaesError
        Another batch is at it.
    InputError
        The folder cannot be made or written to.
    """
    lock = FileLock(out / LOCK)
    try:
        out.mkdir(parents=True, exist_ok=True)
        lock.acquire(timeout=0)
    except Timeout:
        raise DvrkCmaesError(f"{out}: another batch is writing there; wait for it, or choose another --out") from None
    except OSError as error:
        raise not_written(out, error, "results") from None
    try:
        yield
    finally:
        lock.release()


def sweep(out: Path) -> None:
    """Remove what a batch that was killed had begun to write."""
    for folder in (out, *(out / name for name in _FOLDERS)):
        for path in folder.iterdir() if folder.is_dir() else ():
            if _LEFTOVER.fullmatch(path.name):
                with suppress(OSError):
                    path.unlink()


def clear(out: Path) -> None:
    """Remove all that batches wrote, what they were run with last; InputError where there are other files instead."""
    refuse_strangers(out)
    with suppress(InputError):  # of a damaged manifest: no mask is known to be ours
        for frame, parts in (read_manifest(out) or {"frames": {}})["frames"].items():
            if parts and "mask" not in parts:
                mask_path(out, frame).unlink(missing_ok=True)
    for name in _FOLDERS:
        for path in (out / name).glob("*") if (out / name).is_dir() else ():
            if path.suffix in (".json", ".jpg"):
                path.unlink()
    if shards_folder(out).is_dir():
        shutil.rmtree(shards_folder(out))
    for name in (POSES, SUMMARY, SESSION, PAGE, MANIFEST):
        (out / name).unlink(missing_ok=True)


def refuse_strangers(out: Path) -> None:
    """Refuse a folder that has results, but not from a batch."""
    if not (out / MANIFEST).exists() and (out / "frames").is_dir() and any((out / "frames").glob("*.json")):
        raise InputError(f"{out}: it has results, but not of a batch (no {MANIFEST}); choose another --out")


def whole_results(out: Path) -> dict[str, Status]:
    """Status of each frame whose result is there and whole, with its overlay unless it failed."""
    found: dict[str, Status] = {}
    for path in sorted((out / "frames").glob("*.json")):
        try:
            result = read_result(path)
        except InputError:
            continue
        if result.frame != path.stem:
            continue
        if result.status == "failed" or overlay_path(out, result.frame).is_file():
            found[result.frame] = result.status
    return found


def write_outcome(out: Path, outcome: FrameOutcome) -> None:
    """Write a frame's files, the result last: where it is, all is there."""
    if outcome.mask is not None:
        write_bytes(mask_path(out, outcome.frame), outcome.mask)
    if outcome.overlay is not None:
        write_bytes(overlay_path(out, outcome.frame), outcome.overlay)
    else:
        overlay_path(out, outcome.frame).unlink(missing_ok=True)
    write_bytes(result_path(out, outcome.frame), outcome.result)
