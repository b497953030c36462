"""The folder that a command writes to: opened once, locked, and with a list of the files that were written to it.

All files are written and removed by the functions of this module. Below a folder that is open (`output`, `base`), they
work relative to its handle and follow no links. FOLDER/.written.json names the command that writes to a folder, and the
SHA-256 of each of its files. A file that is not in the list, or has another content since, is the user's: it is neither
replaced nor removed. FOLDER/.written.new has the files since the list was written, a line for each, so that the list is
complete after a process was killed, too.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import re
import stat
import threading
import uuid
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from pathlib import Path
from typing import IO, Final

import msgspec

from dvrk_cmaes.errors import DvrkCmaesError, InputError
from dvrk_cmaes.io.folder_lock import HELD, LOCK, locked
from dvrk_cmaes.io.handles import Folder, not_written, opened_above
from dvrk_cmaes.io.prepared_type import prepared

RECORD: Final = ".written.json"
JOURNAL: Final = ".written.new"
LONG: Final = 600.0
"""Seconds for which commands that write a few files wait for each other."""

_OWN: Final = (RECORD, JOURNAL, LOCK, HELD)
_DESKTOP: Final = (".DS_Store", "Thumbs.db", "desktop.ini")  # of file managers, which write them unasked
_TEMPORARY: Final = re.compile(r"\.[0-9a-f]{32}\.tmp")
_ANY: Final = ""  # in the place of a digest: a file that is being written
_LARGEST: Final = 500_000_000  # bytes of a list


class Written(msgspec.Struct):
    """What a command wrote to a folder: digests of files by their path in the folder."""

    command: str
    files: dict[str, str] = {}


def _temporary() -> str:
    return f".{uuid.uuid4().hex}.tmp"


class _Place:
    """A folder that is open; below a ``strict`` one, output folders must have no files but those of their lists."""

    def __init__(self, folder: Callable[[], Folder], *, strict: bool) -> None:
        self._open, self.strict = folder, strict

    @property
    def folder(self) -> Folder:
        """The open folder."""
        return self._open()


class _Places(threading.local):
    """The folders that this thread has opened, by their path: another thread may close its own ones at any time."""

    def __init__(self) -> None:
        self.opened: dict[Path, _Place] = {}


_places = _Places()


def _nearest(path: Path) -> tuple[_Place | None, tuple[str, ...]]:
    """Return the innermost open folder that holds a path, or is it, and the parts of the path from there on."""
    place = Path(os.path.abspath(path))
    for folder in (place, *place.parents):
        if folder in _places.opened:
            return _places.opened[folder], place.relative_to(folder).parts
    return None, ()


@contextlib.contextmanager
def _placed(path: Path, place: _Place) -> Iterator[None]:
    key, opened = Path(os.path.abspath(path)), _places.opened
    before = opened.get(key)
    opened[key] = place
    try:
        yield
    finally:
        del opened[key]
        if before is not None:
            opened[key] = before


@contextlib.contextmanager
def _writing(path: str | Path, what: str) -> Iterator[None]:
    """Raise the error of `not_written` for errors of the system in the block."""
    try:
        yield
    except (OSError, ValueError) as error:  # ValueError: a null character in the name
        raise not_written(path, error, what) from None


@contextlib.contextmanager
def base(path: Path, *, strict: bool = False) -> Iterator[None]:
    """Open a folder, whose own links are followed, when something is written below it: then no links are.

    With ``strict``, output folders below it must hold nothing but what earlier runs wrote: it is a folder of the user,
    or from elsewhere, in which a command chose the name of its output folder.
    """
    if _nearest(path)[0] is not None:
        yield
        return
    with contextlib.ExitStack() as opened:
        found: list[Folder] = []

        def folder() -> Folder:
            if not found:
                found.append(opened.enter_context(opened_above(path, make=True)))
            return found[0]

        with _placed(path, _Place(folder, strict=strict)):
            yield


class Output(_Place):
    """A folder that a command writes to, with the list of its files."""

    def __init__(self, path: Path, folder: Folder, command: str, *, strict: bool) -> None:
        """Read the list of the folder; InputError if it is damaged or of another command."""
        super().__init__(lambda: folder, strict=strict)
        self.path, self.command = path, command
        self._journal: IO[bytes] | None = None
        record = _read_list(folder, path)
        self.listed = record is not None
        if record is not None and record.command not in ("", command):
            raise InputError(
                f"{path}: it has what `{record.command}` wrote, which stays as it is; choose another --out"
            )
        self.files = {} if record is None else record.files

    def check(self, *, owns: bool, whole: bool, replaces: bool, kept: Collection[str] = ()) -> None:
        """Check what is in the folder, before anything is written to it; arguments as of `output`.

        Raises
        ------
        InputError
            It has links, or files that the command may not write beside.
        """
        if owns:
            others: dict[str, str] = {}  # of the lists of folders below
            found = list(_files(self.folder, self.path, others))
            unlisted = [name for name in found if name not in self.files]
            foreign = [name for name in unlisted if name not in others or (whole and name.split("/")[0] not in kept)]
            if foreign and not self.listed:
                raise InputError(
                    f"{self.path}: expected a new or empty folder, or one of an earlier {self.command}, got one with "
                    f"{foreign[0]}; nothing was changed"
                )
            if foreign and (self.strict or whole):
                raise InputError(
                    f"{self.path}: {foreign[0]} was not written by `{self.command}`; choose another --out, or move it"
                )
        self.refuse(self.files if replaces else ())

    def refuse(self, names: Iterable[str]) -> None:
        """Raise `InputError` if a file of these names is there that the command did not write, or changed since."""
        for name in names:
            with contextlib.suppress(FileNotFoundError), self._reached(name) as (folder, last):
                self._admit(folder, name, last)

    def is_changed(self, name: str) -> bool:
        """Return whether a file of the list is there with another content; a link is another content."""
        try:
            self.refuse((name,))
        except (OSError, InputError):
            return True
        return False

    @contextlib.contextmanager
    def _reached(self, name: str, *, make: bool = False) -> Iterator[tuple[Folder, str]]:
        *above, last = name.split("/")
        with self.folder.reached(above, make=make) as folder:
            yield folder, last

    def _admit(self, folder: Folder, name: str, last: str) -> bool:
        """Return whether a file is there; InputError unless it is the command's."""
        found = folder.status(last)
        if found is None:
            return False
        folder.refuse_link(last)
        if stat.S_ISDIR(found.st_mode):
            raise InputError(f"{self.path / name}: expected a file, or none yet, but a folder is there")
        own = self.files.get(name)
        regular = stat.S_ISREG(found.st_mode)
        if not regular or own is None or (own not in (_ANY, folder.digest(last)) and not _is_cut(folder.read(last))):
            raise InputError(
                f"{self.path}: {name} was not written by `{self.command}`, or changed since; choose another --out, or "
                "move it"
            )
        return True

    def note(self, name: str, digest: str | None) -> None:
        """Note the digest of a file that is written next, None for one that is removed."""
        if self._journal is None:
            opened = self.folder.open(JOURNAL, os.O_WRONLY | os.O_CREAT | os.O_APPEND)
            self._journal = open(opened, "ab", buffering=0)  # noqa: SIM115 (until the folder is closed)
        self._journal.write(json.dumps([name, digest]).encode() + b"\n")
        if digest is None:
            self.files.pop(name, None)
        else:
            self.files[name] = digest

    def forget(self, name: str, before: str | None) -> None:
        """Take back the last note of a file, which was not written."""
        self.files.pop(name)
        if before is not None:
            self.files[name] = before

    def remove(self, name: str) -> None:
        """Remove a file of the command, if it is there; InputError for another one."""
        with contextlib.suppress(FileNotFoundError), self._reached(name) as (folder, last):
            if self._admit(folder, name, last):
                folder.remove(last)
                self.note(name, None)

    def clear(self, *, last: str = "") -> None:
        """Remove all files of the list, one of them at the end, and the folders that are empty then."""
        names = sorted(self.files, key=lambda name: (name == last, name))
        for name in names:
            self.remove(name)
        self.files.clear()
        above = {name.rpartition("/")[0] for name in names} - {""}
        for name in sorted(above, key=lambda name: -name.count("/")):
            self.remove_empty(name)
        self.write_list()

    def remove_empty(self, name: str) -> None:
        """Remove a subfolder if it is empty."""
        with contextlib.suppress(FileNotFoundError), self._reached(name) as (folder, last):
            folder.remove_empty(last)

    def move_from(self, other: Output, name: str) -> None:
        """Take a file over from another folder of the command."""
        digest = other.files.get(name, _ANY)
        with other._reached(name) as (source, last), self._reached(name, make=True) as (target, _):
            other._admit(source, name, last)
            self._admit(target, name, last)
            self.note(name, digest)
            source.rename(last, target, last)
            other.note(name, None)
        if "/" in name:
            other.remove_empty(name.rpartition("/")[0])

    def note_all(self) -> None:
        """Note the files in the folder that are not noted, but for those of lists below."""
        others: dict[str, str] = {}
        for name in list(_files(self.folder, self.path, others)):
            if name not in self.files and name not in others:
                with self._reached(name) as (folder, last):
                    self.note(name, folder.digest(last))

    def take(self, other: Output) -> None:
        """Stand for another folder from now on, with its list."""
        if self._journal is not None:
            self._journal.close()
        self._journal, self.files, self.listed = None, other.files, True
        self.folder.take(other.folder)

    def write_list(self) -> None:
        """Write the list."""
        record = {"command": self.command, "files": dict(sorted(self.files.items()))}
        _write(self.folder, RECORD, json.dumps(record, indent=1, ensure_ascii=False).encode() + b"\n")
        if self._journal is not None:
            self._journal.close()
            self._journal = None
        if self.folder.status(JOURNAL) is not None:
            self.folder.remove(JOURNAL)
        self.listed = True

    def close(self) -> None:
        """Write the list, or remove it if nothing is in it."""
        if self.files:
            if self._journal is not None or not self.listed:
                self.write_list()
            return
        if self._journal is not None:
            self._journal.close()
            self._journal = None
        for name in (RECORD, JOURNAL):
            if self.folder.status(name) is not None:
                self.folder.remove(name)


def _read_list(folder: Folder, path: Path) -> Written | None:
    """Read the list of a folder, with what was noted since it was written; None if there is none."""
    for name in (RECORD, JOURNAL):
        folder.refuse_link(name)
    found = [folder.status(name) for name in (RECORD, JOURNAL)]
    if found == [None, None]:
        return None
    if any(each is not None and (not stat.S_ISREG(each.st_mode) or each.st_size > _LARGEST) for each in found):
        raise InputError(f"{path / RECORD}: expected what an earlier run wrote, got something else")
    record = Written("")
    data = folder.read(RECORD)
    if data is not None:
        try:
            record = msgspec.json.decode(data, type=prepared(Written))
        except (msgspec.MsgspecError, RecursionError) as error:
            raise InputError(
                f"{path / RECORD}: expected what an earlier run wrote, got another file ({error})"
            ) from None
    before = dict(record.files)
    noted: dict[str, list[str]] = {}
    for line in (folder.read(JOURNAL) or b"").split(b"\n"):
        with contextlib.suppress(msgspec.MsgspecError):  # a line that was cut when the process was killed
            name, digest = msgspec.json.decode(line, type=tuple[str, str | None])
            noted.setdefault(name, [before[name]] if name in before else [])
            if digest is None:
                record.files.pop(name, None)
            else:
                record.files[name] = digest
                noted[name].append(digest)
    strange = next((name for name in record.files if not _is_inside(name)), None)
    if strange is not None:
        raise InputError(f"{path / RECORD}: files: expected paths in the folder, got {strange[:200]!r}")
    for name, digests in noted.items():  # a process that is killed after its note leaves the file as it was
        *above, last = name.split("/")
        with contextlib.suppress(OSError, InputError), folder.reached(above) as inner:
            digest = inner.digest(last)
            if digest in digests:
                record.files[name] = digest
    return record


def _is_cut(data: bytes | None) -> bool:
    """Whether a file was cut off, as by a power cut: an empty one, or a document without its end."""
    text = (data or b"").strip(b"\0 \n")
    return not text or (text.startswith(b"{") and not text.endswith(b"}"))


def _is_inside(name: str) -> bool:
    """Whether a name of a list is a path in the folder."""
    return all(part not in ("", ".", "..") and "\0" not in part and os.sep not in part for part in name.split("/"))


def _files(folder: Folder, path: Path, listed: dict[str, str], begin: str = "") -> Iterator[str]:
    """Yield the files in a folder by their path in it; those of lists below it are added to ``listed``.

    Raises
    ------
    InputError
        There is a link.
    """
    if begin and (record := _read_list(folder, path)) is not None:
        listed.update({begin + name: digest for name, digest in record.files.items()})
    for name, link, is_folder in folder.entries():
        if link:
            folder.refuse_link(name)
        if _TEMPORARY.fullmatch(name):
            continue
        if is_folder:
            with Folder(path / name, above=folder) as inner:
                yield from _files(inner, path / name, listed, f"{begin}{name}/")
        elif name not in _OWN and name not in _DESKTOP:
            yield begin + name


def changed_files(path: Path) -> set[str]:
    """Return the files of the list of a folder that have another content since; none if it has no list."""
    with Folder(path) as folder:
        record = _read_list(folder, path)
        if record is None:
            return set()
        out = Output(path, folder, record.command, strict=False)
        return {name for name in out.files if out.is_changed(name)}


@contextlib.contextmanager
def _folder_of(path: Path, *, make: bool) -> Iterator[tuple[Folder, bool]]:
    """Open a folder to write to, and tell whether it is below a strict one."""
    place, names = _nearest(path)
    if place is None:
        with opened_above(path, make=make) as folder:
            yield folder, False
    else:
        with place.folder.reached(names, make=make) as folder:
            yield folder, place.strict


def check_output_folder(
    path: Path,
    command: str,
    *,
    names: Iterable[str] = (),
    owns: bool = True,
    whole: bool = False,
    replaces: bool = False,
    kept: Collection[str] = (),
) -> None:
    """Check, before any work, that a command may write to a folder; arguments and errors as of `output`.

    ``names`` are files that it will write. What is wrong without the folder's lock is looked at again with it, since
    another command may have written a file between the list and the file that were looked at.
    """
    names = tuple(names)
    with _writing(path, "a folder"):
        if not os.path.lexists(path):
            return
        with _folder_of(path, make=False) as (folder, strict):

            def check() -> None:
                out = Output(path, folder, command, strict=strict)
                out.check(owns=owns, whole=whole, replaces=replaces, kept=kept)
                out.refuse(names)

            try:
                check()
            except InputError as error:
                with contextlib.ExitStack() as held:
                    try:
                        held.enter_context(locked(folder, wait=0.0 if owns else LONG))
                    except OSError:
                        raise error from None
                    check()


@contextlib.contextmanager
def output(
    path: Path,
    command: str,
    *,
    owns: bool = True,
    whole: bool = False,
    replaces: bool = False,
    kept: Collection[str] = (),
    wait: float = 0.0,
) -> Iterator[Output]:
    """Open a folder to write to, and lock it; it is made if it is not there, and removed again if nothing was written.

    Parameters
    ----------
    path
        The folder. If it is below another one that is open, no part from there on may be a link.
    command
        The command that writes.
    owns
        Whether nobody else writes there: the folder must be new, empty, or of an earlier run of the command.
    whole
        Whether it is replaced as a whole: it must have no files but those of its list.
    replaces
        Whether the files of the list are replaced: none may have been changed since.
    kept
        Of a folder that is replaced as a whole, subfolders with lists of their own that stay.
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
    with contextlib.ExitStack() as opened:
        with _writing(path, "results"):
            folder, strict = opened.enter_context(_folder_of(path, make=True))
            if owns:
                Output(path, folder, command, strict=strict)  # of another command: said so, even while that runs
            opened.enter_context(locked(folder, wait=wait))
            out = Output(path, folder, command, strict=strict)
        opened.callback(_close, out)
        with _writing(path, "results"):
            out.check(owns=owns, whole=whole, replaces=replaces, kept=kept)
            if owns:
                _remove_temporary(folder)
                if not out.listed:
                    out.write_list()
        with _placed(path, out):
            yield out


def _close(out: Output) -> None:
    with _writing(out.path, "results"):
        out.close()


def _remove_temporary(folder: Folder) -> None:
    """Remove what killed processes left half written in a folder and those below."""
    for name, link, is_folder in folder.entries():
        if is_folder:
            temporary = _TEMPORARY.fullmatch(name) is not None
            with contextlib.suppress(OSError), Folder(folder.path / name, above=folder) as inner:
                _remove_all(inner) if temporary else _remove_temporary(inner)
            if temporary:
                folder.remove_empty(name)
        elif not link and _TEMPORARY.fullmatch(name):
            with contextlib.suppress(OSError):
                folder.remove(name)


def _remove_all(folder: Folder) -> None:
    """Remove everything in a folder of a temporary name; links are removed, not followed."""
    for name, _, is_folder in folder.entries():
        if is_folder:
            with Folder(folder.path / name, above=folder) as inner:
                _remove_all(inner)
            folder.remove_empty(name)
        else:
            folder.remove(name)


def _write(folder: Folder, name: str, data: bytes) -> None:
    """Write a file in an open folder: to a temporary file, which is then renamed."""
    beside = _temporary()
    try:
        with open(folder.open(beside, os.O_WRONLY | os.O_CREAT | os.O_EXCL), "wb") as file:
            file.write(data)
        folder.rename(beside, folder, name)
    except BaseException:
        with contextlib.suppress(OSError):
            folder.remove(beside)
        raise


@contextlib.contextmanager
def _target(path: Path) -> Iterator[tuple[Folder, Output | None, str]]:
    """Open the folder of a file that is written; returns the output folder whose list it belongs to, and its name."""
    place, names = _nearest(path)
    if place is None or not names:
        with opened_above(path.parent, make=True) as folder:
            yield folder, None, path.name
    else:
        with place.folder.reached(names[:-1], make=True) as folder:
            yield folder, place if isinstance(place, Output) else None, "/".join(names)


def write_bytes(path: str | Path, data: bytes) -> None:
    """Write a file, creating the folders above it; an existing file is replaced once the new one is complete.

    Raises
    ------
    InputError
        The path cannot be written to; in an output folder, the file is the user's, or there is a link.
    DvrkCmaesError
        The disk is full or failing.
    """
    with _writing(path, "a file"), _target(Path(path)) as (folder, out, name):
        last = Path(path).name
        before = None
        if out is not None:
            out._admit(folder, name, last)
            before = out.files.get(name)
            out.note(name, hashlib.sha256(data).hexdigest())
        try:
            _write(folder, last, data)
        except BaseException:
            if out is not None:
                out.forget(name, before)
            raise


def remove(path: Path) -> None:
    """Remove a file that a command wrote, if it is there; InputError for a file of the user."""
    place, names = _nearest(path)
    with _writing(path, "a file"):
        if isinstance(place, Output):
            place.remove("/".join(names))
        else:
            path.unlink(missing_ok=True)


@contextlib.contextmanager
def written_beside(path: Path, what: str) -> Iterator[Path]:
    """Give a path of the same extension, in a temporary folder, for a program that writes files itself.

    Its file is renamed to the target at the end, or removed after an error. ``what`` is named in messages. Errors are
    those of ``write_bytes``.
    """
    with contextlib.ExitStack() as opened:
        with _writing(path, what):
            folder, out, name = opened.enter_context(_target(path))
            if out is not None:
                out._admit(folder, name, path.name)
            beside = _temporary()
            folder.make(beside)
            inner = opened.enter_context(Folder(path.parent / beside, above=folder))
        try:
            yield inner.path / path.name
            with _writing(path, what):
                if out is not None:
                    out._admit(folder, name, path.name)
                    out.note(name, inner.digest(path.name) or _ANY)
                inner.rename(path.name, folder, path.name)
        finally:
            _remove_all(inner)
            folder.remove_empty(beside)


@contextlib.contextmanager
def appended(path: Path, begin: bytes) -> Iterator[IO[bytes]]:
    """Open a new file to append to, with its beginning; each write is in the file at once. Errors: as of the system.

    In an output folder, an earlier file is replaced if it is the command's.
    """
    with _target(path) as (folder, out, name):
        if out is not None:
            out._admit(folder, name, path.name)
            out.note(name, _ANY)
        beside = _temporary()
        with open(folder.open(beside, os.O_WRONLY | os.O_CREAT | os.O_EXCL), "wb", buffering=0) as file:
            file.write(begin)
            folder.rename(beside, folder, path.name)
            yield file
        if out is not None:
            out.note(name, folder.digest(path.name) or _ANY)


@contextlib.contextmanager
def whole_folder(
    path: str | Path,
    command: str,
    *,
    overwrite: bool = False,
    kept: Sequence[str] = (),
    source: str | Path | None = None,
    opened_before: Output | None = None,
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
    opened_before
        The target, if it is open already, by the same arguments.

    Raises
    ------
    InputError
        The target exists already, or cannot be written to.
    DvrkCmaesError
        The disk is full or failing. In errors raised by the block, the temporary path is replaced by ``path``.
    """
    path = Path(path)
    beside = path
    try:
        real = Path(os.path.realpath(path))
        if source is not None and real in ((read := Path(os.path.realpath(source))), *read.parents):
            raise InputError(f"{path}: expected a folder apart from {source}, got one that holds it")
        with contextlib.ExitStack() as opened:
            if not overwrite:
                _refuse_filled(path)
            place = _nearest(path.parent)[0]
            out = opened_before
            if out is None:
                out = opened.enter_context(output(path, command, whole=True, replaces=overwrite, kept=kept))
            # its own name, below the folder that holds it: what is typed may be a link to it
            target = path if place is not None else real
            above = opened.enter_context(_folder_of(target.parent, make=False))[0]
            begin = hashlib.sha256(os.fsencode(real)).hexdigest()[:16]
            _remove_left(above, begin)
            beside = target.with_name(f".{begin}{uuid.uuid4().hex[:16]}.tmp")
            opened.callback(_remove_beside, above, beside.name)
            with output(beside, command) as made:
                for name in kept:
                    _keep(out, made, name)
                yield beside
                made.note_all()
                out.check(owns=True, whole=True, replaces=True, kept=kept)  # files may have been added meanwhile
                made.write_list()
                _exchange(above, beside.name, target.name)
                left = opened.enter_context(Folder(beside, above=above))
                _move_foreign(left, made.folder, {*out.files, *(f"{name}/" for name in kept)})
                out.take(made)
    except DvrkCmaesError as error:
        raise type(error)(str(error).replace(str(beside), str(path))) from None
    except (OSError, ValueError) as error:  # ValueError: a null character in the name
        raise not_written(path, error, "a folder") from None


def _refuse_filled(path: Path) -> None:
    """Raise `InputError` unless a folder does not exist or is empty."""
    if not os.path.lexists(path):
        return
    if not path.is_dir():
        raise InputError(f"{path}: expected a folder to write, got a file of that name")
    with Folder(path) as folder:
        if any(name not in _OWN for name, _, _ in folder.entries()):
            raise InputError(
                f"{path}: expected a new or empty folder, got one with files in it (--overwrite replaces it)"
            )


def _remove_left(above: Folder, begin: str) -> None:
    """Remove the temporary folders that killed processes left for the same target, whose lock is held."""
    for name, _, is_folder in above.entries():
        if is_folder and re.fullmatch(rf"\.{begin}[0-9a-f]{{16}}\.tmp", name):
            with contextlib.suppress(OSError):
                _remove_beside(above, name)


def _remove_beside(above: Folder, name: str) -> None:
    """Remove a temporary folder, if it is there."""
    if above.status(name) is not None:
        with Folder(above.path / name, above=above) as folder:
            _remove_all(folder)
        above.remove_empty(name)


def _keep(out: Output, made: Output, name: str) -> None:
    """Give the files of a subfolder, and what a list says of them, to a new folder, too."""

    def keep(folder: Folder, to: Folder, begin: str) -> None:
        for each, _, is_folder in folder.entries():
            if is_folder:
                to.make(each)
                with Folder(folder.path / each, above=folder) as inner, Folder(to.path / each, above=to) as inner_to:
                    keep(inner, inner_to, f"{begin}{each}/")
            elif each not in (LOCK, HELD) and not _TEMPORARY.fullmatch(each):
                folder.link(each, to)
                if begin + each in out.files:
                    made.note(begin + each, out.files[begin + each])

    if out.folder.status(name) is not None:
        made.folder.make(name)
        with out.folder.reached([name]) as folder, made.folder.reached([name]) as to:
            keep(folder, to, f"{name}/")


def _move_foreign(left: Folder, to: Folder, known: Collection[str], begin: str = "") -> None:
    """Move files that no list has from the earlier folder to the new one: they were added in the last moment."""
    for name, _, is_folder in left.entries():
        place = begin + name
        if f"{place}/" in known or place in known or name in (*_OWN, *_DESKTOP) or _TEMPORARY.fullmatch(name):
            continue
        if is_folder:
            with Folder(left.path / name, above=left) as inner:
                to.make(name)
                with Folder(to.path / name, above=to) as inner_to:
                    _move_foreign(inner, inner_to, known, f"{place}/")
        elif to.status(name) is None:
            left.rename(name, to, name)


def _exchange(above: Folder, first: str, second: str) -> None:
    """Exchange the names of two folders, in one step where the system can."""
    if above.exchange(first, second):
        return
    apart = _temporary()
    above.rename(second, above, apart)
    try:
        above.rename(first, above, second)
    except OSError:
        above.rename(apart, above, second)
        raise
    above.rename(apart, above, first)
