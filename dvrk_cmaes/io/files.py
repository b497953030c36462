"""Read whole files, refuse links that leave a folder, and find the bundled files and the folder of what is cached.

An InputError states in one line why a file cannot be read.

The bundled files are in data/ in a checkout, in dvrk_cmaes/data in a wheel. What takes long to compute, instruments,
prepared meshes and compiled templates, is in ``dvrk-cmaes`` in ``$XDG_CACHE_HOME`` or ``~/.cache``. The environment
variable ``DVRK_CMAES_CACHE`` gives another folder; the value ``off`` disables it. Its files may be deleted at any time.
"""

from __future__ import annotations

import errno
import hashlib
import os
import stat
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path

from dvrk_cmaes.errors import InputError
from dvrk_cmaes.io.arguments import PATH, check_type


def read_bytes(path: str | Path, *, expected: str, largest: int) -> bytes:
    """Read a regular file of at most ``largest`` bytes.

    Parameters
    ----------
    path
        The file; links are followed.
    expected
        What the file should be, for the message, e.g. ``"a mask (PNG or JPEG)"``.
    largest
        Largest size in bytes; a larger file is not read.

    Raises
    ------
    InputError
        Missing, a directory or device, not readable, empty, or too large.
    """
    check_type("path", path, PATH, f"the path of {expected}")
    with _reason_given(path, expected):
        check_file(path, expected=expected, largest=largest)
        data = Path(path).read_bytes()
    if not data:
        raise InputError(f"{path}: expected {expected}, got an empty file")
    return data


def check_file(path: str | Path, *, expected: str, largest: int | None = None) -> None:
    """Raise the errors of ``read_bytes`` for a path that is not a regular file of at most ``largest`` bytes."""
    with _reason_given(path, expected):
        status = Path(path).stat()
    if stat.S_ISDIR(status.st_mode):
        raise InputError(f"{path}: expected {expected}, got a directory")
    if not stat.S_ISREG(status.st_mode):
        raise InputError(f"{path}: expected {expected}, got something that is not a regular file")
    if largest is not None and status.st_size > largest:
        raise InputError(
            f"{path}: expected {expected} of at most {largest / 1e6:g} MB, got {status.st_size / 1e6:.1f} MB"
        )


@contextmanager
def _reason_given(path: str | Path, expected: str) -> Iterator[None]:
    """Turn errors of the operating system into an InputError of one line."""
    try:
        yield
    except FileNotFoundError:
        raise InputError(f"{path}: no such file; expected {expected}") from None
    except (OSError, ValueError) as error:  # ValueError: a null character in the name
        reason = error.strerror if isinstance(error, OSError) else str(error)
        raise InputError(f"{path}: not readable ({reason}); expected {expected}") from None


def read_text(path: str | Path, *, expected: str, largest: int) -> str:
    """Read a text file in UTF-8, with or without a byte order mark; errors as in ``read_bytes``."""
    return text_of(path, read_bytes(path, expected=expected, largest=largest), expected=expected)


def text_of(path: str | Path, data: bytes, *, expected: str) -> str:
    """Decode the content of a text file in UTF-8; InputError for other bytes, and for the first NUL."""
    nul = data.find(b"\0")
    if nul >= 0:
        raise InputError(f"{path}: expected {expected}, got a NUL byte at {nul}: the file is damaged, or no text")
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: expected {expected} in UTF-8, got other bytes at {error.start}") from None


def file_digest(path: Path) -> str:
    """Return the SHA-256 of a regular file's content in hexadecimal; raises OSError where it cannot be read."""
    if not stat.S_ISREG(path.stat().st_mode):  # a pipe would be waited for
        raise OSError(errno.EINVAL, "not a regular file", str(path))
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


_PACKAGE = Path(__file__).resolve().parents[1]


def bundled_path(*parts: str) -> Path:
    """Return the path of a bundled file or folder, e.g. ``bundled_path("instruments", "lnd")``."""
    inside = _PACKAGE / "data"
    return (inside if inside.is_dir() else _PACKAGE.parent / "data").joinpath(*parts)


def cache_folder() -> Path | None:
    """Return the folder of what can be computed again, which may not exist; None if disabled or without a home."""
    folder = os.environ.get("DVRK_CMAES_CACHE", "")
    if folder == "off":
        return None
    if folder:
        return Path(folder)
    try:
        return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "dvrk-cmaes"
    except RuntimeError:  # the user has no home folder
        return None


def check_own(given: Path, paths: Iterable[Path | None]) -> None:
    """Check paths to read; those that are not written as within the folder were named by someone, and are fine.

    The folder that is given may be a link itself, for it was named by the user.

    Raises
    ------
    InputError
        A path, or a folder of it, is a link that leaves the folder.
    """
    folder = os.path.abspath(given)
    real, real_of = os.path.realpath(given) if os.path.exists(given) else folder, cache(os.path.realpath)
    for path in (os.path.abspath(path) for path in paths if path is not None):
        place, name = os.path.split(path)
        target = os.path.realpath(path) if os.path.islink(path) else f"{real_of(place)}/{name}"
        if _is_in(folder, place) and not _is_in(real, target):
            while not _is_in(real, real_of(os.path.dirname(path))):
                path = os.path.dirname(path)
            raise InputError(
                f"{path}: expected a file in {folder}, got a link that leaves it, to {target}; copy what it leads "
                "to into the folder"
            )


def _is_in(folder: str, path: str) -> bool:
    """Whether a path is a folder, or in it, as both are written."""
    return f"{path}/".startswith(f"{folder.rstrip('/')}/")


def check_own_folder(folder: Path) -> None:
    """Check all that is in a folder, if it is one; errors as of `check_own`."""
    for place, folders, files in os.walk(folder) if os.path.isdir(folder) else ():
        check_own(folder, (Path(place, name) for name in (*folders, *files)))
