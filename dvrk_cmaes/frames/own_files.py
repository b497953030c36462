"""Files of a folder that may be from elsewhere: a link in it that leads out of the folder is refused."""

from __future__ import annotations

import os
from collections.abc import Iterable
from pathlib import Path

from dvrk_cmaes.errors import InputError


def check_own(given: Path, paths: Iterable[Path | None]) -> None:
    """Check paths to read; those that are not written as within the folder were named by someone, and are fine.

    The folder that is given may be a link itself, for it was named by the user.

    Raises
    ------
    InputError
        A path, or a folder of it, is a link that leaves the folder.
    """
    folder = Path(os.path.abspath(given))
    real = os.path.realpath(given) if os.path.exists(given) else str(folder)
    for path in (Path(os.path.abspath(path)) for path in paths if path is not None):
        if folder in path.parents and not Path(target := os.path.realpath(path)).is_relative_to(real):
            own = path
            while not Path(os.path.realpath(own.parent)).is_relative_to(real):
                own = own.parent
            raise InputError(
                f"{own}: expected a file in {folder}, got a link that leaves it, to {target}; copy what it leads "
                "to into the folder"
            )


def check_own_folder(folder: Path) -> None:
    """Check all that is in a folder, if it is one; errors as of `check_own`."""
    for place, folders, files in os.walk(folder) if os.path.isdir(folder) else ():
        check_own(folder, (Path(place, name) for name in (*folders, *files)))
