"""The folder for what can be computed again, but takes long: instruments, prepared meshes and compiled templates.

It is ``dvrk-cmaes`` in ``$XDG_CACHE_HOME`` or ``~/.cache``. The environment variable ``DVRK_CMAES_CACHE`` gives another
folder; the value ``off`` disables it. Its files may be deleted at any time.
"""

from __future__ import annotations

import os
from pathlib import Path


def cache_folder() -> Path | None:
    """Return the folder, which may not exist; None if it is disabled or the user has no home folder."""
    folder = os.environ.get("DVRK_CMAES_CACHE", "")
    if folder == "off":
        return None
    if folder:
        return Path(folder)
    try:
        return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "dvrk-cmaes"
    except RuntimeError:  # the user has no home folder
        return None
