"""Global searches behind one small interface: a loss of many candidates at once, a start, a scale, a budget."""

from __future__ import annotations

from dvrk_cmaes.pose.search.methods import METHODS, Found, minimise

__all__ = ["METHODS", "Found", "minimise"]
