"""The command line program ``dvrk-cmaes``. Exit codes: 0 ok, 1 failed, 2 wrong usage or input, 3 doubtful.

Modules that take long to import are imported inside the functions that use them, to keep ``--help`` fast.
"""

from __future__ import annotations

from dvrk_cmaes.cli.app import main

__all__ = ["main"]
