"""The folder that a command writes to: FOLDER/run.json names the command, what it was run with, and its files.

A command writes to a new or empty folder, or to one whose run.json it wrote. It locks run.json, and notes each file
there with its SHA-256 before the file is written. A file that is not noted, or has another content since, is the
user's: it is neither replaced nor removed. No link in the output folder is followed. Each file is written under a
temporary name in the same folder, and renamed.
"""

from __future__ import annotations

import contextlib
import ctypes
import errno
import fcntl
import hashlib
import json
import os
import re
import shutil
import threading
import time
import uuid
from collections.abc import Collection, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any, Final

from dvrk_cmaes.errors import DvrkCmaesError, InputError

RUN: Final = "run.json"
HELD: Final = ".lock"
"""The file that stands for the lock where the file system has none."""
LONG: Final = 600.0
"""Seconds for which commands that write a few files wait for each other."""

_LOOKED_EVERY: Final = 0.02  # s
_END: Final = b"\n }\n}\n"  # of run.json, whose last field has the files
_IGNORED: Final = (RUN, HELD, ".DS_Store", "Thumbs.db", "desktop.ini")  # file managers write theirs unasked
_TRIES: Final = 100  # to make a folder that another command may remove; in some places, as /proc, none can be made
_TEMPORARY: Final = re.compile(r"\.[0-9a-f]{32}\.tmp(\.\w+)?")
_NEW: Final = os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW
RENAME_EXCHANGE, _HERE = 2, -100  # of renameat2(2); AT_FDCWD
_CANNOT_LOCK: Final = (errno.ENOSYS, errno.ENOTSUP, errno.EOPNOTSUPP, errno.ENOLCK, errno.EINVAL)
# errors that do not depend on the path; EFBIG: the limit on the size of files (ulimit -f)
_MACHINE_AT_FAULT: Final = (errno.ENOSPC, errno.EDQUOT, errno.EIO, errno.EFBIG)


def not_written(path: str | Path, error: OSError | ValueError, what: str) -> DvrkCmaesError:
    """Return the error of a path that was not written: `InputError`, or `DvrkCmaesError` if the machine is at fault."""
    if isinstance(error, ValueError):  # a null character in the name
        return InputError(f"{str(path)!r}: not written ({error}); expected a place to write {what}")
    kind = DvrkCmaesError if error.errno in _MACHINE_AT_FAULT else InputError
    if isinstance(error, NotADirectoryError | FileExistsError) and os.path.isfile(path):
        return InputError(f"{path}: expected a folder to write, got a file of that name")
    reason = "a file lies where a folder is wanted" if isinstance(error, FileExistsError) else error.strerror
    return kind(f"{path}: not written ({reason}); expected a place to write {what}")


@contextlib.contextmanager
def _writing(path: str | Path, what: str) -> Iterator[None]:
    """Raise the error of `not_written` for errors of the system in the block."""
    try:
        yield
    except (OSError, ValueError) as error:
        raise not_written(path, error, what) from None


def check_no_link(path: Path) -> None:
    """Raise an InputError for a link in a place where something is to be written."""
    if path.is_symlink():
        raise InputError(
            f"{path}: expected a place to write, got a link; nothing is written, read or removed through it"
        )


def _digest(path: Path) -> str | None:
    """Return the SHA-256 of a regular file in hexadecimal; None if it cannot be read."""
    with contextlib.suppress(OSError), path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
    return None


def _temporary() -> str:
    return f".{uuid.uuid4().hex}.tmp"


def _remove_tree(path: Path) -> None:
    """Remove a file or a folder of a temporary name; links are removed, not followed."""
    with contextlib.suppress(OSError):
        path.unlink()
        return
    shutil.rmtree(path, ignore_errors=True)


def _remove_empty(folders: Iterable[Path]) -> None:
    for folder in folders:
        with contextlib.suppress(OSError):
            folder.rmdir()


@contextlib.contextmanager
def _made(folder: Path) -> Iterator[None]:
    """Make a folder and those above it; the new ones that stay empty are removed again."""
    new = [each for each in (folder, *folder.parents) if not each.exists()]
    folder.mkdir(parents=True, exist_ok=True)
    try:
        yield
    finally:
        _remove_empty(new)


def _files_in(folder: Path) -> list[str]:
    """Return the names in a folder, without what commands and file managers write on their own."""
    return [name for name in os.listdir(folder) if name not in _IGNORED and not _TEMPORARY.fullmatch(name)]


def _locked(folder: Path, command: str, wait: float) -> int:
    """Open and lock run.json of a folder, which must have it, or be empty; the lock goes when the process ends."""
    run, held, end = folder / RUN, folder / HELD, time.monotonic() + wait
    while True:
        check_no_link(run)
        if (others := _files_in(folder)) and not run.exists():
            raise InputError(
                f"{folder}: expected a new or empty folder, or one of an earlier {command}, got one with "
                f"{min(others)}; nothing was changed"
            )
        opened = os.open(run, _NEW | os.O_NONBLOCK, 0o666)  # nor is a pipe waited for
        with contextlib.ExitStack() as closing:
            closing.callback(os.close, opened)
            locked = _lock(opened, held)
            if locked and run.exists() and os.path.samestat(run.stat(), os.fstat(opened)):
                closing.pop_all()
                return opened  # else another command has replaced the file meanwhile
            if not locked and time.monotonic() >= end:
                how = f", or remove {held} if none is" if held.exists() else ""
                raise DvrkCmaesError(
                    f"{folder}: another command is writing there; wait for it{how}, or choose another --out"
                )
        time.sleep(_LOOKED_EVERY)


def _lock(run: int, held: Path) -> bool:
    """Lock run.json, or else make the file that stands for the lock; returns whether no other command has it."""
    try:
        try:
            fcntl.flock(run, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            if error.errno not in _CANNOT_LOCK:
                raise
            held.touch(exist_ok=False)
    except (BlockingIOError, FileExistsError):
        return False
    return True


def _parsed(data: bytes, path: Path) -> tuple[dict[str, Any], dict[str, list[str]]]:
    """Return the document of a run.json without the files, and the digests of each file."""
    try:
        try:
            document = json.loads(data)
        except ValueError:  # its last note was cut off, as by a power cut
            document = json.loads(data[: data.rfind(b",\n")] + _END)
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path}: expected what an earlier run wrote, got another file ({error})") from None
    files = document.pop("files", None) if isinstance(document, dict) else None
    if not (isinstance(files, dict) and isinstance(document.get("command"), str)):
        raise InputError(f"{path}: expected what an earlier run wrote (command and files), got another file")
    noted = {name: [digest] if isinstance(digest, str) else digest for name, digest in files.items()}
    for name, digests in noted.items():
        if not isinstance(digests, list | None) or any(part in ("", ".", "..") for part in name.split("/")):
            raise InputError(f"{path}: files: expected paths in the folder and their digests, got {name[:200]!r}")
    return document, {name: digests for name, digests in noted.items() if digests is not None}


class Output:
    """An open and locked folder that a command writes to.

    ``files`` are its files with the digests that each may have, "" for any: that of its content, and until it is
    written again those before. ``written`` are those that were written since it was opened.
    """

    def __init__(self, path: Path, command: str, wait: float) -> None:
        """Lock the folder and read run.json; `InputError` if it is damaged or of another command."""
        self.path, self.command = path, command
        self.head: dict[str, Any] = {}
        self.files: dict[str, list[str]] = {}
        self.written: set[str] = set()
        self._status = path.stat()
        self._run, self._end, self._changed = _locked(path, command, wait), 0, False
        try:
            self._read()
        except BaseException:
            if os.fstat(self._run).st_size == 0:  # which could not be written, as on a full disk
                (path / RUN).unlink(missing_ok=True)
            self._release()
            raise

    def _read(self) -> None:
        data = os.pread(self._run, os.fstat(self._run).st_size, 0)
        if data:
            self.head, self.files = _parsed(data, self.path / RUN)
        if (command := self.head.pop("command", self.command)) != self.command:
            raise InputError(f"{self.path}: it has what `{command}` wrote, which stays as it is; choose another --out")
        if data.endswith(_END):
            self._end = len(data) - len(_END)
        elif not data:
            self.describe()

    def describe(self, head: Mapping[str, Any] | None = None) -> None:
        """Write run.json anew, with what the results depend on, if that is given; it is locked before it is renamed."""
        self.head = self.head if head is None else dict(head)
        begin = json.dumps({"command": self.command, **self.head, "files": {}}, indent=1, ensure_ascii=False)
        known = {name: digests[0] if len(digests) == 1 else digests for name, digests in sorted(self.files.items())}
        files = (f"\n  {json.dumps(name)}: {json.dumps(digests)}" for name, digests in known.items())
        data = begin[: -len("}\n}")].encode() + ",".join(files).encode() + _END
        temporary = self.path / _temporary()
        run = os.open(temporary, _NEW | os.O_EXCL, 0o666)
        with contextlib.ExitStack() as undone:
            undone.callback(_remove_tree, temporary)
            undone.callback(os.close, run)
            _lock(run, self.path / HELD)
            with open(run, "wb", closefd=False) as file:
                file.write(data)
            os.replace(temporary, self.path / RUN)
            undone.pop_all()
        os.close(self._run)
        self._run, self._end, self._changed = run, len(data) - len(_END), False

    def note(self, name: str, digest: str | None) -> None:
        """Note the digest of a file that is written next, "" if it is not known yet, None for one that is removed.

        Of a process that is killed before it writes the file, that is as it was before.
        """
        if not self._end:  # run.json was cut off, or written by another program
            self.describe()
        digests = self.files.pop(name, [])
        if digest is not None:
            self.files[name] = [*digests, digest]
        before = os.pread(self._run, 1, self._end - 1)
        entry = f"{'' if before == b'{' else ','}\n  {json.dumps(name)}: {json.dumps(self.files.get(name))}".encode()
        if os.pwrite(self._run, entry + _END, self._end) < len(entry + _END):  # the disk is full
            os.pwrite(self._run, _END, self._end)
            os.ftruncate(self._run, self._end + len(_END))
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        self._end, self._changed = self._end + len(entry), True

    def reached(self, name: str) -> Path:
        """Return the path of what has a name in the folder; InputError if it, or a part above it, is a link or a file.

        Nor may the folder itself have been replaced since it was opened.
        """
        if not os.path.samestat(self.path.stat(), self._status):
            raise InputError(f"{self.path}: expected the folder in which the command began, got another one")
        place = self.path / name
        for part in reversed((place, *place.parents[: name.count("/")])):
            check_no_link(part)
            if part != place and part.is_file():
                raise InputError(f"{part}: expected a folder to write to, but a file is there")
        return place

    def admit(self, name: str) -> Path:
        """Return the path of a file, which may be there if it is the command's; InputError otherwise."""
        place = self.reached(name)
        if place.is_dir():
            raise InputError(f"{place}: expected a file, or none yet, but a folder is there")
        own = self.files.get(name, [])
        if place.exists() and not (own and place.is_file() and ({"", _digest(place)} & {*own} or _is_cut(place))):
            raise InputError(
                f"{self.path}: {name} was not written by `{self.command}`, or changed since; choose another --out, or "
                "move it"
            )
        return place

    def refuse(self, names: Iterable[str]) -> None:
        """Raise `InputError` if a file of these names is there that the command did not write, or changed since."""
        for name in names:
            self.admit(name)

    def remove(self, name: str) -> None:
        """Remove a file of the command, if it is there, and the folders that are empty then; InputError for others."""
        place = self.admit(name)
        if place.exists():
            place.unlink()
            self.note(name, None)
            _remove_empty(place.parents[: name.count("/")])

    def remove_stale(self) -> None:
        """Remove the files that run.json lists and that were not written since the folder was opened.

        None is removed if one of them was changed since it was written.
        """
        stale = self.files.keys() - self.written
        self.refuse(stale)
        for name in stale:
            self.remove(name)

    def others(self, kept: Collection[str] = ()) -> list[str]:
        """Return the files that the command did not write, without those in subfolders that are ``kept``.

        Of a folder below that another command writes to, only its run.json. What killed processes left half written is
        removed. InputError if a link is there.
        """
        found = []
        for root, folders, files in os.walk(self.path):
            here, begin = Path(root), "" if root == str(self.path) else f"{Path(root).relative_to(self.path)}/"
            if begin and RUN in files:
                folders.clear()
                found.append(begin + RUN)
                continue
            for name in (*folders, *files):
                if _TEMPORARY.fullmatch(name):
                    _remove_tree(here / name)
                    continue
                check_no_link(here / name)
                if name in files and name not in _IGNORED and begin + name not in self.files:
                    found.append(begin + name)
            folders[:] = [name for name in folders if not _TEMPORARY.fullmatch(name)]
        return [name for name in found if name.partition("/")[0] not in kept]

    def check(self, kept: Collection[str] | None) -> None:
        """Check what is in the folder; ``kept`` as of `output`."""
        others = self.others(kept or ())
        if kept is not None and others:
            raise InputError(
                f"{self.path}: {others[0]} was not written by `{self.command}`; choose another --out, or move it"
            )
        self.refuse(() if kept is None else self.files)

    def close(self) -> None:
        """Write run.json, or remove it if nothing is in the folder, and give the lock back."""
        with contextlib.ExitStack() as ended, _writing(self.path, "results"):
            ended.callback(self._release)
            if not self.files and not _files_in(self.path):
                (self.path / RUN).unlink(missing_ok=True)
            elif self._changed:
                self.describe()

    def _release(self) -> None:
        (self.path / HELD).unlink(missing_ok=True)
        os.close(self._run)


class _Opened(threading.local):
    """The folders that this thread has opened, by their path: another thread may close its own ones at any time."""

    def __init__(self) -> None:
        self.outputs: dict[Path, Output] = {}


_opened = _Opened()


def _nearest(path: Path) -> tuple[Output | None, str]:
    """Return the innermost open folder that holds a path, and the path in it."""
    place = Path(os.path.abspath(path))
    for folder in (place, *place.parents):
        if folder in _opened.outputs:
            return _opened.outputs[folder], place.relative_to(folder).as_posix()
    return None, place.name


def _is_cut(path: Path) -> bool:
    """Whether a file was cut off, as by a power cut: an empty one, or a document without its end."""
    text = path.read_bytes().strip(b"\0 \n")
    return not text or (text.startswith(b"{") and not text.endswith(b"}"))


@contextlib.contextmanager
def output(
    path: str | Path, command: str, *, kept: Collection[str] | None = None, wait: float = 0.0
) -> Iterator[Output]:
    """Open a folder to write to, and lock it; it is made if it is not there, and removed again if nothing was written.

    Parameters
    ----------
    path
        The folder: new, empty, or of an earlier run of the command. If it is open already, that is used.
    command
        The command that writes.
    kept
        Of a folder that is replaced as a whole, subfolders that stay: apart from them it must have no files but those
        of its run.json, none of which was changed since.
    wait
        Seconds to wait for another command that writes there.

    Raises
    ------
    InputError
        Something in the folder is a link; the folder has files of the user or of another command; it cannot be made or
        written to.
    DvrkCmaesError
        Another command is writing there, or the disk is full.
    """
    path = Path(path)
    place = Path(os.path.abspath(path))
    with contextlib.ExitStack() as opened:
        with _writing(path, "results"):
            tries = 0
            while (out := _opened.outputs.get(place)) is None:
                tries += 1
                above, name = _nearest(path)
                if above is not None:
                    above.reached(name)
                with contextlib.ExitStack() as attempt, contextlib.suppress(*[FileNotFoundError] * (tries < _TRIES)):
                    attempt.enter_context(_made(path))  # which another command may remove that wrote nothing
                    _opened.outputs[place] = own = Output(path, command, wait)
                    opened.push(attempt.pop_all())
                    opened.callback(own.close)
                    opened.callback(_opened.outputs.pop, place)
            out.check(kept)
        yield out


def check_files(path: Path, command: str, names: Iterable[str]) -> None:
    """Check, before any work, that a command may write files to a folder; errors as of `output`."""
    with output(path, command, wait=LONG) as out:
        out.refuse(names)


def write_bytes(path: str | Path, data: bytes) -> None:
    """Write a file, creating the folders above it; an existing file is replaced once the new one is complete.

    Raises
    ------
    InputError
        The path cannot be written to; in an output folder, the file is the user's, or there is a link.
    DvrkCmaesError
        The disk is full or failing.
    """
    with _writing(path, "a file"), whole_file(Path(path), "a file") as made:
        made.write_bytes(data)


def remove(path: Path) -> None:
    """Remove a file in an open output folder, if it is there; InputError for a file of the user."""
    out, name = _nearest(path)
    if out is not None:
        with _writing(path, "a file"):
            out.remove(name)


@contextlib.contextmanager
def whole_file(path: Path, what: str) -> Iterator[Path]:
    """Give a temporary path with the same extension in the same folder, for a program that writes files itself.

    The file is renamed to the target at the end, or removed after an error. ``what`` is named in messages. Errors are
    those of ``write_bytes``.
    """
    with contextlib.ExitStack() as opened:
        with _writing(path, what):
            out, name = _nearest(path)
            place = path if out is None else out.admit(name)
            opened.enter_context(_made(place.parent))
        made = place.with_name(_temporary() + place.suffix)
        opened.callback(_remove_tree, made)
        yield made
        with _writing(path, what):
            if out is not None:
                digest = _digest(made) or ""
                out.admit(name)
                out.note(name, digest)
            os.replace(made, place)
            if out is not None:
                out.files[name] = [digest]
                out.written.add(name)


@contextlib.contextmanager
def whole_folder(
    path: str | Path,
    command: str,
    *,
    overwrite: bool = False,
    kept: Collection[str] = (),
    source: str | Path | None = None,
) -> Iterator[Path]:
    """Yield a temporary folder, which takes the place of the target at the end, or is removed after an error.

    At any moment the target is as it was, or whole. Files that are added to it meanwhile are kept.

    Parameters
    ----------
    path
        The target; it must not exist or be empty, unless ``overwrite``.
    command
        The command that writes it.
    overwrite
        Replace an existing folder of the same command, if it has no file that was added or changed since.
    kept
        Subfolders of the earlier folder that are in the new one from the start.
    source
        A file or folder that is read meanwhile; it must not lie in the target.

    Raises
    ------
    InputError
        The target exists already, or cannot be written to.
    DvrkCmaesError
        The disk is full or failing. In errors raised by the block, the temporary path is replaced by ``path``.
    """
    path = Path(path)
    real, temporary = Path(os.path.realpath(path)), path / _temporary()
    try:
        if source is not None and real in ((read := Path(os.path.realpath(source))), *read.parents):
            raise InputError(f"{path}: expected a folder apart from {source}, got one that holds it")
        if not overwrite and path.is_dir() and _files_in(path):
            raise InputError(
                f"{path}: expected a new or empty folder, got one with files in it (--overwrite replaces it)"
            )
        apart = real.with_name(temporary.name)
        with contextlib.ExitStack() as left, output(path, command, kept=kept) as out, contextlib.ExitStack() as inner:
            left.callback(_remove_tree, apart)
            inner.callback(_remove_tree, temporary)
            with output(temporary, command) as made:
                for name in kept:
                    if (path / name).is_dir():
                        shutil.copytree(path / name, temporary / name, symlinks=True, copy_function=_link)
                made.files |= {name: digests for name, digests in out.files.items() if name.partition("/")[0] in kept}
                yield temporary
                for name in made.others(kept):
                    made.note(name, _digest(temporary / name))
            os.rename(temporary, apart)
            out.check(kept)  # files may have been added meanwhile
            _exchange(apart, real)
            out.path = apart
            for name in out.others(kept):  # added in the last moment
                (real / name).parent.mkdir(parents=True, exist_ok=True)
                os.rename(apart / name, real / name)
            out.path, out.files = path, made.files  # of the new folder, whose run.json is written
    except DvrkCmaesError as error:
        raise type(error)(str(error).replace(str(temporary), str(path))) from None
    except (OSError, ValueError) as error:
        raise not_written(path, error, "a folder") from None


def _link(source: str, target: str) -> None:
    """Give a file a second name; it is copied where the file system has none."""
    try:
        os.link(source, target, follow_symlinks=False)
    except OSError:
        shutil.copy2(source, target, follow_symlinks=False)


def _exchange(first: Path, second: Path) -> None:
    """Exchange the names of two folders, in one step where the system can."""
    library = ctypes.CDLL(None, use_errno=True)
    names = (_HERE, os.fsencode(first), _HERE, os.fsencode(second))
    if hasattr(library, "renameat2") and library.renameat2(*names, RENAME_EXCHANGE) == 0:
        return
    apart = first.with_name(_temporary())
    os.rename(second, apart)
    try:
        os.rename(first, second)
    except OSError:
        os.rename(apart, second)
        raise
    os.rename(apart, first)
