"""The folder that a command writes to: FOLDER/run.json names the command, what it was run with, and its files.

A command writes to a new or empty folder, or to one whose run.json it wrote. It locks run.json, and notes each file
there with its SHA-256 before the file is written. A file that is not noted, or has another content since, is the
user's: it is neither replaced nor removed. Files are opened by the handle of their folder, and no link in the output
folder is followed. Each file is written under a temporary name in the same folder, and renamed.
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
import stat
import threading
import time
import uuid
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import IO, Any, Final

from dvrk_cmaes.errors import DvrkCmaesError, InputError

RUN: Final = "run.json"
HELD: Final = ".lock"
"""The file that stands for the lock where the file system has none."""
LONG: Final = 600.0
"""Seconds for which commands that write a few files wait for each other."""

_LOOKED_EVERY: Final = 0.02  # s
_LARGEST: Final = 500_000_000  # bytes of run.json
_END: Final = b"\n }\n}\n"  # of run.json, whose last field has the files
_IGNORED: Final = (RUN, HELD, ".DS_Store", "Thumbs.db", "desktop.ini")  # file managers write theirs unasked
_TEMPORARY: Final = re.compile(r"\.[0-9a-f]{32}\.tmp")
_FOLDER: Final = os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC
_NO_LINK: Final = os.O_NOFOLLOW | os.O_CLOEXEC | os.O_NONBLOCK  # nor is a pipe waited for
RENAME_EXCHANGE: Final = 2  # of renameat2(2)
_CANNOT_LOCK: Final = (errno.ENOSYS, errno.ENOTSUP, errno.EOPNOTSUPP, errno.ENOLCK, errno.EINVAL)
# errors that do not depend on the path; EFBIG: the limit on the size of files (ulimit -f)
_MACHINE_AT_FAULT: Final = (errno.ENOSPC, errno.EDQUOT, errno.EIO, errno.EFBIG)


def not_written(path: str | Path, error: OSError | ValueError, what: str) -> DvrkCmaesError:
    """Return the error of a path that was not written: `InputError`, or `DvrkCmaesError` if the machine is at fault."""
    if isinstance(error, ValueError):  # a null character in the name
        return InputError(f"{str(path)!r}: not written ({error}); expected a place to write {what}")
    kind = DvrkCmaesError if error.errno in _MACHINE_AT_FAULT else InputError
    if isinstance(error, NotADirectoryError) and os.path.isfile(path):
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


def _status(folder: int, name: str, path: Path) -> os.stat_result | None:
    """Return the status of a file in an open folder, None if there is none; `InputError` if it is a link."""
    try:
        found = os.stat(name, dir_fd=folder, follow_symlinks=False)
    except FileNotFoundError:
        return None
    if stat.S_ISLNK(found.st_mode):
        raise InputError(
            f"{path}: expected a place to write, got a link; nothing is written, read or removed through it"
        )
    return found


def _open(folder: int, name: str, flags: int) -> int:
    return os.open(name, flags | _NO_LINK, 0o666, dir_fd=folder)


def _digest(folder: int, name: str) -> str | None:
    """Return the SHA-256 of a regular file in hexadecimal; None if there is none, or something else."""
    with contextlib.suppress(OSError), open(_open(folder, name, os.O_RDONLY), "rb") as file:
        return (
            hashlib.file_digest(file, "sha256").hexdigest() if stat.S_ISREG(os.fstat(file.fileno()).st_mode) else None
        )
    return None


def _temporary() -> str:
    return f".{uuid.uuid4().hex}.tmp"


@contextlib.contextmanager
def _inner(folder: int, path: Path, parts: Sequence[str], *, make: bool = True) -> Iterator[int]:
    """Open a folder below an open one, no part of which may be a link; those that are made and stay empty go again."""
    with contextlib.ExitStack() as opened:
        for part in parts:
            path = path / part
            found = _status(folder, part, path)
            if found is not None and not stat.S_ISDIR(found.st_mode):
                raise InputError(f"{path}: expected a folder to write to, but a file is there")
            if make and found is None:
                with contextlib.suppress(FileExistsError):
                    os.mkdir(part, dir_fd=folder)
                    opened.callback(_remove_empty, folder, part)
            folder = os.open(part, _FOLDER | os.O_NOFOLLOW, dir_fd=folder)
            opened.callback(os.close, folder)
        yield folder


def _remove_empty(folder: int, name: str) -> None:
    with contextlib.suppress(OSError):
        os.rmdir(name, dir_fd=folder)


@contextlib.contextmanager
def _folder(path: Path, below: Path | None = None) -> Iterator[int]:
    """Open a folder, made if it is not there: below an open output, or below ``below``, no part may be a link."""
    out, name = _nearest(path)
    if out is not None:
        with _inner(out.folder, out.path, Path(name).parts) as folder:
            yield folder
        return
    there = path if below is None else below
    while not there.exists() and there != there.parent:
        there = there.parent
    top = os.open(there, _FOLDER)
    try:
        with _inner(top, there, path.relative_to(there).parts) as folder:
            yield folder
    finally:
        os.close(top)


def _locked(folder: int, path: Path, command: str, wait: float) -> int:
    """Open and lock run.json of a folder, which must have it, or be empty; the lock goes when the process ends."""
    end = time.monotonic() + wait
    while True:
        if _status(folder, RUN, path / RUN) is None:
            others = [name for name in os.listdir(folder) if name not in _IGNORED and not _TEMPORARY.fullmatch(name)]
            if others and _status(folder, RUN, path / RUN) is None:
                raise InputError(
                    f"{path}: expected a new or empty folder, or one of an earlier {command}, got one with "
                    f"{min(others)}; nothing was changed"
                )
        run = _open(folder, RUN, os.O_RDWR | os.O_CREAT)
        try:
            if _lock(folder, run):
                there = _status(folder, RUN, path / RUN)
                if there is not None and there.st_ino == os.fstat(run).st_ino:
                    return run  # else another command has replaced the file meanwhile
            elif time.monotonic() >= end:
                held = f", or remove {path / HELD} if none is" if _status(folder, HELD, path / HELD) else ""
                raise DvrkCmaesError(
                    f"{path}: another command is writing there; wait for it{held}, or choose another --out"
                )
            else:
                time.sleep(_LOOKED_EVERY)
        except BaseException:
            os.close(run)
            raise
        os.close(run)


def _lock(folder: int, run: int) -> bool:
    """Lock run.json; returns whether no other command has it."""
    try:
        fcntl.flock(run, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError as error:
        if error.errno not in _CANNOT_LOCK:
            raise
        try:
            os.close(_open(folder, HELD, os.O_CREAT | os.O_EXCL))
        except FileExistsError:
            return False
    return True


class _Noted(dict[str, Any]):
    """An object of JSON; ``pairs`` has all values of a name that is there more than once."""

    def __init__(self, pairs: list[tuple[str, Any]]) -> None:
        super().__init__(pairs)
        self.pairs = pairs


def _parsed(data: bytes, path: Path) -> tuple[dict[str, Any], dict[str, list[str | None]]]:
    """Return the document of a run.json without the files, and all digests that were noted of each file."""
    try:
        try:
            document = json.loads(data, object_pairs_hook=_Noted)
        except ValueError:  # its last note was cut off, as by a power cut
            document = json.loads(data[: data.rfind(b",\n")] + _END, object_pairs_hook=_Noted)
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path}: expected what an earlier run wrote, got another file ({error})") from None
    files = document.pop("files", None) if isinstance(document, _Noted) else None
    if not (isinstance(files, _Noted) and isinstance(document.get("command"), str)):
        raise InputError(f"{path}: expected what an earlier run wrote (command and files), got another file")
    noted: dict[str, list[str | None]] = {}
    for name, digest in files.pairs:
        if not (digest is None or isinstance(digest, str)) or any(part in ("", ".", "..") for part in name.split("/")):
            raise InputError(f"{path}: files: expected paths in the folder and their digests, got {name[:200]!r}")
        noted.setdefault(name, []).append(digest)
    return document, noted


class Output:
    """An open and locked folder that a command writes to. ``files`` are its files with their digests, "" if unknown."""

    def __init__(self, path: Path, folder: int, command: str, wait: float) -> None:
        """Lock the folder and read run.json; `InputError` if it is damaged or of another command."""
        self.path, self.folder, self.command = path, folder, command
        self.head: dict[str, Any] = {}
        self.files: dict[str, str] = {}
        self.replaced = True  # not to be changed by this command
        self._run, self._end, self._changed = _locked(folder, path, command, wait), 0, False
        try:
            self._read()
            self.replaced = False
        except BaseException:
            self.close()
            raise

    def _read(self) -> None:
        if os.fstat(self._run).st_size > _LARGEST:
            raise InputError(f"{self.path / RUN}: expected what an earlier run wrote, got a larger file")
        data = os.pread(self._run, _LARGEST, 0)
        if not data:
            self.replaced = False
            self.write_list()
            return
        self.head, noted = _parsed(data, self.path / RUN)
        command = self.head.pop("command")
        self.files = {name: digests[-1] for name, digests in noted.items() if digests[-1] is not None}
        if command != self.command:
            raise InputError(f"{self.path}: it has what `{command}` wrote, which stays as it is; choose another --out")
        for name, digests in noted.items():  # of a process that was killed after its note, the file is as it was before
            if len(digests) > 1:
                with contextlib.suppress(OSError, InputError), self._reached(name) as (folder, last):
                    if (digest := _digest(folder, last)) is not None and digest in digests:
                        self.files[name] = digest
        self._end = len(data) - len(_END) if data.endswith(_END) else 0  # 0: it is written anew before a note

    def write_list(self) -> None:
        """Write run.json anew; the new one is locked before it takes the place of the old one."""
        head = json.dumps({"command": self.command, **self.head, "files": {}}, indent=1, ensure_ascii=False)
        files = (f"\n  {json.dumps(name)}: {json.dumps(digest)}" for name, digest in sorted(self.files.items()))
        data = head[: -len("}\n}")].encode() + ",".join(files).encode() + _END
        run = _write(self.folder, RUN, data, lock=True)
        os.close(self._run)
        self._run, self._end, self._changed = run, len(data) - len(_END), False

    def describe(self, head: Mapping[str, Any]) -> None:
        """State in run.json what the results depend on."""
        self.head = dict(head)
        self.write_list()

    def note(self, name: str, digest: str | None) -> None:
        """Note the digest of a file that is written next, "" if it is not known yet, None for one that is removed."""
        if not self._end:
            self.write_list()
        before = os.pread(self._run, 1, self._end - 1)
        entry = f"{'' if before == b'{' else ','}\n  {json.dumps(name)}: {json.dumps(digest)}".encode()
        if os.pwrite(self._run, entry + _END, self._end) < len(entry + _END):  # the disk is full
            os.pwrite(self._run, _END, self._end)
            os.ftruncate(self._run, self._end + len(_END))
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        self._end, self._changed = self._end + len(entry), True
        self._set(name, digest)

    def _set(self, name: str, digest: str | None) -> None:
        self.files.pop(name, None)
        if digest is not None:
            self.files[name] = digest

    @contextlib.contextmanager
    def _reached(self, name: str, *, make: bool = False) -> Iterator[tuple[int, str]]:
        *above, last = name.split("/")
        with _inner(self.folder, self.path, above, make=make) as folder:
            yield folder, last

    def check(self, *, whole: bool = False, replaces: bool = False, kept: Collection[str] = ()) -> None:
        """Check what is in the folder, and remove what killed processes left half written; arguments as of `output`."""
        for name in self._walk():
            if whole and name not in self.files and name.partition("/")[0] not in kept:
                raise InputError(
                    f"{self.path}: {name} was not written by `{self.command}`; choose another --out, or move it"
                )
        if replaces:
            self.refuse(self.files)

    def _walk(self) -> Iterator[str]:
        """Yield the files in the folder; of a folder below that another command writes to, only its run.json."""
        for root, folders, files, handle in os.fwalk(".", dir_fd=self.folder):
            begin = "" if root == "." else f"{root[2:]}/"
            if begin and RUN in files:
                folders.clear()
                yield begin + RUN
                continue
            for name in (*folders, *files):
                if _TEMPORARY.fullmatch(name):
                    _remove_tree(handle, name)
                elif _status(handle, name, self.path / begin / name) and name in files and name not in _IGNORED:
                    yield begin + name
            folders[:] = [name for name in folders if not _TEMPORARY.fullmatch(name)]

    def refuse(self, names: Iterable[str]) -> None:
        """Raise `InputError` if a file of these names is there that the command did not write, or changed since."""
        for name in tuple(names):
            with contextlib.suppress(FileNotFoundError), self._reached(name) as (folder, last):
                self._admit(folder, name, last)

    def _admit(self, folder: int, name: str, last: str) -> bool:
        """Return whether a file is there; InputError unless it is the command's."""
        found = _status(folder, last, self.path / name)
        if found is None:
            return False
        if stat.S_ISDIR(found.st_mode):
            raise InputError(f"{self.path / name}: expected a file, or none yet, but a folder is there")
        own = self.files.get(name)
        regular = stat.S_ISREG(found.st_mode)
        if not regular or own is None or (own not in ("", _digest(folder, last)) and not _is_cut(folder, last)):
            raise InputError(
                f"{self.path}: {name} was not written by `{self.command}`, or changed since; choose another --out, or "
                "move it"
            )
        return True

    def remove(self, name: str) -> None:
        """Remove a file of the command, if it is there; InputError for another one."""
        with contextlib.suppress(FileNotFoundError), self._reached(name) as (folder, last):
            if self._admit(folder, name, last):
                os.unlink(last, dir_fd=folder)
                self.note(name, None)

    def clear(self) -> None:
        """Remove all files that run.json lists, and the folders that are empty then."""
        names = sorted(self.files)
        for name in names:
            self.remove(name)
        for name in sorted({name.rpartition("/")[0] for name in names} - {""}, key=lambda name: -name.count("/")):
            with contextlib.suppress(FileNotFoundError), self._reached(name) as (folder, last):
                _remove_empty(folder, last)
        self.head, self.files = {}, {}
        self.write_list()

    def close(self) -> None:
        """Write run.json, or remove it if nothing is in the folder, and give the lock back."""
        try:
            if not self.replaced and not self.files and set(os.listdir(self.folder)) <= {RUN, HELD}:
                os.unlink(RUN, dir_fd=self.folder)
            elif not self.replaced and self._changed:
                self.write_list()
        finally:
            with contextlib.suppress(FileNotFoundError):
                os.unlink(HELD, dir_fd=self.folder)
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


def _is_cut(folder: int, name: str) -> bool:
    """Whether a file was cut off, as by a power cut: an empty one, or a document without its end."""
    with open(_open(folder, name, os.O_RDONLY), "rb") as file:
        text = file.read().strip(b"\0 \n")
    return not text or (text.startswith(b"{") and not text.endswith(b"}"))


def _remove_tree(folder: int, name: str) -> None:
    """Remove a file or a folder of a temporary name; links are removed, not followed."""
    with contextlib.suppress(OSError):
        os.unlink(name, dir_fd=folder)
        return
    shutil.rmtree(name, ignore_errors=True, dir_fd=folder)


@contextlib.contextmanager
def output(
    path: str | Path,
    command: str,
    *,
    below: Path | None = None,
    whole: bool = False,
    replaces: bool = False,
    kept: Collection[str] = (),
    wait: float = 0.0,
) -> Iterator[Output]:
    """Open a folder to write to, and lock it; it is made if it is not there, and removed again if nothing was written.

    Parameters
    ----------
    path
        The folder: new, empty, or of an earlier run of the command. If it is open already, that is used.
    command
        The command that writes.
    below
        A folder, whose own links are followed, from which on no part of the path may be a link.
    whole
        Whether the folder is replaced as a whole: it must have no files but those of its run.json.
    replaces
        Whether the files of run.json are replaced: none may have been changed since.
    kept
        Of a folder that is replaced as a whole, subfolders that stay.
    wait
        Seconds to wait for another command that writes there.

    Raises
    ------
    InputError
        A part of the path, or something in the folder, is a link; the folder has files of the user or of another
        command; it cannot be made or written to.
    DvrkCmaesError
        Another command is writing there, or the disk is full.
    """
    path = Path(path)
    place = Path(os.path.abspath(path))
    with contextlib.ExitStack() as opened:
        with _writing(path, "results"):
            while (out := _opened.outputs.get(place)) is None:
                with contextlib.ExitStack() as attempt:
                    folder = attempt.enter_context(_folder(path, below))
                    with contextlib.suppress(FileNotFoundError):  # removed by another command, which wrote nothing
                        _opened.outputs[place] = own = Output(path, folder, command, wait)
                        opened.push(attempt.pop_all())
                        opened.callback(_close, own)
                        opened.callback(_opened.outputs.pop, place)
            out.check(whole=whole, replaces=replaces, kept=kept)
        yield out


def _close(out: Output) -> None:
    with _writing(out.path, "results"):
        out.close()


def opened_output(path: Path) -> Output:
    """Return the output folder at a path, which is open."""
    return _opened.outputs[Path(os.path.abspath(path))]


def check_files(path: Path, command: str, names: Iterable[str]) -> None:
    """Check, before any work, that a command may write files to a folder; errors as of `output`."""
    with output(path, command, wait=LONG) as out:
        out.refuse(names)


def _write(folder: int, name: str, data: bytes, *, lock: bool = False) -> int:
    """Write a file under a temporary name, and rename it; returns its open descriptor."""
    temporary = _temporary()
    opened = _open(folder, temporary, os.O_RDWR | os.O_CREAT | os.O_EXCL)
    try:
        if lock:
            _lock(folder, opened)
        with open(opened, "wb", closefd=False) as file:
            file.write(data)
        os.replace(temporary, name, src_dir_fd=folder, dst_dir_fd=folder)
    except BaseException:
        os.close(opened)
        _remove_tree(folder, temporary)
        raise
    return opened


@contextlib.contextmanager
def _target(path: Path) -> Iterator[tuple[int, Output | None, str, str]]:
    """Open the folder of a file that is written; returns the open output, the file's path in it, and its name."""
    out, name = _nearest(path)
    if out is None:
        with _folder(path.parent) as folder:
            yield folder, None, name, path.name
    else:
        with out._reached(name, make=True) as (folder, last):
            out._admit(folder, name, last)
            yield folder, out, name, last


def write_bytes(path: str | Path, data: bytes) -> None:
    """Write a file, creating the folders above it; an existing file is replaced once the new one is complete.

    Raises
    ------
    InputError
        The path cannot be written to; in an output folder, the file is the user's, or there is a link.
    DvrkCmaesError
        The disk is full or failing.
    """
    with _writing(path, "a file"), _target(Path(path)) as (folder, out, name, last):
        before = None if out is None else out.files.get(name)
        if out is not None:
            out.note(name, hashlib.sha256(data).hexdigest())
        try:
            os.close(_write(folder, last, data))
        except BaseException:
            if out is not None:
                out._set(name, before)
            raise


def remove(path: Path) -> None:
    """Remove a file that a command wrote, if it is there; InputError for a file of the user."""
    out, name = _nearest(path)
    with _writing(path, "a file"):
        if out is None:
            path.unlink(missing_ok=True)
        else:
            out.remove(name)


@contextlib.contextmanager
def written_beside(path: Path, what: str) -> Iterator[Path]:
    """Give a path of the same name, in a temporary folder, for a program that writes files itself.

    Its file is renamed to the target at the end, or removed after an error. ``what`` is named in messages. Errors are
    those of ``write_bytes``.
    """
    with contextlib.ExitStack() as opened:
        with _writing(path, what):
            folder, out, name, last = opened.enter_context(_target(path))
            temporary = _temporary()
            os.mkdir(temporary, dir_fd=folder)
            opened.callback(_remove_tree, folder, temporary)
            inner = opened.enter_context(_inner(folder, path.parent, [temporary]))
        yield path.parent / temporary / last
        with _writing(path, what):
            if out is not None:
                out._admit(folder, name, last)
                out.note(name, _digest(inner, last) or "")
            os.replace(last, last, src_dir_fd=inner, dst_dir_fd=folder)


@contextlib.contextmanager
def appended(path: Path, begin: bytes) -> Iterator[IO[bytes]]:
    """Open a new file to append to, with its beginning; each write is in the file at once. Errors: as `write_bytes`.

    In an output folder, an earlier file is replaced if it is the command's.
    """
    with _writing(path, "results"), _target(path) as (folder, out, name, last):
        if out is not None:
            out.note(name, "")
        with open(_write(folder, last, begin), "ab", buffering=0) as file:
            yield file
        if out is not None:
            out.note(name, _digest(folder, last) or "")


@contextlib.contextmanager
def whole_folder(
    path: str | Path,
    command: str,
    *,
    overwrite: bool = False,
    kept: Sequence[str] = (),
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
    path = temporary = Path(path)
    try:
        real = Path(os.path.realpath(path))
        begin = hashlib.sha256(os.fsencode(real)).hexdigest()[:16]
        temporary = real.with_name(f".{begin}{uuid.uuid4().hex[:16]}.tmp")
        if source is not None and real in ((read := Path(os.path.realpath(source))), *read.parents):
            raise InputError(f"{path}: expected a folder apart from {source}, got one that holds it")
        if not overwrite and path.is_dir() and any(name not in (RUN, HELD) for name in os.listdir(path)):
            raise InputError(
                f"{path}: expected a new or empty folder, got one with files in it (--overwrite replaces it)"
            )
        with contextlib.ExitStack() as opened:
            out = opened.enter_context(output(path, command, whole=True, replaces=overwrite, kept=kept))
            above = os.open("..", _FOLDER, dir_fd=out.folder)
            opened.callback(os.close, above)
            for name in os.listdir(above):  # what killed processes left for the same target
                if re.fullmatch(rf"\.{begin}[0-9a-f]{{16}}\.tmp", name):
                    _remove_tree(above, name)
            opened.callback(_remove_tree, above, temporary.name)
            with output(temporary, command) as made:
                for name in kept:
                    if (path / name).is_dir():
                        shutil.copytree(path / name, temporary / name, symlinks=True, copy_function=_link)
                made.files |= {name: digest for name, digest in out.files.items() if name.partition("/")[0] in kept}
                yield temporary
                for name in made._walk():
                    if name not in made.files and name.partition("/")[0] not in kept:
                        with made._reached(name) as (folder, last):
                            made.note(name, _digest(folder, last))
                out.check(whole=True, replaces=True, kept=kept)  # files may have been added meanwhile
                made.write_list()
                _exchange(above, temporary.name, real.name)
                out.replaced = True
                for name in list(out._walk()):  # added in the last moment
                    if name not in out.files and name.partition("/")[0] not in kept:
                        with out._reached(name) as (folder, last), made._reached(name, make=True) as (to, _):
                            os.rename(last, last, src_dir_fd=folder, dst_dir_fd=to)
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


def _exchange(above: int, first: str, second: str) -> None:
    """Exchange the names of two folders, in one step where the system can."""
    library = ctypes.CDLL(None, use_errno=True)
    if hasattr(library, "renameat2"):
        names = os.fsencode(first), os.fsencode(second)
        if library.renameat2(above, names[0], above, names[1], RENAME_EXCHANGE) == 0:
            return
    apart = _temporary()
    os.rename(second, apart, src_dir_fd=above, dst_dir_fd=above)
    try:
        os.rename(first, second, src_dir_fd=above, dst_dir_fd=above)
    except OSError:
        os.rename(apart, second, src_dir_fd=above, dst_dir_fd=above)
        raise
    os.rename(apart, first, src_dir_fd=above, dst_dir_fd=above)
