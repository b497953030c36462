"""What a file is taken for, and what is read from it: for people who wonder what the program makes of their files."""

from __future__ import annotations

from dvrk_cmaes.inspection.finding import Finding, Options
from dvrk_cmaes.inspection.path import inspect_path

__all__ = ["Finding", "Options", "inspect_path"]
