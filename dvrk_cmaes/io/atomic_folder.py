"""Write folders atomically: a temporary folder beside the target is filled and then renamed."""

from __future__ import annotations

import contextlib
import ctypes
import fcntl
import hashlib
import os
import re
import shutil
import uuid
from collections.abc import Iterator, Sequence
from pathlib import Path

from dvrk_cmaes.errors import DvrkCmaesError, InputError
from dvrk_cmaes.io.atomic import not_written
from dvrk_cmaes.io.written_files import RECORD, files_in, read_written, write_written

_HERE, _RENAME_EXCHANGE = -100, 2  # of renameat2(2): paths are relative to the working folder; exchange both


@contextlib.contextmanager
def whole_folder(
    path: str | Path, *, command: str, sign: str, overwrite: bool = False, source: str | Path | None = None
) -> Iterator[Path]:
    """Yield a temporary folder, which becomes the target if the block raises no error and is removed otherwise.

    Parameters
    ----------
    path
        The target; it must not exist or be empty, unless ``overwrite``.
    command
        The command that writes it, for the record of its files (`dvrk_cmaes.io.written_files`).
    sign
        Name of a file that folders of this kind contain; a folder without it is not overwritten.
    overwrite
        Replace an existing folder of the same command, if it has no file that was added or changed since.
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
        _refuse_other(path, target, command, sign, overwrite)
        with _folder_beside(target) as beside:
            yield beside
            write_written(beside, command, list(files_in(beside)))
            _refuse_other(path, target, command, sign, overwrite)  # files may have been added meanwhile
            _put(beside, target)
    except DvrkCmaesError as error:
        raise type(error)(str(error).replace(str(beside), str(path))) from None
    except (OSError, ValueError) as error:  # ValueError: a null character in the name
        raise not_written(path, error, "a folder") from None


@contextlib.contextmanager
def _folder_beside(target: Path) -> Iterator[Path]:
    """Yield a new folder beside a target, which is locked meanwhile, and remove it at the end if it is there still.

    Those that killed processes left for the same target are removed first: their names begin as that of the new one,
    and nobody holds their locks.
    """
    begin = hashlib.sha256(os.fsencode(target)).hexdigest()[:16]
    for left in target.parent.iterdir() if target.parent.is_dir() else ():
        if re.fullmatch(rf"\.{begin}[0-9a-f]{{16}}\.tmp", left.name) and not left.is_symlink():
            with contextlib.suppress(OSError), _locked(left):
                shutil.rmtree(left, ignore_errors=True)
    beside = target.with_name(f".{begin}{uuid.uuid4().hex[:16]}.tmp")
    beside.mkdir(parents=True)
    try:
        with _locked(beside, needed=False):
            yield beside
    finally:
        shutil.rmtree(beside, ignore_errors=True)


@contextlib.contextmanager
def _locked(folder: Path, *, needed: bool = True) -> Iterator[None]:
    """Lock a folder while this process lives; OSError if it is locked, or cannot be and that is ``needed``."""
    opened = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    try:
        try:
            fcntl.flock(opened, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            if needed:
                raise
        yield
    finally:
        os.close(opened)


@contextlib.contextmanager
def replaced_folder(path: Path, *, kept: Sequence[str] = ()) -> Iterator[Path]:
    """Yield a temporary folder, which takes the place of a folder if the block raises no error, and is removed if not.

    The folder that was there is removed afterwards; its subfolders ``kept`` are in the new one from the start: files
    there may be replaced, but not written into, since they can be the same ones. At any moment one of the two folders
    is there, whole.

    Raises
    ------
    InputError
        The folder cannot be written to.
    DvrkCmaesError
        The disk is full or failing. In errors raised by the block, the temporary path is replaced by ``path``.
    """
    target = Path(os.path.realpath(path))
    beside = target
    try:
        with _folder_beside(target) as beside:
            for name in kept:
                if (target / name).is_dir():
                    shutil.copytree(target / name, beside / name, copy_function=_linked)
            yield beside
            _put(beside, target)
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


def _refuse_other(path: str | Path, target: Path, command: str, sign: str, overwrite: bool) -> None:
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
    record = read_written(target)
    if record is None or record.command != command:
        raise InputError(
            f"{path}: --overwrite: expected a folder that `{command}` wrote (with {RECORD}); nothing removed"
        )
    foreign = record.first_foreign(target)
    if foreign is not None:
        raise InputError(f"{path}: --overwrite: {foreign} was added or changed since; move it; nothing removed")


def _put(beside: Path, target: Path) -> None:
    """Rename a folder to the target; an existing target then has the folder's name."""
    if target.exists():
        _exchange(beside, target)
    else:
        beside.rename(target)
