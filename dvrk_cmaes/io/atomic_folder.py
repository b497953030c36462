"""Writing folders that are there whole or not at all: filled beside under another name, then renamed."""

from __future__ import annotations

import contextlib
import os
import shutil
import uuid
from collections.abc import Iterator
from pathlib import Path

from dvrk_cmaes.errors import DvrkCmaesError, InputError
from dvrk_cmaes.io.atomic import not_written


@contextlib.contextmanager
def whole_folder(
    path: str | Path, *, sign: str, overwrite: bool = False, source: str | Path | None = None
) -> Iterator[Path]:
    """Give a folder to fill, which takes its place when the block ends well and is removed when it does not.

    Parameters
    ----------
    path
        The folder to be; it must not exist, or be empty, unless ``overwrite``.
    sign
        Name of a file by which a folder of this kind is known; no other kind is overwritten.
    overwrite
        Replace an older folder, all of it.
    source
        What is read meanwhile, which must not lie in the folder.

    Raises
    ------
    InputError
        There is something already, or the place cannot be written to.
    DvrkCmaesError
        The disk is full or failing. Errors of the block that name the folder being filled name ``path`` instead.
    """
    beside = Path(path)
    try:
        target = Path(os.path.realpath(path))
        if source is not None and target in ((real := Path(os.path.realpath(source))), *real.parents):
            raise InputError(f"{path}: expected a folder apart from {source}, got one that holds it")
        _refuse_other(path, target, sign, overwrite)
        beside = target.with_name(f".{uuid.uuid4().hex}.tmp")
        beside.mkdir(parents=True)
        try:
            yield beside
            _put(beside, target)
        except BaseException:
            shutil.rmtree(beside, ignore_errors=True)
            raise
    except DvrkCmaesError as error:
        raise type(error)(str(error).replace(str(beside), str(path))) from None
    except (OSError, ValueError) as error:  # ValueError: a null character in the name
        raise not_written(path, error, "a folder") from None


def _refuse_other(path: str | Path, target: Path, sign: str, overwrite: bool) -> None:
    if not os.path.lexists(target):
        return
    if not target.is_dir():
        raise InputError(f"{path}: expected a folder to write, got a file of that name")
    if not any(target.iterdir()):
        return
    if not overwrite:
        raise InputError(f"{path}: expected a new or empty folder, got one with files in it (--overwrite replaces it)")
    if not (target / sign).is_file():
        raise InputError(f"{path}: --overwrite: expected an older folder with {sign}, got one without; nothing removed")


def _put(beside: Path, target: Path) -> None:
    """Rename a folder to its place; what lay there is removed once the new one lies there."""
    old = target.with_name(f".{uuid.uuid4().hex}.old")
    if target.exists():
        target.rename(old)
    try:
        beside.rename(target)
    except OSError:
        if old.exists():
            old.rename(target)
        raise
    shutil.rmtree(old, ignore_errors=True)
