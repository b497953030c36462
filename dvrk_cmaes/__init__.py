"""Pose and joint angles of da Vinci Research Kit instruments from one endoscope frame, on a CPU."""

from __future__ import annotations

__version__ = "0.1.0"
