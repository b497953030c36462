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
