"""Inspection of files and folders: recognised format, content read, and rules applied to ambiguous content."""

from __future__ import annotations

from dvrk_cmaes.inspection.path import Finding, Options, inspect_path

__all__ = ["Finding", "Options", "inspect_path"]
