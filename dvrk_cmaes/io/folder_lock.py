"""The lock of an open folder: a file in it that the system locks while the process lives.

Where the file system cannot lock, a second file that only one process can make stands for the lock.
"""

from __future__ import annotations

import contextlib
import errno
import os
import platform
import sys
import time
from collections.abc import Callable, Iterator
from typing import Final

from dvrk_cmaes.errors import DvrkCmaesError
from dvrk_cmaes.io.handles import Folder

LOCK: Final = ".lock"
HELD: Final = ".lock.held"
"""The file that stands for the lock where the file system cannot lock; it has the machine and process of its owner."""

_LOOKED_EVERY: Final = 0.02  # s
_CANNOT_LOCK: Final = (errno.ENOSYS, errno.ENOTSUP, errno.EOPNOTSUPP, errno.ENOLCK, errno.EINVAL)


@contextlib.contextmanager
def locked(folder: Folder, *, wait: float = 0.0) -> Iterator[None]:
    """Lock a folder against other processes and threads, after waiting for up to ``wait`` seconds for them.

    The system gives the lock back when the process ends, even if it is killed.

    Raises
    ------
    DvrkCmaesError
        Another command has locked the folder.
    """
    release = _flocked(folder, wait) or _held(folder, wait)
    try:
        yield
    finally:
        release()


def _flocked(folder: Folder, wait: float) -> Callable[[], None] | None:
    """Lock the file of the lock; returns what gives it back, None where the system or its file system cannot lock."""
    try:
        import fcntl
    except ImportError:
        return None
    end = time.monotonic() + wait
    while True:
        opened = folder.open(LOCK, os.O_RDWR | os.O_CREAT)
        try:
            fcntl.flock(opened, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            os.close(opened)
            if error.errno in _CANNOT_LOCK:
                return None
            if error.errno not in (errno.EAGAIN, errno.EACCES):
                raise
        else:
            there = folder.status(LOCK)
            if there is not None and there.st_ino == os.fstat(opened).st_ino:
                return lambda: _released(folder, opened)
            os.close(opened)  # the one who had it before has removed the file
            continue
        _wait(folder, end, "wait for it")


def _held(folder: Folder, wait: float) -> Callable[[], None]:
    """Make the file that stands for the lock; returns what removes it. That of a process that is gone is replaced."""
    end, here = time.monotonic() + wait, platform.node()
    while True:
        try:
            opened = folder.open(HELD, os.O_WRONLY | os.O_CREAT | os.O_EXCL)
        except FileExistsError:
            words = (folder.read(HELD) or b"").decode(errors="replace").split()
            if len(words) == 2 and words[0] == here and words[1].isdigit() and not _lives(int(words[1])):
                with contextlib.suppress(FileNotFoundError):
                    folder.remove(HELD)
                continue
            _wait(folder, end, f"wait for it, or remove {folder.path / HELD} if that process is gone")
            continue
        with open(opened, "wb") as file:
            file.write(f"{here} {os.getpid()}\n".encode())
        if sys.stderr is not None:
            with contextlib.suppress(OSError, ValueError):
                print(
                    f"dvrk-cmaes: {folder.path}: the file system has no locks; {HELD} is there instead meanwhile",
                    file=sys.stderr,
                )
        return lambda: _removed(folder)


def _released(folder: Folder, opened: int) -> None:
    """Remove the file of the lock, and give it back; those who have it open see that it is gone."""
    with contextlib.suppress(OSError):
        folder.remove(LOCK)
    os.close(opened)


def _removed(folder: Folder) -> None:
    with contextlib.suppress(OSError):
        folder.remove(HELD)


def _wait(folder: Folder, end: float, advice: str) -> None:
    """Wait a moment; `DvrkCmaesError` if the time is over."""
    if time.monotonic() >= end:
        raise DvrkCmaesError(f"{folder.path}: another command is writing there; {advice}, or choose another --out")
    time.sleep(_LOOKED_EVERY)


def _lives(process: int) -> bool:
    """Whether a process of this machine lives."""
    if os.name == "nt":
        return True  # there, asking would end it
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except OSError:
        return True
    return True
