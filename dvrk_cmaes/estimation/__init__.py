"""Estimation of one frame, from arrays to results: of one instrument, or of several that may hide each other.

The package `pnp` has the baseline.
"""

from __future__ import annotations

from dvrk_cmaes.estimation.one_tool import estimate, estimate_views
from dvrk_cmaes.estimation.several_tools import ToolInFrame, estimate_tools

__all__ = ["ToolInFrame", "estimate", "estimate_tools", "estimate_views"]
