"""Files of a folder that may be from elsewhere: a link in it that leads out of the folder is refused."""

from __future__ import annotations

import os
from collections.abc import Iterable
from pathlib import Path

from dvrk_cmaes.errors import InputError


class OwnFiles:
    """The files of a folder that was given to read; it may be a link itself, for it was named by the user."""

    def __init__(self, folder: Path) -> None:
        self._folder = Path(os.path.abspath(folder))
        self._real = os.path.realpath(folder) if os.path.exists(folder) else str(self._folder)

    def check(self, path: Path) -> Path:
        """Return a path to read; those that are not written as within the folder were named by someone, and are fine.

        Raises
        ------
        InputError
            The path, or a folder of it, is a link that leaves the folder.
        """
        own = Path(os.path.abspath(path))
        if self._folder in own.parents and not Path(target := os.path.realpath(own)).is_relative_to(self._real):
            while not Path(os.path.realpath(own.parent)).is_relative_to(self._real):
                own = own.parent
            raise InputError(
                f"{own}: expected a file in {self._folder}, got a link that leaves it, to {target}; copy what it leads "
                "to into the folder"
            )
        return path

    def check_all(self, paths: Iterable[Path | None]) -> None:
        """Check paths as `check`; None is fine."""
        for path in paths:
            if path is not None:
                self.check(path)

    def check_folder(self) -> None:
        """Check all that is in the folder, if it is one."""
        if not os.path.isdir(self._folder):
            return
        for place, folders, files in os.walk(self._folder):
            self.check_all(Path(place, name) for name in (*folders, *files))
