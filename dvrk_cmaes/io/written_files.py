"""The record of the files that a command wrote to a folder: FOLDER/.written.json names the command and their digests.

By it, files of the user are known: those that it does not name, and those whose content is another one since.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Final

from msgspec import Struct

from dvrk_cmaes.io.atomic import write_json
from dvrk_cmaes.io.files import file_digest
from dvrk_cmaes.io.json_file import read_json_object
from dvrk_cmaes.io.typed_document import convert_document

RECORD: Final = ".written.json"
_EXPECTED: Final = "what an earlier run wrote (.written.json)"
_LOCK: Final = ".lock"
_TEMPORARY: Final = r"(?:.*/)?\.[0-9a-f]{32}\.(?:tmp|old)(?:/.*)?"


class Written(Struct):
    """What a command wrote to a folder: digests of files by their path in the folder."""

    command: str
    files: dict[str, str] = {}

    def is_changed(self, folder: Path, name: str) -> bool:
        """Return whether a file of the record is there with another content; a link is another content."""
        path = folder / name
        if not os.path.lexists(path):
            return False
        return path.is_symlink() or not path.is_file() or file_digest(path) != self.files[name]

    def first_foreign(self, folder: Path) -> str | None:
        """Return the first file in a folder that the record does not name or that was changed since; None if none."""
        names = files_in(folder)
        return next((name for name in names if name not in self.files or self.is_changed(folder, name)), None)


def files_in(folder: Path) -> Iterator[str]:
    """Iterate over the files in a folder by name, without those of locks, of this module, and temporary ones.

    Links to folders are not followed, and count as files.
    """
    names = []
    for parent, folders, inside in os.walk(folder):
        links = [name for name in folders if os.path.islink(os.path.join(parent, name))]
        names += [(Path(parent) / name).relative_to(folder).as_posix() for name in (*inside, *links)]
    for name in sorted(names):
        if Path(name).name not in (_LOCK, RECORD) and not re.fullmatch(_TEMPORARY, name):
            yield name


def read_written(folder: Path) -> Written | None:
    """Read the record of a folder, None if there is none; InputError if it is damaged."""
    path = folder / RECORD
    if not path.exists():
        return None
    return convert_document(str(path), read_json_object(path, expected=_EXPECTED), Written)


def write_written(folder: Path, command: str, names: Iterable[str]) -> None:
    """Write the record of a folder: ``names`` are the paths of the files in it that the command wrote.

    Errors as in `dvrk_cmaes.io.atomic.write_json`.
    """
    files = {name: file_digest(folder / name) for name in names}
    write_json(folder / RECORD, {"command": command, "files": files})
