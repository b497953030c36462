"""Write folders atomically: a temporary folder beside the target is filled and then renamed."""

from __future__ import annotations

import contextlib
import ctypes
import os
import shutil
import uuid
from collections.abc import Iterator, Sequence
from pathlib import Path

from dvrk_cmaes.errors import DvrkCmaesError, InputError
from dvrk_cmaes.io.atomic import not_written

_HERE, _RENAME_EXCHANGE = -100, 2  # of renameat2(2): paths are relative to the working folder; exchange both


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


@contextlib.contextmanager
def replaced_folder(path: Path, *, kept: Sequence[str] = ()) -> Iterator[Path]:
    """Yield a temporary folder, which takes the place of a folder if the block raises no error, and is removed if not.

    The folder that was there is removed afterwards; its subfolders ``kept`` are in the new one, too. At any moment one
    of the two is there, whole.

    Raises
    ------
    InputError
        The folder cannot be written to.
    DvrkCmaesError
        The disk is full or failing. In errors raised by the block, the temporary path is replaced by ``path``.
    """
    target = Path(os.path.realpath(path))
    beside = target.with_name(f".{uuid.uuid4().hex}.tmp")
    try:
        beside.mkdir(parents=True)
        try:
            yield beside
            for name in kept:
                if (target / name).is_dir():
                    shutil.copytree(target / name, beside / name, copy_function=_linked)
            if target.exists():
                _exchange(beside, target)
            else:
                beside.rename(target)
        finally:
            shutil.rmtree(beside, ignore_errors=True)
    except DvrkCmaesError as error:
        raise type(error)(str(error).replace(str(beside), str(path))) from None
    except OSError as error:
        raise not_written(path, error, "a folder") from None


def _linked(source: str, target: str) -> None:
    """Give a file a second name, or copy it where the file system has none."""
    try:
        os.link(source, target)
    except OSError:
        shutil.copy2(source, target)


def _exchange(first: Path, second: Path) -> None:
    """Exchange the names of two folders, in one step where the system can."""
    library = ctypes.CDLL(None, use_errno=True)
    if hasattr(library, "renameat2"):
        names = os.fsencode(first), os.fsencode(second)
        if library.renameat2(_HERE, names[0], _HERE, names[1], _RENAME_EXCHANGE) == 0:
            return
    apart = second.with_name(f".{uuid.uuid4().hex}.old")
    second.rename(apart)
    try:
        first.rename(second)
    except OSError:
        apart.rename(second)
        raise
    apart.rename(first)


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
