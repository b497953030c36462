"""Files of a folder that may be from elsewhere: links in it that lead out of the folder are refused, or said."""

from __future__ import annotations

import os
from collections.abc import Iterable
from pathlib import Path

from dvrk_cmaes.errors import InputError

FOLLOWED = "links that leave the folder are followed"
"""Beginning of the note on links that were followed."""


class OwnFiles:
    """The files of a folder that was given to read, of which links to files elsewhere are only followed if told to.

    Parameters
    ----------
    folder
        The folder. It may be a link itself, for it was named by the user.
    follow_links
        Whether links that leave the folder are followed.
    """

    def __init__(self, folder: Path, follow_links: bool) -> None:
        self._folder, self._follow = Path(os.path.abspath(folder)), follow_links
        self._real = os.path.realpath(folder)
        self._found: dict[Path, bool] = {self._folder: False}
        self._followed: dict[Path, str] = {}

    @classmethod
    def check_folder(cls, folder: Path, follow_links: bool) -> tuple[str, ...]:
        """Check all that is in a folder; return the notes. Another path than a folder has nothing to be checked."""
        if not folder.is_dir():
            return ()
        own = cls(folder, follow_links)
        for place, folders, files in os.walk(folder):
            own.check_all(Path(place, name) for name in (*folders, *files))
        return own.notes

    def check(self, path: Path) -> Path:
        """Return a path to read; those that are not written as within the folder were named by someone, and are fine.

        Raises
        ------
        InputError
            The path, or a folder of it, is a link that leaves the folder.
        """
        own = Path(os.path.abspath(path))
        if own != self._folder and self._folder in own.parents:
            self._leaves(own)
        return path

    def check_all(self, paths: Iterable[Path | None]) -> None:
        """Check paths as `check`; None is fine."""
        for path in paths:
            if path is not None:
                self.check(path)

    @property
    def notes(self) -> tuple[str, ...]:
        """A note on the links that were followed; none without any."""
        if not self._followed:
            return ()
        link, target = next(iter(self._followed.items()))
        more = f" and {len(self._followed) - 1} more" if len(self._followed) > 1 else ""
        return (f"{FOLLOWED}: {link.relative_to(self._folder)} -> {target}{more}",)

    def _leaves(self, path: Path) -> bool:
        """Whether a path below the folder leads out of it, by itself or by a folder above it; said of the first one."""
        known = self._found.get(path)
        if known is None:
            known = self._leaves(path.parent)
            if not known and path.is_symlink():
                known = not Path(os.path.realpath(path)).is_relative_to(self._real)
                if known:
                    self._say(path)
            if known or path.is_dir():  # files that do not leave are asked for once
                self._found[path] = known
        return known

    def _say(self, path: Path) -> None:
        """Note a link that leaves the folder; InputError if it is not to be followed."""
        target = os.readlink(path)
        if not self._follow:
            raise InputError(
                f"{path}: expected a file in {self._folder}, got a link that leaves it, to {target} "
                "(--follow-links reads what it leads to)"
            )
        self._followed[path] = target
