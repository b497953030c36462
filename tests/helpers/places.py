"""Folders that tests read from."""

from __future__ import annotations

from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
"""The checkout."""

TESTS = ROOT / "tests"
HELPERS = TESTS / "helpers"
SCRIPTS = ROOT / "scripts"

SHARED = ROOT.parent / "shared"
"""Real meshes, frames and files beside the checkout. Tests that read them use the fixture or mark ``shared``."""


def bundled_path(*parts: str) -> Path:
    """Give the path of a bundled file or folder, such as ``bundled_path("instruments", "lnd")``."""
    return ROOT.joinpath("data", *parts)
