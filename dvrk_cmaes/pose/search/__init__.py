"""Global search for the pose in one frame: candidates, losses, and optimisers that share one interface."""

from __future__ import annotations

from dvrk_cmaes.pose.search.methods import METHODS, Found, minimise_each

__all__ = ["METHODS", "Found", "minimise_each"]
