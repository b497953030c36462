"""Paths of the bundled instrument and demo session: data/ in a checkout, dvrk_cmaes/data in a wheel."""

from __future__ import annotations

from pathlib import Path

_PACKAGE = Path(__file__).resolve().parents[1]


def bundled_path(*parts: str) -> Path:
    """Return the path of a bundled file or folder, e.g. ``bundled_path("instruments", "lnd")``."""
    inside = _PACKAGE / "data"
    return (inside if inside.is_dir() else _PACKAGE.parent / "data").joinpath(*parts)
