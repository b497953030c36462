"""Write folders atomically: a temporary folder beside the target is filled and then renamed."""

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
    """Yield a temporary folder, which becomes the target if the block raises no error and is removed otherwise.

    Parameters
    ----------
    path
        The target; it must not exist or be empty, unless ``overwrite``.
    sign
        Name of a file that folders of this kind contain; a folder without it is not overwritten.
    overwrite
        Replace an existing folder with all its content.
    source
        A file or folder that is read meanwhile; it must not lie in the target.

    Raises
    ------
    InputError
        The target exists already, or cannot be written to.
    DvrkCmaesError
        The disk is full or failing. In errors raised by the block, the temporary path is replaced by ``path``.
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
    """Raise an InputError unless the target does not exist, is empty, or may be overwritten."""
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
    """Rename a folder to the target; an existing target is removed afterwards."""
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
