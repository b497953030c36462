"""Folders and files that measurements read by default."""

from __future__ import annotations

from pathlib import Path
from typing import Final

ROOT: Final = Path(__file__).resolve().parents[2]
"""The checkout."""

SHARED: Final = ROOT.parent / "shared"
"""Real frames and scanned meshes beside the checkout."""

SCANNED: Final = SHARED / "instruments" / "lnd_400006" / "lnd_400006.urdf"
"""The instrument of the shared frames."""
