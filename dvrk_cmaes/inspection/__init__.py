"""Inspection of files and folders: recognised format, content read, and rules applied to ambiguous content."""

from __future__ import annotations

from dvrk_cmaes.inspection.finding import Finding, Options
from dvrk_cmaes.inspection.path import inspect_path

__all__ = ["Finding", "Options", "inspect_path"]
