"""Following an instrument through the images of a recording or of a live camera."""

from __future__ import annotations

from dvrk_cmaes.track.tracker import Tracker

__all__ = ["Tracker"]
