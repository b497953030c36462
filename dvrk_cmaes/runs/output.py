"""The output folder of a batch: its lock, removal of temporary files and results, complete results, and writing."""

from __future__ import annotations

import re
import shutil
from collections.abc import Collection, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Final

from filelock import FileLock, Timeout

from dvrk_cmaes.calibration.document import read_calibration
from dvrk_cmaes.errors import DvrkCmaesError, InputError
from dvrk_cmaes.io.atomic import not_written, write_bytes
from dvrk_cmaes.io.natural_order import natural
from dvrk_cmaes.io.short_text import shown
from dvrk_cmaes.io.written_files import RECORD
from dvrk_cmaes.results.file import read_result
from dvrk_cmaes.results.folder import MANIFEST, SESSION, SUMMARY
from dvrk_cmaes.results.paths import found_masks, layers_path, mask_path, overlay_path, result_path
from dvrk_cmaes.results.result import Status
from dvrk_cmaes.runs.manifest import read_manifest
from dvrk_cmaes.runs.worker import FrameOutcome
from dvrk_cmaes.runs.worklist import shards_folder

LOCK: Final = ".lock"
POSES: Final = "poses.csv"
PAGE: Final = "report.html"
_FOLDERS: Final = ("frames", "overlays", "layers", "masks")
_SUFFIXES: Final = (".json", ".jpg", ".png")
_TEMPORARY: Final = re.compile(r"\.[0-9a-f]{32}\.tmp")  # names of the temporary files of io.atomic


@contextmanager
def locked(out: Path) -> Iterator[None]:
    """Return a context manager that locks a folder against other batches; the folder is made if it does not exist.

    The operating system releases the lock when the process ends, even if it is killed. If the run is refused, with an
    `InputError`, the lock's file and the folders that were made for it are removed again.

    Raises
    ------
    DvrkCmaesError
        Another batch has locked the folder, or the disk is full.
    InputError
        The folder cannot be made or written to.
    """
    lock = FileLock(out / LOCK)
    made = [folder for folder in (out, *out.parents) if not folder.exists()]
    there = (out / LOCK).exists()
    try:
        out.mkdir(parents=True, exist_ok=True)
        lock.acquire(timeout=0)
    except Timeout:
        raise DvrkCmaesError(f"{out}: another batch is writing there; wait for it, or choose another --out") from None
    except OSError as error:
        raise not_written(out, error, "results") from None
    try:
        yield
    except InputError:
        if not there:
            (out / LOCK).unlink(missing_ok=True)
        for folder in made:
            with suppress(OSError):  # not empty, or removed already
                folder.rmdir()
        raise
    finally:
        lock.release()


def remove_temporary_files(out: Path) -> None:
    """Remove the temporary files of a batch that was killed while writing."""
    for folder in (out, *(out / name for name in _FOLDERS)):
        for path in folder.iterdir() if folder.is_dir() else ():
            if _TEMPORARY.fullmatch(path.name):
                with suppress(OSError):
                    path.unlink()


def remove_results(out: Path) -> None:
    """Remove all files that batches have written to a folder, the manifest last.

    Raises
    ------
    InputError
        The folder's results are not those of a batch.
    """
    refuse_foreign_results(out)
    with suppress(InputError):  # a damaged manifest does not tell which masks a batch has written
        for frame, parts in (read_manifest(out) or {"frames": {}})["frames"].items():
            if parts and "mask" not in parts:
                for path in found_masks(out, frame):
                    path.unlink()
    for name in _FOLDERS:
        for path in (out / name).glob("*") if (out / name).is_dir() else ():
            if path.suffix in (".json", ".jpg"):
                path.unlink()
    if shards_folder(out).is_dir():
        shutil.rmtree(shards_folder(out))
    for name in (POSES, SUMMARY, SESSION, PAGE, RECORD, MANIFEST):
        (out / name).unlink(missing_ok=True)


def has_results(out: Path) -> bool:
    """Whether a folder has results of frames."""
    return any((out / "frames").glob("*.json"))


def refuse_occupied_places(out: Path) -> None:
    """Raise `InputError` if a folder lies in the place of a file of a batch, or a file in that of a folder."""
    for name in _FOLDERS:
        if (out / name).exists() and not (out / name).is_dir():
            raise InputError(f"{out / name}: expected a folder to write to, but a file is there")
    inner = (path for name in _FOLDERS for path in (out / name).glob("*") if path.suffix in _SUFFIXES)
    for path in (*(out / name for name in (MANIFEST, POSES, SUMMARY, PAGE)), *inner):
        if path.is_dir():
            raise InputError(f"{path}: expected a file, or none yet, but a folder is there")


def refuse_foreign_results(out: Path) -> None:
    """Raise `InputError` if a folder has results that are not those of a batch."""
    if not (out / MANIFEST).exists() and has_results(out):
        raise InputError(f"{out}: it has results, but not of a batch (no {MANIFEST}); choose another --out")


def refuse_strange_results(out: Path, chosen: Collection[str], session: Collection[str]) -> None:
    """Check, before frames are estimated, that all results in a folder can be read when they are.

    Raises
    ------
    InputError
        A result is not of one of the session's frames, or it is damaged and not among the chosen frames, which are
        estimated again; or the folder has a calibration that is damaged.
    """
    for path in sorted((out / "frames").glob("*.json"), key=lambda path: natural(path.name)):
        if path.stem not in session:
            raise InputError(f"{path}: expected a result of a frame of the session, which has no {shown(path.stem)}")
        if path.stem not in chosen:
            read_result(path)
    if (out / SESSION).exists():
        read_calibration(out / SESSION)


def complete_results(out: Path) -> dict[str, Status]:
    """Return the status of each frame that has a valid result and, unless it failed, an overlay."""
    found: dict[str, Status] = {}
    for path in sorted((out / "frames").glob("*.json"), key=lambda path: natural(path.name)):
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
    """Write a frame's files, the result last, so that a frame with a result has all its files."""
    for view, mask in outcome.masks.items():
        write_bytes(mask_path(out, outcome.frame, view), mask)
    for path, data in (
        (overlay_path(out, outcome.frame), outcome.overlay),
        (layers_path(out, outcome.frame), outcome.layers),
    ):
        if data is not None:
            write_bytes(path, data)
        else:
            path.unlink(missing_ok=True)
    write_bytes(result_path(out, outcome.frame), outcome.result)
