"""Folders that are open: files in them are made, read, renamed and removed by the handle, and never through links.

Where the system cannot do that (Windows), the same is done by paths, each of whose parts is checked for links before.
"""

from __future__ import annotations

import contextlib
import ctypes
import errno
import hashlib
import os
import stat
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Final

from dvrk_cmaes.errors import DvrkCmaesError, InputError

BY_HANDLE: Final = {os.open, os.mkdir, os.rename, os.stat, os.unlink} <= os.supports_dir_fd
"""Whether the system opens files relative to the handle of a folder."""

# errors that do not depend on the path; EFBIG: the limit on the size of files (ulimit -f)
_MACHINE_AT_FAULT: Final = (errno.ENOSPC, errno.EDQUOT, errno.EIO, errno.EFBIG)
RENAME_EXCHANGE: Final = 2  # of renameat2(2)
_NO_LINK = getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_CLOEXEC", 0) | getattr(os, "O_BINARY", 0)
_NO_LINK |= getattr(os, "O_NONBLOCK", 0)  # a pipe is not waited for


def not_written(path: str | Path, error: OSError | ValueError, what: str) -> DvrkCmaesError:
    """Return the error of a path that was not written: `InputError`, or `DvrkCmaesError` if the machine is at fault."""
    if isinstance(error, ValueError):
        return InputError(f"{str(path)!r}: not written ({error}); expected a place to write {what}")
    kind = DvrkCmaesError if error.errno in _MACHINE_AT_FAULT else InputError
    if isinstance(error, NotADirectoryError) and os.path.isfile(path):
        return InputError(f"{path}: expected a folder to write, got a file of that name")
    reason = "a file lies where a folder is wanted" if isinstance(error, FileExistsError) else error.strerror
    return kind(f"{path}: not written ({reason}); expected a place to write {what}")


class Folder:
    """An open folder; ``path`` is its path in messages. Errors are those of the system, but for those of links."""

    def __init__(self, path: Path, *, above: Folder | None = None) -> None:
        """Open a folder: by its path, whose links are followed, or by its name in the folder above, which is no link.

        Raises
        ------
        InputError
            There is a link, or a file, in the folder above.
        """
        self.path = path
        self._handle: int | None = None
        if above is not None:
            above.refuse_link(path.name)
        if BY_HANDLE:
            flags = os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC
            if above is None:
                self._handle = os.open(path, flags)
            else:
                try:
                    self._handle = os.open(path.name, flags | os.O_NOFOLLOW, dir_fd=above._handle)
                except NotADirectoryError:
                    raise InputError(f"{path}: expected a folder to write to, but a file is there") from None
        elif not path.is_dir():
            raise NotADirectoryError(errno.ENOTDIR, os.strerror(errno.ENOTDIR), str(path))

    def __enter__(self) -> Folder:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the handle."""
        if self._handle is not None:
            os.close(self._handle)
            self._handle = None

    def take(self, other: Folder) -> None:
        """Stand for another folder from now on; the other one can be closed."""
        if self._handle is not None and other._handle is not None:
            os.dup2(other._handle, self._handle, inheritable=False)

    def _at(self, name: str, key: str = "dir_fd") -> tuple[str, dict[str, Any]]:
        """Return a name, and the argument that says that it is in this folder."""
        if not name or name in (os.curdir, os.pardir) or "/" in name or os.sep in name or "\0" in name:
            raise ValueError(f"{name!r} is no name of a file")
        return (name, {key: self._handle}) if self._handle is not None else (os.fspath(self.path / name), {})

    def status(self, name: str) -> os.stat_result | None:
        """Return what the system tells of a file, itself if it is a link; None if there is none."""
        place, at = self._at(name)
        with contextlib.suppress(FileNotFoundError):
            return os.stat(place, follow_symlinks=False, **at)
        return None

    def refuse_link(self, name: str) -> None:
        """Raise `InputError` if there is a link of this name."""
        found = self.status(name)
        if found is not None and (stat.S_ISLNK(found.st_mode) or _is_junction(self.path / name)):
            raise InputError(
                f"{self.path / name}: expected a place to write, got a link; nothing is written, read or "
                "removed through it"
            )

    def make(self, name: str) -> bool:
        """Make a folder; returns whether it was not there before."""
        place, at = self._at(name)
        try:
            os.mkdir(place, **at)
        except FileExistsError:
            return False
        return True

    def open(self, name: str, flags: int) -> int:
        """Open a file that is no link; returns its descriptor."""
        self.refuse_link(name)
        place, at = self._at(name)
        return os.open(place, flags | _NO_LINK, 0o666, **at)

    def rename(self, name: str, to: Folder, new: str) -> None:
        """Rename a file, also into another folder; a file there is replaced."""
        (source, at), (target, to_at) = self._at(name, "src_dir_fd"), to._at(new, "dst_dir_fd")
        os.replace(source, target, **at, **to_at)

    def exchange(self, first: str, second: str) -> bool:
        """Exchange the names of two folders in one step; returns whether the system can."""
        library = None if self._handle is None else ctypes.CDLL(None, use_errno=True)
        if library is None or not hasattr(library, "renameat2"):
            return False
        names = os.fsencode(first), os.fsencode(second)
        return bool(library.renameat2(self._handle, names[0], self._handle, names[1], RENAME_EXCHANGE) == 0)

    def link(self, name: str, to: Folder) -> None:
        """Give a file a second name, in another folder; it is copied where the file system has none."""
        (source, at), (target, to_at) = self._at(name, "src_dir_fd"), to._at(name, "dst_dir_fd")
        try:
            os.link(source, target, **at, **to_at, follow_symlinks=False)
        except OSError:
            with open(self.open(name, os.O_RDONLY), "rb") as file:
                data = file.read()
            with open(to.open(name, os.O_WRONLY | os.O_CREAT | os.O_EXCL), "wb") as file:
                file.write(data)

    def remove(self, name: str) -> None:
        """Remove a file, or a link itself."""
        place, at = self._at(name)
        os.unlink(place, **at)

    def remove_empty(self, name: str) -> None:
        """Remove a folder if it is empty."""
        place, at = self._at(name)
        with contextlib.suppress(OSError):
            os.rmdir(place, **at)

    def digest(self, name: str) -> str | None:
        """Return the SHA-256 of a regular file's content in hexadecimal; None for a link, or anything else."""
        found = self.status(name)
        if found is None or not stat.S_ISREG(found.st_mode):
            return None
        with open(self.open(name, os.O_RDONLY), "rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()

    def read(self, name: str) -> bytes | None:
        """Return the content of a file; None if there is none."""
        try:
            with open(self.open(name, os.O_RDONLY), "rb") as file:
                return file.read()
        except FileNotFoundError:
            return None

    def entries(self) -> list[tuple[str, bool, bool]]:
        """Return the names in the folder, sorted, and whether each is a link, and whether it is a folder itself."""
        found = []
        with os.scandir(self.path if self._handle is None else self._handle) as listed:
            for entry in listed:
                link = entry.is_symlink() or (self._handle is None and _is_junction(self.path / entry.name))
                found.append((entry.name, link, not link and entry.is_dir(follow_symlinks=False)))
        return sorted(found)

    @contextlib.contextmanager
    def reached(self, names: Sequence[str], *, make: bool = False) -> Iterator[Folder]:
        """Open a folder below this one, each of whose parts is no link; those that are made go again after an error.

        Raises
        ------
        InputError
            A part is a link.
        """
        with contextlib.ExitStack() as opened:
            folder, made = self, []
            try:
                for name in names:
                    if make and folder.make(name):
                        made.append((folder, name))
                    folder = opened.enter_context(Folder(folder.path / name, above=folder))
                yield folder
            except BaseException:
                for above, name in reversed(made):
                    above.remove_empty(name)
                raise


def _is_junction(path: Path) -> bool:
    """Whether a path is a link to a folder as Windows has them."""
    return os.name == "nt" and bool(getattr(os.path, "isjunction", lambda _: False)(path))


@contextlib.contextmanager
def opened_above(path: Path, *, make: bool = False) -> Iterator[Folder]:
    """Open a folder by its path, whose links are followed; with ``make``, it is made, and goes again after an error."""
    missing: list[str] = []
    there = path
    while make and not there.exists() and there != there.parent:
        missing.insert(0, there.name)
        there = there.parent
    with Folder(there) as folder, folder.reached(missing, make=True) as reached:
        yield reached
