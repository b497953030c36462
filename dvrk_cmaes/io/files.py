"""Reading a whole file, or saying in one line why it cannot be read."""

from __future__ import annotations

import stat
from pathlib import Path

from dvrk_cmaes.errors import InputError


def read_bytes(path: str | Path, *, expected: str, largest: int) -> bytes:
    """Read a regular file of at most ``largest`` bytes.

    Parameters
    ----------
    path
        The file; links are followed.
    expected
        What the file should be, for the message, e.g. ``"a mask (PNG or JPEG)"``.
    largest
        Size in bytes beyond which the file is refused unread.

    Raises
    ------
    InputError
        Missing, a directory or device, not readable, empty, or too large.
    """
    file = Path(path)
    try:
        status = file.stat()
        if stat.S_ISDIR(status.st_mode):
            raise InputError(f"{path}: expected {expected}, got a directory")
        if not stat.S_ISREG(status.st_mode):
            raise InputError(f"{path}: expected {expected}, got something that is not a regular file")
        if status.st_size > largest:
            raise InputError(
                f"{path}: expected {expected} of at most {largest / 1e6:g} MB, got {status.st_size / 1e6:.1f} MB"
            )
        data = file.read_bytes()
    except FileNotFoundError:
        raise InputError(f"{path}: no such file; expected {expected}") from None
    except (OSError, ValueError) as error:  # ValueError: a null character in the name
        reason = error.strerror if isinstance(error, OSError) else str(error)
        raise InputError(f"{path}: not readable ({reason}); expected {expected}") from None
    if not data:
        raise InputError(f"{path}: expected {expected}, got an empty file")
    return data


def read_text(path: str | Path, *, expected: str, largest: int) -> str:
    """Read a file as ``read_bytes`` does, as UTF-8 with or without a byte order mark."""
    data = read_bytes(path, expected=expected, largest=largest)
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: expected {expected} in UTF-8, got other bytes at {error.start}") from None
