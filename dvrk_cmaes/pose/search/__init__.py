"""Global search for the pose in one frame: candidates, losses, and optimisers that share one interface."""

from __future__ import annotations

from dvrk_cmaes.pose.search.global_search import METHODS, minimise_each

__all__ = ["METHODS", "minimise_each"]
