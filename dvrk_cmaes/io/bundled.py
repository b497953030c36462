"""Paths of the bundled instrument and demo session, and of the folder for what can be computed again.

The bundled files are in data/ in a checkout, in dvrk_cmaes/data in a wheel. What takes long to compute, instruments,
prepared meshes and compiled templates, is in ``dvrk-cmaes`` in ``$XDG_CACHE_HOME`` or ``~/.cache``. The environment
variable ``DVRK_CMAES_CACHE`` gives another folder; the value ``off`` disables it. Its files may be deleted at any time.
"""

from __future__ import annotations

import os
from pathlib import Path

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
